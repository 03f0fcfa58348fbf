"""Textures as painters leave them: every map spans what it can be, and grey, coloured and resized paintings are taken."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch
from tests.models.distributions import distribution
from tests.support import assert_close

from torchmat import DataError, load_material, save_material
from torchmat.create import material_from_picture
from torchmat.create.controls import constant_rotation
from torchmat.errors import Notice
from torchmat.images import read_image, write_image
from torchmat.models.edit import add_part, replace_map
from torchmat.models.storage import StoredAs

PARTS = ("normal", "specular_mask", "fresnel", "rotation", "tilt")


def textures(folder) -> dict[str, dict]:
    return {entry["file"]: entry for entry in json.loads((folder / "manifest.json").read_text())["textures"]}


def painted(folder, name, codes, dtype=np.uint8):
    """Paint one texture in one code for each channel."""
    entry = textures(folder)[name]
    codes = np.broadcast_to(np.asarray(codes, dtype), (entry["height"], entry["width"], np.size(codes)))
    write_image(folder / name, np.ascontiguousarray(codes))
    return load_material(folder)


@pytest.fixture(params=["paint8", "paint16"])
def folder(tmp_path, request):
    """A material whose maps all stay within a small part of what they can be."""
    material = distribution(5, 6, 2, PARTS, storage="float").stored_as(request.param)
    small = {"diffuse": (0.1, 0.59), "specular_mask": (0.4, 0.5), "fresnel": (0.0836, 0.0907)}
    for name, (low, high) in small.items():
        value = torch.rand_like(material.maps[name])
        material = replace_map(material, name, low + (high - low) * value)
    material = material.on_relief(0.002 * torch.rand(1, 5, 6) - 0.001).stored_at({"height": StoredAs(span=(-0.01, 0.04))})
    return save_material(material, tmp_path / "m")


@pytest.mark.parametrize(("name", "codes", "expected"), [
    ("diffuse.png", (255, 0, 0), (1.0, 0.0, 0.0)), ("diffuse.png", (188, 188, 188), (0.5029, 0.5029, 0.5029)),
    ("fresnel.png", (0,), (0.0,)), ("fresnel.png", (255,), (1.0,)), ("specular_mask.png", (255,), (1.0,)),
    ("height.png", (0,), (-0.01,)), ("height.png", (255,), (0.04,)), ("normal.png", (255, 255, 255), (1.0, 1.0, 1.0)),
    ("normal.png", (0, 0, 0), (-1.0, -1.0, -1.0)), ("tilt.png", (255,), (1.0,)),
    ("rotation.png", (255, 0, 0), (1.0, 0.0)), ("rotation.png", (128, 255, 0), (0.0, 1.0)),
    ("rotation.png", (0, 255, 255), (-1.0, 0.0)), ("rotation.png", (40, 80, 80), (-1.0, 0.0)),
])
def test_codes_mean_what_a_painter_sees(folder, name, codes, expected):
    found = painted(folder, name, codes).maps[name.removesuffix(".png")].detach()
    wanted = torch.tensor(expected)[:, None, None].expand_as(found)
    assert float((found - wanted).abs().max()) < (6e-3 if name == "rotation.png" else 1e-4)


def test_ranges_are_stated_and_the_version_is_one_that_early_readers_refuse(folder):
    found = textures(folder)
    assert json.loads((folder / "manifest.json").read_text())["version"] == 3
    assert (found["height.png"]["low"], found["height.png"]["high"]) == ([pytest.approx(-0.01)], [pytest.approx(0.04)])
    assert found["rotation.png"]["transfer"] == "hue" and "rotation_x.png" not in found
    assert found["tilt.png"]["type"] == found["specular_1.png"]["type"] == "uint16"
    assert found["specular_1.png"]["transfer"] == "srgb" and found["specular_1.png"]["low"] == [0, 0, 0]
    assert found["specular_1.png"]["high"][0] >= 1


def test_what_is_stored_comes_back(folder, tmp_path):
    first = load_material(folder)
    again = load_material(save_material(first, tmp_path / "again"))
    for name, value in first.maps.items():
        span = 1.0 if name != "height" else 0.05
        assert float((again.maps[name] - value).detach().abs().max()) <= 6e-3 * span, name
        assert torch.equal(first.as_exported().maps[name], again.maps[name]), name


def test_the_hue_of_a_rotation_is_its_angle(tmp_path):
    flat = add_part(distribution(4, 4, 1, (), storage="paint16"), "rotation", constant_rotation((4, 4), 2.0))
    found = load_material(save_material(flat, tmp_path / "m")).maps["rotation"].detach()
    assert float((torch.atan2(found[1], found[0]) - 2.0).abs().max()) < 1e-4


def test_a_map_above_one_keeps_its_range(tmp_path):
    bright = replace_map(distribution(4, 4, 1, (), storage="paint16"), "diffuse", torch.full((3, 4, 4), 2.5))
    folder = save_material(bright, tmp_path / "m")
    assert textures(folder)["diffuse.png"]["high"] == [2.5] * 3
    assert_close(load_material(folder).maps["diffuse"].detach(), torch.full((3, 4, 4), 2.5), 1e-5)


def test_unbounded_maps_are_grey_at_zero(tmp_path):
    from tests.models.examples import make

    folder = save_material(make("ptm", {}, 4, 4, dtype=torch.float32, storage="paint16"), tmp_path / "m")
    for entry in textures(folder).values():
        assert entry["low"] == [-value for value in entry["high"]] and entry["transfer"] == "linear"


def test_a_grey_painting_of_a_colour_is_taken_and_said(folder):
    with pytest.warns(Notice, match=r"diffuse\.png: it is grey, and was taken for all three channels"):
        found = painted(folder, "diffuse.png", (255,))
    assert_close(found.maps["diffuse"].detach(), torch.ones(3, 5, 6), 1e-5)


def test_a_colour_painting_of_a_grey_map_is_taken_and_said(folder):
    with pytest.warns(Notice, match=r"fresnel\.png: it is in colour, and its brightness was taken"):
        found = painted(folder, "fresnel.png", (0, 255, 0))
    assert_close(found.maps["fresnel"].detach(), torch.full((1, 5, 6), 182 / 255), 1e-5)  # 0.7152 x 255
    with pytest.warns(Notice, match=r"fresnel\.png: its channels are equal, and one was taken"):
        found = painted(folder, "fresnel.png", (51, 51, 51))
    assert_close(found.maps["fresnel"].detach(), torch.full((1, 5, 6), 0.2), 1e-5)


def test_a_grey_painting_of_normals_or_hues_says_nothing_and_is_refused(folder):
    for name in ("normal.png", "rotation.png"):
        kept = (folder / name).read_bytes()
        with pytest.raises(DataError, match=name):
            painted(folder, name, (128,))
        (folder / name).write_bytes(kept)
    with pytest.raises(DataError, match=r"rotation\.png: the rotation must be painted in hues; 30 of 30 texels are grey"):
        painted(folder, "rotation.png", (90, 90, 90))


def test_few_texels_without_a_hue_are_no_turn_and_said(folder):
    pixels = np.zeros((5, 6, 3), np.uint8)
    pixels[..., 1] = 255
    pixels[2, 3] = 77
    write_image(folder / "rotation.png", pixels)
    with pytest.warns(Notice, match=r"rotation\.png: 1 of 30 texels are grey, and were taken for no turn"):
        found = load_material(folder).maps["rotation"].detach()
    assert found[:, 2, 3].tolist() == [1.0, 0.0]
    assert float((torch.atan2(found[1], found[0])[0, 0] - 2 * math.pi / 3).abs()) < 1e-6


@pytest.mark.parametrize("size", [(10, 12), (3, 3), (1, 1)])
def test_a_resized_painting_is_resampled_and_said(folder, size):
    write_image(folder / "diffuse.png", np.full((*size, 3), 255, np.uint8))
    with pytest.warns(Notice, match=rf"diffuse\.png: it is {size[0]} x {size[1]}, and was resampled to 5 x 6"):
        found = load_material(folder)
    assert_close(found.maps["diffuse"].detach(), torch.ones(3, 5, 6), 1e-5)


def test_a_resized_painting_keeps_its_places(folder):
    pixels = np.zeros((10, 12), np.uint8)
    pixels[:4, :4] = 255  # the corner of two by two texels
    write_image(folder / "fresnel.png", pixels)
    with pytest.warns(Notice, match="resampled"):
        found = load_material(folder).maps["fresnel"][0].detach()
    # A triangle over twice the texel, cut where the white ends, and the surface repeats: 7/8 along each side.
    assert float(found[0, 0]) == pytest.approx(49 / 64) and float(found[3, 4]) == 0


def test_a_specular_map_may_be_painted_in_any_size(folder):
    write_image(folder / "specular_1.png", np.full((64, 64, 3), 65535, np.uint16))
    with pytest.warns(Notice, match="specular_1"):
        bright = load_material(folder).maps["specular"][:3].detach()
    assert_close(bright, torch.full_like(bright, textures(folder)["specular_1.png"]["high"][0]), 1e-5)


def test_create_paints_by_default(tmp_path):
    picture = 0.2 + 0.1 * torch.rand(3, 6, 7)
    material = material_from_picture(picture, height_scale=0.05, rotation_centres=[(0.5, 0.5)], tilt="velvet")
    folder = save_material(material, tmp_path / "m")
    found = textures(folder)
    assert found["fresnel.png"]["low"] == [0] and found["fresnel.png"]["high"] == [1]
    assert found["height.png"]["high"][0] - found["height.png"]["low"][0] == pytest.approx(0.05, abs=1e-6)
    assert found["diffuse.png"]["high"] == [1, 1, 1] and found["rotation.png"]["transfer"] == "hue"
    white = painted(folder, "height.png", (255,)).maps["height"].detach()
    black = painted(folder, "height.png", (0,)).maps["height"].detach()
    assert_close(white - black, torch.full_like(white, 0.05), 1e-6)


def test_a_folder_of_an_earlier_version_loads_as_before(tmp_path):
    folder = save_material(distribution(4, 4, 1, ("fresnel", "rotation"), storage="png16"), tmp_path / "m")
    table = json.loads((folder / "manifest.json").read_text())
    assert table["version"] == 1 and {"rotation_x.png", "rotation_y.png"} <= set(textures(folder))
    expected = load_material(folder)
    del table["digests"]
    (folder / "manifest.json").write_text(json.dumps(table))
    found = load_material(folder)
    for name, value in expected.maps.items():
        assert torch.equal(found.maps[name], value), name
    assert read_image(folder / "fresnel.png").dtype == np.uint16
