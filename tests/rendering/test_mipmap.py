"""Smaller copies of a material: which are looked up, how they blend, and that they stay what they are."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.examples import CASES, make
from tests.rendering.scenes import front, white
from tests.support import assert_close

from torchmat.models import Lambert, Texture
from torchmat.models.edit import VECTORS
from torchmat.rendering import Camera, Directional, Point
from torchmat.rendering.mipmap import Pyramid
from torchmat.rendering.objects import shade_visible
from torchmat.rendering.shapes import make_mesh
from torchmat.rendering.visibility import see

UP = torch.tensor([0.0, 0, 1], dtype=torch.float64)[:, None, None]


class Unfiltered:
    """A material of which no smaller copies can be made."""

    def __init__(self, material):
        self.dtype, self.shade_at = material.dtype, material.shade_at


def checkerboard(texels: int = 8, dtype=torch.float64) -> Texture:
    line = torch.arange(texels)
    squares = ((line[:, None] + line) % 2).to(dtype)
    return Texture({"albedo": squares.expand(3, -1, -1).clone()})


def filtered(pyramid: Pyramid, uv: torch.Tensor, footprint: torch.Tensor) -> torch.Tensor:
    """Return the values [3, P] at uv [2, P] for a light along the normal."""
    total = torch.zeros(3, uv.shape[1], dtype=uv.dtype)
    for shader, which, weight in pyramid.parts(footprint):
        value = shader.shade_at(uv[:, None, which], UP, UP)[:, 0].detach()
        total[:, which] += value if weight is None else value * weight
    return total


@pytest.mark.parametrize(
    "size, count",
    [((1, 1), 1), ((2, 2), 2), ((3, 5), 4), ((5, 3), 4), ((4, 4), 3), ((1, 8), 4), ((9, 1), 5), ((6, 6), 4)],
)
def test_levels_go_down_to_one_texel(size, count):
    pyramid = Pyramid(Texture({"albedo": torch.rand(3, *size)}))
    last = float(pyramid.level_of(torch.tensor([1e9]))[0])
    assert last == count - 1
    assert pyramid.at_level(count - 1).size == (1, 1)
    if count > 1:
        assert pyramid.at_level(count - 2).size != (1, 1)


def test_the_level_is_that_whose_texel_is_as_wide_as_the_footprint():
    pyramid = Pyramid(checkerboard(16))
    footprint = torch.tensor([0.0, 1e-9, 1 / 16, 2 / 16, 3 / 16, 8 / 16, 1, 5, math.inf], dtype=torch.float64)
    expected = torch.tensor([0, 0, 0, 1, math.log2(3), 3, 4, 4, 4], dtype=torch.float64)
    assert_close(pyramid.level_of(footprint), expected)


def test_points_of_up_to_a_texel_take_the_full_size_itself():
    material = checkerboard()
    for footprint in ([0.0, 0.05, 1 / 8], []):
        pyramid = Pyramid(material)
        (part,) = pyramid.parts(torch.tensor(footprint, dtype=torch.float64))
        assert part == (material, slice(None), None) and len(pyramid.levels) == 1


def test_weights_of_a_points_two_levels_add_up_to_one():
    pyramid = Pyramid(checkerboard(32))
    footprint = torch.rand(500, dtype=torch.float64) ** 3 * 2
    total, times = torch.zeros(500, dtype=torch.float64), torch.zeros(500)
    for _, which, weight in pyramid.parts(footprint):
        total[which] += weight
        times[which] += 1
        assert float(weight.min()) > 0
    assert_close(total, torch.ones_like(total))
    assert float(times.max()) == 2


def test_between_two_levels_a_value_is_as_near_to_each_as_the_level_is():
    pyramid = Pyramid(Texture({"albedo": torch.rand(3, 16, 16, dtype=torch.float64)}))
    uv = torch.tensor([[0.37], [0.61]], dtype=torch.float64)
    one, two = (pyramid.at_level(level).shade_at(uv[:, None], UP, UP)[:, 0].detach() for level in (1, 2))
    found = filtered(pyramid, uv, torch.tensor([2**1.25 / 16], dtype=torch.float64))
    assert_close(found, 0.75 * one + 0.25 * two)


def test_a_footprint_of_a_whole_texture_gives_its_mean(dtype):
    albedo = torch.rand(3, 8, 16, dtype=dtype)
    found = filtered64(Texture({"albedo": albedo}), torch.rand(2, 20, dtype=dtype), torch.full((20,), 7.0, dtype=dtype))
    assert_close(found, albedo.mean(dim=(1, 2))[:, None].expand(3, 20), 1e-5)


def filtered64(material, uv, footprint):
    pyramid = Pyramid(material)
    up = UP.to(uv.dtype)
    (part,) = pyramid.parts(footprint)
    return part[0].shade_at(uv[:, None], up, up)[:, 0].detach()


@pytest.mark.parametrize("repeat, noise", [(40.0, 0.01), (400.0, 1e-6)])
def test_a_far_repeated_texture_does_not_sparkle(repeat, noise):
    # 8 x 40 texels across 61 pixels are 5 a pixel. Measured spread 0 and 0 against 0.28 and 0.28 of bilinear look-ups.
    seen = see(make_mesh("quad"), front(1.013), 61, 1, repeat=repeat, dtype=torch.float64)
    material = checkerboard()
    spread = {
        name: shade_visible(shader, seen, [Directional((0, 0, 1))])[0][2:-2, 2:-2]
        for name, shader in (("filtered", material), ("plain", Unfiltered(material)))
    }
    assert float((spread["filtered"] - 0.5).abs().max()) < noise
    assert float(spread["plain"].std()) > 0.15


def test_an_oblique_plane_converges_toward_its_horizon():
    quad, light = make_mesh("quad"), [Directional((0, 0, 1))]
    camera = Camera((0, -0.7, 0.05), (0, 0, 0), up=(0, 0, 1), field_of_view=0.6)
    seen = see(quad, camera, (30, 80), 1, repeat=16.0, dtype=torch.float64)
    picture = shade_visible(checkerboard(), seen, light)[0]
    shown = seen.resolve(torch.ones(1, 1, len(seen.pixel), dtype=torch.float64))[0] > 0
    rows = shown.all(dim=1).nonzero()[:, 0]
    assert len(rows) > 3
    spread = [float(picture[row].std()) for row in rows]
    assert spread[0] < 1e-3 and max(spread) > 0.05  # from mean grey at the top to squares at the bottom


def test_the_blend_has_no_ring_where_levels_meet():
    # Between neighbouring levels the value is linear in the level: no step is larger than the share it stands for.
    material = Texture({"albedo": torch.rand(3, 16, 16, dtype=torch.float64)})
    pyramid = Pyramid(material)
    level = torch.linspace(-1, 6, 1401, dtype=torch.float64)
    uv = torch.tensor([[0.37], [0.61]], dtype=torch.float64).expand(2, 1401)
    values = filtered(pyramid, uv, 2**level / 16)
    step = (values[:, 1:] - values[:, :-1]).abs().max()
    assert float(step) <= 0.005 * 1.0001  # a 200th of a level, of values between 0 and 1
    assert float((values[:, 0] - values[:, -1]).abs().max()) > 0.05
    for meeting in (1.0, 2.0, 3.0, 4.0):
        around = torch.tensor([meeting - 1e-9, meeting + 1e-9], dtype=torch.float64)
        close = filtered(pyramid, uv[:, :2], 2**around / 16)
        assert_close(close[:, 0], close[:, 1], 1e-8)


@pytest.mark.parametrize("size", [(3, 5), (1, 1), (1, 6)])
@pytest.mark.parametrize("name, options", CASES)
def test_every_model_stays_what_it_is_at_every_level(name, options, size):
    material = make(name, options, *size)
    pyramid = Pyramid(material)
    count = int(pyramid.level_of(torch.tensor([1e9], dtype=torch.float64))[0]) + 1
    for level in range(count):
        copy = pyramid.at_level(level)
        assert type(copy) is type(material) and copy.options == material.options and copy.dtype == material.dtype
        for spec in material.specs():  # their ranges are checked as of every material
            value = copy.maps[spec.name].detach()
            if spec.constant or not spec.per_texel:
                assert value.equal(material.maps[spec.name])
            elif spec.index:
                assert bool((value == value.round()).all())
            elif spec.name in VECTORS:
                assert_close(value.norm(dim=0), torch.ones(copy.size, dtype=value.dtype))
        light = torch.tensor([0.48, 0.6, 0.64], dtype=torch.float64)[:, None, None]
        assert bool(torch.isfinite(copy.shade_at(torch.rand(2, 1, 9, dtype=torch.float64), light, UP)).all())
    assert copy.size == (1, 1)


@pytest.mark.parametrize("name, options", CASES)
def test_a_uniform_material_is_the_same_at_every_level(name, options):
    one = make(name, options, 1, 1)
    wide = type(one)(
        {spec.name: one.maps[spec.name].detach() if spec.constant or not spec.per_texel
         else one.maps[spec.name].detach().expand(-1, 6, 9) for spec in one.specs()}, **one.options,
    )
    light = torch.tensor([0.48, 0.6, 0.64], dtype=torch.float64)[:, None, None]
    uv = torch.rand(2, 1, 5, dtype=torch.float64)
    expected = wide.shade_at(uv, light, UP).detach()
    for level in range(1, 4):
        assert_close(Pyramid(wide).at_level(level).shade_at(uv, light, UP).detach(), expected, 1e-10)


def test_a_relief_keeps_its_height_in_texture_widths():
    # One wave of 0.08 texture widths: at a quarter of the size it still moves what is seen by as much, and leans so.
    u = (torch.arange(64, dtype=torch.float64) + 0.5) / 64
    height = (0.08 * torch.sin(2 * math.pi * u)).expand(1, 64, 64)
    albedo = (0.5 + 0.4 * torch.cos(2 * math.pi * u)).expand(3, 64, 64)
    material = Lambert({"albedo": albedo, "height": height}, normals="height")
    pyramid = Pyramid(material)
    across = torch.linspace(0, 1, 50, dtype=torch.float64)
    uv = torch.stack((across, torch.full_like(across, 0.3)))[:, None]
    light, view = (torch.tensor(d, dtype=torch.float64)[:, None, None] for d in ((-0.28, 0.0, 0.96), (0.6, 0.0, 0.8)))
    full, quarter, flat = (
        shader.shade_at(uv, light, view).detach() for shader in (material, pyramid.at_level(2), material.surface())
    )
    # Measured: 0.014 apart at 16 texels; parallax and shadow, at one normal, make a difference of 0.19.
    assert_close(quarter, full, 0.03)
    assert float((flat - full).abs().max()) > 0.15
    assert float(pyramid.at_level(2).maps["height"].detach().max()) > 0.07


def test_a_brdf_has_one_level():
    brdf = white()
    (part,) = Pyramid(brdf).parts(torch.tensor([1e3, 1e-3], dtype=torch.float64))
    assert part == (brdf, slice(None), None) and Pyramid(brdf).dtype == torch.float64


def test_lights_and_levels_together():
    # Points of several levels, some of them lit: each lands in its own place.
    material = checkerboard(16)
    camera = Camera((0, -0.7, 0.15), (0, 0, 0), up=(0, 0, 1), field_of_view=0.6)
    seen = see(make_mesh("quad"), camera, 24, 1, repeat=4.0, dtype=torch.float64)
    light = Point((0.2, -0.3, 0.2))
    picture = shade_visible(material, seen, [light])
    way = torch.tensor([0.2, -0.3, 0.2], dtype=torch.float64)[:, None] - seen.position[:, 0]
    cosine = way[2] / way.norm(dim=0) ** 3
    expected = filtered(Pyramid(material), seen.uv[:, 0], seen.footprint) * cosine
    levels = Pyramid(material).level_of(seen.footprint)
    assert float(levels.min()) < 1 and float(levels.max()) > 2.5
    assert_close(picture, seen.resolve(expected[:, None]))
