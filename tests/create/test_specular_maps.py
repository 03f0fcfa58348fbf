"""Specular maps by hand: where they peak, where they have fallen to half, and what they refuse."""

from __future__ import annotations

import math

import pytest
import torch
from tests.support import assert_close

from torchmat.create.specular_maps import SPECULAR_MAPS, TILTS, disc, specular_map, tilt_curve
from torchmat.errors import RangeError
from torchmat.models.distribution import default_tilt

every_map = pytest.mark.parametrize("name", SPECULAR_MAPS)


def at(shape: torch.Tensor, polar: float, azimuth: float = 0.0) -> float:
    """Return the first channel where a half vector of that direction looks it up."""
    radius = math.tan(polar / 2)
    grid = torch.tensor([radius * math.cos(azimuth), -radius * math.sin(azimuth)])[None, None, None]
    found = torch.nn.functional.grid_sample(shape[None], grid, padding_mode="border", align_corners=False)
    return float(found[0, 0, 0, 0])


@every_map
@pytest.mark.parametrize("size", [1, 2, 7, 48])
def test_every_map_is_square_finite_and_not_negative(name, size):
    shape = SPECULAR_MAPS[name](size=size)
    assert shape.shape == (3, size, size) and shape.dtype == torch.float32
    assert bool(torch.isfinite(shape).all()) and float(shape.min()) >= 0 and float(shape.max()) <= 1


@every_map
def test_strength_and_colour_scale_it(name):
    tinted = SPECULAR_MAPS[name](strength=3.0, colour=(1.0, 0.5, 0.0))
    assert_close(tinted, 3 * torch.tensor([1.0, 0.5, 0.0])[:, None, None] * SPECULAR_MAPS[name](), 1e-6)


def test_the_disc_by_hand():
    polar, azimuth = disc(2)  # texel centres at (+-0.5, +-0.5)
    assert_close(polar, torch.full((2, 2), 2 * math.atan(math.sqrt(0.5)), dtype=torch.float64))
    assert_close(torch.rad2deg(azimuth), torch.tensor([[135.0, 45.0], [-135.0, -45.0]], dtype=torch.float64))


@pytest.mark.parametrize(("name", "width"), [("glossy", 0.3), ("soft", 0.8)])
def test_a_dot_falls_to_half_at_its_width(name, width):
    shape = SPECULAR_MAPS[name](size=255, width=width)
    assert at(shape, 0.0) == pytest.approx(1, abs=1e-6)
    for azimuth in (0.0, 1.0, 4.0):
        assert at(shape, width, azimuth) == pytest.approx(0.5, abs=2e-3)  # 255 texels, filtered


def test_the_rim_is_bright_at_grazing_and_soft_is_black_there():
    shape = SPECULAR_MAPS["rim"](size=255, width=0.4)
    assert at(shape, math.pi / 2 - 0.4, 2.0) == pytest.approx(0.5, abs=3e-3)
    assert at(shape, math.pi / 2 - 0.01) > 0.99 > 1e-4 > at(shape, 0.0)
    assert at(SPECULAR_MAPS["soft"](size=255), math.pi / 2 - 0.01) < 1e-3


def test_the_anisotropic_dot_is_drawn_out_along_x_both_ways():
    shape = SPECULAR_MAPS["anisotropic"](size=255, width=0.1, ratio=5.0)
    for azimuth, width in ((0, 0.5), (math.pi, 0.5), (math.pi / 2, 0.1), (-math.pi / 2, 0.1)):
        assert at(shape, width, azimuth) == pytest.approx(0.5, abs=5e-3)
    assert torch.equal(SPECULAR_MAPS["anisotropic"](ratio=1.0, width=0.25), SPECULAR_MAPS["anisotropic"](ratio=1.0, width=0.25))
    assert_close(SPECULAR_MAPS["anisotropic"](ratio=1.0, width=0.25), SPECULAR_MAPS["glossy"](width=0.25), 1e-6)


def test_noise_is_what_its_seed_says_and_stays_under_its_dot():
    first, again, other = (SPECULAR_MAPS["noise"](seed=seed) for seed in (3, 3, 4))
    assert torch.equal(first, again) and not torch.equal(first, other)
    assert bool((first <= SPECULAR_MAPS["glossy"](width=0.5)).all())


def test_controls_can_be_written():
    written = specular_map("anisotropic:ratio=6,width=0.1,size=16,colour=1/0.8/0.5,strength=2")
    assert torch.equal(written, SPECULAR_MAPS["anisotropic"](ratio=6, width=0.1, size=16, colour=(1, 0.8, 0.5), strength=2))
    assert torch.equal(specular_map("glossy"), SPECULAR_MAPS["glossy"]())


@pytest.mark.parametrize(("text", "said"), [
    ("glosy", "Did you mean 'glossy'"), ("glossy:widht=1", "Did you mean 'width'"), ("glossy:width=wide", "be a number"),
    ("glossy:width", "be a number"), ("glossy:width=1/2", "be one number"), ("glossy:colour=1", "three finite numbers"),
    ("glossy:ratio=2", "be one of"), ("", "be one of"),
])
def test_what_cannot_be_read_is_named(text, said):
    with pytest.raises(RangeError, match=said):
        specular_map(text)


@pytest.mark.parametrize("controls", [
    {"size": 0}, {"size": 2.5}, {"size": True}, {"strength": -1.0}, {"strength": math.nan}, {"width": 0.0}, {"width": math.nan},
    {"colour": (1, 1)}, {"colour": (1, -1, 1)}, {"colour": (1, math.inf, 1)},
])
@every_map
def test_controls_out_of_range_are_refused(name, controls):
    with pytest.raises(RangeError, match=next(iter(controls))):
        SPECULAR_MAPS[name](**controls)


def test_a_ratio_out_of_range_is_refused():
    with pytest.raises(RangeError, match="ratio"):
        SPECULAR_MAPS["anisotropic"](ratio=0.0)


@pytest.mark.parametrize("name", TILTS)
def test_tilt_curves_run_from_0_and_stay_within_0_and_1(name):
    curve = tilt_curve(name)
    assert curve.shape == (1, 1, 91) and curve.dtype == torch.float32
    assert float(curve.min()) >= 0 and float(curve.max()) <= 1 and float(curve[0, 0, 0]) == 0
    assert bool((curve.diff() >= 0).all())


def test_tilt_curves_by_hand():
    assert torch.equal(tilt_curve("default"), default_tilt())
    assert float(tilt_curve("velvet")[0, 0, 30]) == pytest.approx(0.5)
    assert float(tilt_curve("gentle")[0, 0, 60]) == pytest.approx(0.25)
    tilt_curve("flat").fill_(1)  # a copy: the table keeps what it holds
    assert float(TILTS["flat"].max()) == 0
    with pytest.raises(RangeError, match="Did you mean 'velvet'"):
        tilt_curve("velvt")
