"""Reliefs: the picture of all texels in two passes, and points of objects in one, at every level."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.examples import EXAMPLE_OPTIONS, directions, make_maps, per_image
from tests.web.cases import bumps
from tests.web.drawing import relative_error
from torch import Tensor

from torchmat.models import MATERIALS, Material, Texture
from torchmat.models.cutout import Cutout
from torchmat.models.storage import StoredAs
from torchmat.rendering.mipmap import Pyramid

RELIEF = 1e-6  # relative squared error; measured 1e-11 on smooth reliefs, where no ray ends elsewhere by rounding
BETWEEN = ("nothing", "ambient", "falloff", "indirect")
_DISTRIBUTION, _MICROFACET = EXAMPLE_OPTIONS["distribution"][2], EXAMPLE_OPTIONS["microfacet"][3]


def on_bumps(name: str, options: dict, size: tuple[int, int], between: str = "ambient", **settings) -> Material:
    """Return a random material on smooth bumps, in float32, whose textures hold it to the bit."""
    maps = make_maps(name, options, *size, torch.float32)
    maps["height"] = bumps(*size)
    if between in ("ambient", "falloff"):
        maps["ambient"] = 0.1 * torch.rand(3, *size)
    if between == "falloff":
        maps["ambient_falloff"] = torch.tensor([0.4])
    if between == "indirect":
        maps["indirect"] = torch.tensor([3.0])
    stored = {"height": StoredAs(storage="float")}
    return MATERIALS[name](maps, storage="float", stored=stored, **settings, **options).as_exported()


# The models take turns: all of them with all of it would take a minute.
_TURNS = [
    (model, relief, between, tiles) for model, (relief, between, tiles) in zip(
        ("distribution", "microfacet", "lambert") * 3,
        [(relief, between, tiles) for relief, tiles in (("fast", True), ("fine", False)) for between in BETWEEN] + [("fine", "nothing", True)],
        strict=True,
    )
]
_OPTIONS: dict[str, dict] = {"distribution": _DISTRIBUTION, "microfacet": _MICROFACET, "lambert": {}, "ptm": {}}


@pytest.mark.parametrize("name, relief, between, tiles", _TURNS)
def test_a_picture_on_a_relief_equals_shade(drawing, name, relief, between, tiles):
    light, view = (per_image(directions(5, torch.float32, seed, lowest=0.15)) for seed in (5, 6))
    light[4, 2] *= -1  # below the horizon
    material = on_bumps(name, _OPTIONS[name], (18, 23), between, relief=relief, tiles=tiles)
    material = material.with_maps(opacity=torch.rand(1, 18, 23)) if name == "lambert" else material
    drawing.load(material)
    found = drawing.evaluate(light, view, material.size)
    with torch.no_grad():
        expected = material.shade(light, view)
    assert max(map(relative_error, found, expected)) < RELIEF


def test_light_between_texels_and_parallax_are_seen_by_these_tests():
    light, view = (per_image(directions(5, torch.float32, seed, lowest=0.15)) for seed in (5, 6))
    with torch.no_grad():
        pictures = [on_bumps("lambert", {}, (18, 23), between).shade(light, view) for between in BETWEEN]
        flat = on_bumps("lambert", {}, (18, 23)).without_relief().shade(light, view)
    changes = [relative_error(one.double(), pictures[0]) for one in (*pictures[1:], flat)]
    assert min(changes) > 5e-4


def test_normals_of_the_height_alone(drawing):
    maps = make_maps("lambert", {}, 12, 9, torch.float32)
    kept = {"albedo": maps["albedo"], "height": bumps(12, 9)}
    material = MATERIALS["lambert"](kept, normals="height", storage="float", stored={"height": StoredAs(storage="float")}).as_exported()
    light, view = (per_image(directions(4, torch.float32, seed, lowest=0.15)) for seed in (5, 6))
    drawing.load(material)
    with torch.no_grad():
        assert relative_error(drawing.evaluate(light, view, material.size), material.shade(light, view)) < RELIEF


def test_models_know_whether_their_normals_are_those_of_the_height():
    kept = {name: one for name, one in make_maps("lambert", {}, 6, 5, torch.float32).items() if name != "normal"}
    of_height = MATERIALS["lambert"]({**kept, "height": bumps(6, 5)}, normals="height")
    materials = [on_bumps(name, options, (6, 5)) for name, options in _OPTIONS.items()]
    for material in (of_height, *materials, *(one.without_relief() for one in materials)):
        assert material.derives_normal == Material.derives_normal.fget(material), material.name  # as the pictures are made


def points(count: int = 12) -> tuple[Tensor, Tensor, Tensor]:
    """Return uv [2, h, w] within and beyond the texture, and lights and views [3, h, w]."""
    light, view = (directions(count * count, torch.float32, seed, lowest=0.2).T.reshape(3, count, count) for seed in (8, 9))
    return 2 * torch.rand(2, count, count) - 0.5, light, view


def on_pyramid(material: Material, uv: Tensor, level: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """Return what a picture of an object blends of two levels, at fractions of levels [h, w]."""
    pyramid, lower = Pyramid(material), level.floor()
    found = torch.zeros(3, *level.shape)
    for step in range(int(lower.max()) + 2):
        weight = torch.where(lower == step, 1 + lower - level, torch.where(lower == step - 1, level - lower, 0.0))
        if bool((weight > 0).any()):
            with torch.no_grad():
                found += weight * pyramid.at_level(step).shade_at(uv, light, view)
    return found


# Sizes that are halved rounding up, and rounding down by the graphics card; the last is of one column.
@pytest.mark.parametrize("name, size", [("distribution", (23, 37)), ("microfacet", (16, 8)), ("ptm", (5, 1))])
@pytest.mark.parametrize("relief", [None, "fast", "fine"])
def test_points_equal_shade_at_on_every_level(drawing, name, size, relief):
    material = on_bumps(name, _OPTIONS[name], size, relief=relief or "fast", tiles=name != "ptm")
    material = material if relief else material.without_relief()
    material = material.with_maps(opacity=torch.rand(1, *size)) if name == "microfacet" else material
    drawing.load(material)
    uv, light, view = points()
    last = math.ceil(math.log2(max(size)))
    for level in (torch.zeros(12, 12), 0.999 * last * torch.rand(12, 12), torch.full((12, 12), float(last))):
        expected = on_pyramid(material, uv, level, light, view)
        bound = 1e-5 if size == (5, 1) and relief == "fine" else RELIEF  # torch's own rounding between two columns
        assert relative_error(drawing.points(uv, level, light, view)[:3], expected) < bound


def test_what_an_opacity_covers(drawing):
    opacity = torch.rand(1, 6, 5)
    drawing.load(on_bumps("ptm", {}, (6, 5)).with_maps(opacity=opacity))
    uv, light, view = points()
    for level in (0, 1, 2.5):
        levels = torch.full((12, 12), float(level))
        texture = Texture({"albedo": opacity.expand(3, -1, -1)})
        up = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 12, 12)
        expected = on_pyramid(texture, uv, levels, up, up)[:1]
        assert relative_error(drawing.points(uv, levels, light, view)[3:], expected) < 1e-9


def test_a_part_of_a_larger_texture_lies_where_it_was_cut(drawing):
    for repeats in (True, False):
        cutout = Cutout(2, 3, 8, 10, 20, 16, repeats)
        material = on_bumps("ptm", {}, (8, 10), tiles=False, cutout=cutout)
        uv, light, view = points()
        for one in (material, material.without_relief()):
            drawing.load(one)
            with torch.no_grad():
                expected = one.shade_at(uv, light, view)
            assert relative_error(drawing.points(uv, torch.zeros(12, 12), light, view)[:3], expected) < RELIEF


def test_below_the_horizon_nothing_is_seen(drawing):
    drawing.load(on_bumps("ptm", {}, (8, 8)))
    uv, light, view = points()
    assert float(drawing.points(uv, torch.zeros(12, 12), light * torch.tensor([1.0, 1.0, -1.0])[:, None, None], view)[:3].abs().max()) == 0
    assert float(drawing.points(uv, torch.zeros(12, 12), light, view * torch.tensor([1.0, 1.0, 0.0])[:, None, None])[:3].abs().max()) == 0
