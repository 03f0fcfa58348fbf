"""Sheets of maps and of nine views, of every registered model, and what is on them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.models.examples import CASES, make
from tests.support import hemisphere

from torchmat.create import material_from_picture
from torchmat.errors import DataError, RangeError, ShapeError
from torchmat.images import read_image
from torchmat.report import maps as sheets
from torchmat.report.maps import hemisphere_picture, maps_picture
from torchmat.report.pictures import plotting, save_figure
from torchmat.report.samples import Measured


def from_picture(height: int = 5, width: int = 6):
    return material_from_picture(
        torch.rand(3, height, width), lobes=2, specular=("glossy", "rim"), rotation_centres=[(0.5, 0.5)], tilt="velvet"
    )


@pytest.mark.parametrize("name, options", CASES)
def test_every_material_has_a_sheet(tmp_path, name, options):
    path = maps_picture(make(name, options, 3, 4), tmp_path / "maps.png")
    pixels = read_image(path)
    assert min(pixels.shape[:2]) > 100 and np.ptp(pixels[..., :3]) > 100


def test_every_map_has_its_panel(tmp_path, monkeypatch):
    titles = []

    def keep(figure, path, placed=False):
        titles.extend(axis.get_title() for axis in figure.axes)
        sheets.plotting().close(figure)
        return path

    monkeypatch.setattr(sheets, "save_figure", keep)
    maps_picture(from_picture(), tmp_path / "maps.png")
    starts = [title.split(" ")[0].rstrip(":") for title in titles if title]
    assert starts == [
        "diffuse", "specular_mask", "fresnel", "rotation", "tilt", "index_1", "index_2", "specular_1", "specular_2", "height",
    ]


def drawn(panel):
    """Return the axis on which a panel has drawn."""
    figure, axis = sheets.plotting().subplots()
    panel.draw(axis)
    sheets.plotting().close(figure)
    return axis


def panel_of(material, name):
    spec = next(spec for spec in material.specs() if spec.name == name)
    return sheets._panels(spec, material.maps[name].detach(), None)[0]


def test_panels_show_the_maps_as_people_see_them():
    material = from_picture()
    shown = drawn(panel_of(material, "diffuse")).images[0].get_array()
    linear = material.maps["diffuse"].detach()
    encoded = torch.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(shown - encoded.permute(1, 2, 0).numpy()).max() < 1e-5
    hue = drawn(panel_of(material, "rotation")).images[0].get_array()
    assert np.abs(hue.max(axis=2) - 1).max() < 1e-6 and np.abs(hue.min(axis=2)).max() < 1e-6
    assert np.array_equal(drawn(panel_of(material, "height")).images[0].get_array(), material.maps["height"][0].detach().numpy())
    assert np.allclose(drawn(panel_of(material, "tilt")).lines[0].get_ydata(), material.maps["tilt"].detach().numpy()[0, 0])


def test_half_vectors_are_marked_on_the_disc():
    material = from_picture()
    half = torch.tensor([[0.0, 0.0, 1.0], [math.sin(1.0), 0.0, math.cos(1.0)], [0.0, -1.0, 0.0]])
    spec = next(spec for spec in material.specs() if spec.name == "specular")
    axis = drawn(sheets._panels(spec, material.maps["specular"].detach(), sheets._marks(half))[0])
    assert np.allclose(axis.lines[0].get_xydata(), [[0, 0], [math.tan(0.5), 0], [0, -1]], atol=1e-6)
    assert axis.patches[0].get_radius() == 1 and tuple(axis.images[0].get_extent()) == (-1, 1, -1, 1)
    assert float(axis.images[0].get_array().max()) == pytest.approx(1)


def test_bad_half_vectors_are_refused(tmp_path):
    for half, error, said in (
        (torch.zeros(3), ShapeError, "half"), (torch.full((2, 3), math.nan), RangeError, "finite"),
        (torch.tensor([[0.0, 0.0, -1.0]]), RangeError, "-z"),
    ):
        with pytest.raises(error, match=said):
            maps_picture(from_picture(), tmp_path / "maps.png", half)
    with pytest.raises(DataError, match="writable"):
        maps_picture(from_picture(), tmp_path / "maps.nothing")


@pytest.fixture()
def figures(monkeypatch):
    """Keep the figures that would be written."""
    kept = []

    def keep(figure, path, placed=False):
        kept.append(figure)
        sheets.plotting().close(figure)
        return path

    monkeypatch.setattr(sheets, "save_figure", keep)
    return kept


def titles_of(figure):
    return [axis.get_title() for axis in figure.axes if axis.get_title()]


def seen_by(monkeypatch, value):
    """Let every picture have the one value that `value(light, view)` says."""
    asked = []

    def draw(material, mesh, lights, view, size):
        asked.append((lights[0], view))
        return torch.full((3, 2, 2), value(torch.tensor(lights[0]), torch.tensor(view)))

    monkeypatch.setattr(sheets, "render", draw)
    return asked


def test_nine_views_differ_and_stand_where_one_stands(figures, monkeypatch):
    asked = seen_by(monkeypatch, lambda light, view: float(view @ torch.tensor([0.3, 0.1, 0.5])))
    hemisphere_picture(from_picture(), "unused.png", size=16)
    assert titles_of(figures[0]) == [
        "view 50°/135°", "view 25°/90°", "view 50°/45°",
        "view 25°/180°", "view 0°/0°", "view 25°/0°",
        "view 50°/225°", "view 25°/270°", "view 50°/315°",
    ]
    views = np.array([view for _, view in asked])
    assert np.allclose(np.linalg.norm(views, axis=1), 1) and len({tuple(np.round(view, 6)) for view in views}) == 9
    apart = np.linalg.norm(views[:, None] - views[None], axis=2) + 9 * np.eye(9)
    assert apart.min() > 0.4
    # The light comes from the upper left; the last picture looks along its mirror direction.
    assert asked[0][0][0] < 0 < asked[0][0][1] and views[-1][0] > 0 > views[-1][1]


def test_what_looks_alike_from_everywhere_is_shown_under_nine_lights(figures, monkeypatch):
    seen_by(monkeypatch, lambda light, view: float(light @ torch.tensor([0.3, 0.1, 0.5])))
    hemisphere_picture(from_picture(), "unused.png", size=16)
    titles = titles_of(figures[0])
    assert len(titles) == 9 and titles[0] == "light 50°/135°" and "alike from everywhere" in figures[0].get_suptitle()


def test_no_picture_is_there_twice(figures, monkeypatch):
    seen_by(monkeypatch, lambda light, view: float(light[2]) / 2)
    hemisphere_picture(from_picture(), "unused.png", size=16)
    assert titles_of(figures[0]) == ["light 50°/135°", "light 25°/90°", "light 0°/0°"]
    seen_by(monkeypatch, lambda light, view: 0.5)
    hemisphere_picture(from_picture(), "unused.png", size=16)
    assert titles_of(figures[1]) == ["light 0°/0°"]


def test_views_beyond_the_measured_are_marked(figures, monkeypatch):
    seen_by(monkeypatch, lambda light, view: float(view @ torch.tensor([0.3, 0.1, 0.5])))
    rows = torch.from_numpy(hemisphere(((0, 1), (60, 12)))).float()
    narrow = torch.from_numpy(hemisphere(((0, 1), (35, 12)))).float()
    hemisphere_picture(from_picture(), "unused.png", 16, Measured(rows, narrow))
    marked = [axis.get_title() for axis in figures[0].axes if axis.title.get_color() != "black"]
    assert marked == ["view 50°/135°", "view 50°/45°", "view 50°/225°", "view 50°/315°"]
    assert "orange: beyond the measured directions" in figures[0].get_suptitle()
    hemisphere_picture(from_picture(), "unused.png", 16, Measured(rows, rows))
    assert "orange" not in figures[1].get_suptitle()


@pytest.mark.parametrize("size", [(5, 6), (1, 1), (1, 40), (40, 1)])
def test_sheets_of_every_shape(tmp_path, size):
    material = from_picture(*size) if min(size) > 1 else material_from_picture(torch.rand(3, *size))
    assert min(read_image(maps_picture(material, tmp_path / "maps.png")).shape[:2]) > 100
    path = hemisphere_picture(material, tmp_path / "hemisphere.png", size=16)
    assert min(read_image(path).shape[:2]) > 100


def test_a_size_of_0_is_refused(tmp_path):
    with pytest.raises(RangeError, match="size"):
        hemisphere_picture(from_picture(), tmp_path / "hemisphere.png", size=0)


@pytest.mark.parametrize("name", ["a.png", "a.pdf"])
def test_a_picture_may_be_a_pdf_too(name, tmp_path):
    path = save_figure(plotting().figure(), tmp_path / name)
    assert path.read_bytes()[1:4].decode() == name[-3:].upper()
