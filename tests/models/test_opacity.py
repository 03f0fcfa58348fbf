"""A surface that is cut out: opacity scales what each model sends, flat and on a relief, in pictures and in files."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.models.examples import CASES, directions, make, per_image
from tests.models.test_relief_maps import on_waves
from tests.support import assert_close

from torchmat import RangeError, load_material, render, save_material
from torchmat.create import material_from_textures
from torchmat.images import read_image, write_image
from torchmat.material_io.packing import pack, unpack
from torchmat.material_io.volume import write_volume
from torchmat.models import Distribution, Lambert
from torchmat.models.blend import blend
from torchmat.models.edit import resized

HOLES = torch.tensor([[[1.0, 0.0, 0.5], [0.25, 1.0, 0.0]]], dtype=torch.float64)
every_model = pytest.mark.parametrize("name, options", CASES)


def white(opacity: torch.Tensor, dtype=torch.float32) -> Lambert:
    size = opacity.shape[1:]
    normal = torch.zeros(3, *size, dtype=dtype)
    normal[2] = 1
    return Lambert({"albedo": torch.ones(3, *size, dtype=dtype), "normal": normal, "opacity": opacity.to(dtype)})


@every_model
def test_each_model_is_cut_out_by_its_opacity(name, options):
    whole = make(name, options)
    cut = whole.with_maps(opacity=HOLES)
    light, view = (per_image(directions(4, seed=seed)) for seed in (1, 2))
    assert_close(cut.shade(light, view), whole.shade(light, view) * HOLES, 1e-12)
    uv = torch.tensor([[[1 / 6, 0.5, 5 / 6]], [[0.75, 0.75, 0.75]]], dtype=torch.float64)  # the first row's texels
    row = whole.shade_at(uv, light, view) * HOLES[:, :1]
    assert_close(cut.shade_at(uv, light, view), row, 1e-12)
    assert "opacity" not in cut.surface().maps


@every_model
def test_on_a_relief_it_scales_what_is_seen_ambient_light_too(name, options):
    whole = on_waves(name, options)
    half = whole.with_maps(opacity=torch.full((1, 6, 8), 0.5, dtype=torch.float64))
    light, view = (per_image(directions(3, seed=seed, lowest=0.4)) for seed in (1, 2))
    assert_close(half.shade(light, view), whole.shade(light, view) / 2, 1e-12)
    uv = torch.rand(2, 3, 4, dtype=torch.float64)
    assert_close(half.shade_at(uv, light, view), whole.shade_at(uv, light, view) / 2, 1e-12)


def test_on_a_flat_height_a_hole_stays_where_it_is():
    opacity = torch.rand(1, 6, 8, dtype=torch.float64)
    flat = white(opacity, torch.float64)
    raised = flat.on_relief(torch.zeros(1, 6, 8, dtype=torch.float64))
    assert torch.equal(raised.maps["opacity"], opacity)
    light, view = (per_image(directions(3, seed=seed, lowest=0.4)) for seed in (1, 2))
    assert_close(raised.shade(light, view), flat.shade(light, view), 1e-9)


def test_a_hole_is_black_in_a_picture_and_half_a_hole_half_as_bright():
    opacity = torch.ones(1, 8, 8)
    opacity[:, :, 4:] = 0
    opacity[:, :4, :4] = 0.5
    seen = render(white(opacity), "patch", lights=[(0, 0, 1)], size=8)
    assert_close(seen, opacity.expand(3, -1, -1), 1e-6)


def test_seen_from_afar_it_is_the_mean_of_what_is_there():
    small = resized(white(torch.tensor([[[1.0, 0.0], [0.0, 1.0]]])), (1, 1))
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    assert small.shade(up, up).flatten().tolist() == [0.5, 0.5, 0.5]


def test_values_outside_and_other_sizes_are_refused():
    with pytest.raises(RangeError, match=r"lambert: opacity must .* 1"):
        white(torch.full((1, 2, 2), 1.5))


@pytest.mark.parametrize("storage, tolerance", [("png8", 0.5 / 255), ("half", 5e-4)])
def test_the_folder_keeps_it(tmp_path, storage, tolerance):
    material = white(HOLES.float()).stored_as(storage)
    folder = save_material(material, tmp_path / "m")
    loaded = load_material(folder)
    assert_close(loaded.maps["opacity"], HOLES.float(), 1.01 * tolerance)
    assert torch.equal(loaded.maps["opacity"], material.as_exported().maps["opacity"])
    entry = next(one for one in json.loads((folder / "manifest.json").read_text())["textures"] if one["map"] == "opacity")
    assert entry["meaning"] == "share of a texel that the surface covers"
    if storage == "png8":
        assert read_image(folder / "opacity.png")[..., 0].tolist() == [[255, 0, 128], [64, 255, 0]]


def test_packed_textures_keep_it_and_a_volume_refuses_it(tmp_path):
    flat = Distribution({"diffuse": torch.rand(3, 2, 3), "opacity": HOLES.float()}, lobes=0, parts=())
    pack(flat, tmp_path / "packed")
    assert_close(unpack(tmp_path / "packed").maps["opacity"], HOLES.float(), 0.51 / 255)
    stack = make("shading_map", {"slices": 4, "brdf": "phong"}, dtype=torch.float32).with_maps(opacity=HOLES.float())
    with pytest.raises(RangeError, match="be whole for a .3pm file; it has an opacity map"):
        write_volume(stack, tmp_path / "a.3pm")


def test_a_blend_of_holes():
    one, other = white(HOLES.float()), white(torch.ones(1, 2, 3))
    assert_close(blend(one, other, 0.5).maps["opacity"], (HOLES.float() + 1) / 2, 1e-6)


def leaf(folder, in_alpha: bool):
    """Write a set whose left half is cut out, and black there, as vendors leave it."""
    folder.mkdir()
    colour = np.full((8, 8, 4), 200, np.uint8)
    colour[:, :4] = 0
    rough = np.full((8, 8, 1), 128, np.uint8)
    rough[:, :4] = 0
    write_image(folder / "Leaf_Color.png", colour if in_alpha else colour[..., :3])
    write_image(folder / "Leaf_Roughness.png", rough)
    if not in_alpha:
        write_image(folder / "Leaf_Opacity.png", np.where(colour[..., 3:] > 0, 255, 0).astype(np.uint8))
    return folder


@pytest.mark.parametrize("in_alpha", [False, True])
def test_textures_with_a_cut_out(tmp_path, in_alpha):
    material = material_from_textures(leaf(tmp_path / "leaf", in_alpha))
    wanted = torch.zeros(1, 8, 8)
    wanted[:, :, 4:] = 200 / 255 if in_alpha else 1
    assert_close(material.maps["opacity"].detach(), wanted, 1e-6)
    # What is cut out has the mean of the rest, so that neither mip levels nor the range of roughness see its black.
    diffuse = material.maps["diffuse"].detach()
    assert_close(diffuse, diffuse[:, :, 7:].expand(3, 8, 8), 1e-6)
    assert "index" not in material.maps
    loaded = load_material(save_material(material, tmp_path / "out"))
    seen = render(loaded, "patch", lights=[(0, 0, 1)], size=8)
    assert float(seen[:, :, :4].abs().max()) == 0 and float(seen[:, :, 4:].min()) > 0.1


def test_an_alpha_of_nothing_but_1_is_none(tmp_path):
    folder = tmp_path / "s"
    folder.mkdir()
    write_image(folder / "x_Color.png", np.full((4, 4, 4), 255, np.uint8))
    assert "opacity" not in material_from_textures(folder).maps


