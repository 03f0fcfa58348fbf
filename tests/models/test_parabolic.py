"""Parabolic maps whose texels lie evenly, or densely at the centre."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.distributions import distribution, shaded, unit

from torchmat.create.specular_maps import disc, specular_map
from torchmat.errors import RangeError
from torchmat.models import Distribution, blend
from torchmat.models.parabolic import DENSE, EVEN, SPACINGS, SPOT, evenly, places, respaced, texel_places


def _directions(count: int = 400) -> torch.Tensor:
    """Return directions [3, count, 1] from within a tenth of a degree of the pole to the horizon."""
    polar = torch.logspace(-4.5, math.log10(math.pi / 2), count, dtype=torch.float64)
    azimuth = 2.4 * torch.arange(count, dtype=torch.float64)
    sine = torch.sin(polar)
    return torch.stack((sine * torch.cos(azimuth), sine * torch.sin(azimuth), torch.cos(polar)))[..., None]


def test_even_places_are_the_parabolic_projection():
    light = unit(torch.tensor([0.3, -0.4, 1.2], dtype=torch.float64))[:, None, None]
    assert torch.equal(places(light), light[:2] / (1 + light[2]))


def test_dense_places_are_the_root_of_the_distance_and_end_on_the_rim():
    direction = _directions()
    far, dense = places(direction).norm(dim=0), places(direction, DENSE).norm(dim=0)
    outside = far > 30 * SPOT
    assert float((dense - far.sqrt())[outside].abs().max()) < 1e-3
    assert abs(float(dense[-1]) - 1) < 1e-5
    # In the spot they go straight with the distance, by 16: a root's slope would be infinite there.
    assert float((dense / far)[far < SPOT / 10].sub(16).abs().max()) < 0.05


def test_the_way_back_from_a_dense_place_is_exact():
    direction = _directions()
    assert float((evenly(places(direction, DENSE), DENSE) - places(direction)).abs().max()) < 1e-14
    assert not bool(evenly(torch.zeros(2, 1, 1), DENSE).any())


@pytest.mark.parametrize("spacing", SPACINGS)
def test_the_centre_has_a_gradient(spacing):
    direction = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None].requires_grad_()
    places(direction, spacing)[0].sum().backward()
    assert direction.grad is not None
    assert direction.grad.flatten().tolist() == pytest.approx([8.0 if spacing == DENSE else 0.5, 0, 0])


def test_a_dense_map_shows_a_sharp_highlight_that_an_even_one_smears():
    # Half of its height at a degree, where texels of an even map of 32 are 7 degrees wide.
    peak, light = math.radians(1.0), torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    polar = torch.linspace(0, 0.06, 60, dtype=torch.float64)
    half = torch.stack((torch.sin(polar), torch.zeros_like(polar), torch.cos(polar)))[:, None]
    view = 2 * half[2:] * half - light[:, None, None]
    errors = {}
    for spacing in SPACINGS:
        table = specular_map(f"glossy:width={peak}", 32, spacing).double()
        maps = {"diffuse": torch.zeros(3, 1, 60, dtype=torch.float64), "specular": table}
        material = Distribution(maps, parts=(), specular_spacing=spacing)
        with torch.no_grad():
            found = material.shade(light[:, None, None], view)
        share = view[2] + 1 - view[2] + 1e-4  # D of a light overhead, and what keeps it from 0
        wanted = math.pi * torch.exp2(-((polar / peak) ** 2)) / share
        errors[spacing] = float((found[0] - wanted).square().sum() / wanted.square().sum())
    assert errors[DENSE] < 0.04 < 0.5 < errors[EVEN], errors


def test_a_map_drawn_for_dense_texels_has_its_angles():
    polar, _ = disc(48, DENSE)
    wide = evenly(texel_places(48), DENSE).norm(dim=0)
    assert torch.allclose(polar, 2 * torch.atan(wide))
    assert float(polar.min()) < math.radians(0.35) and float(disc(48)[0].min()) > math.radians(3)
    with pytest.raises(RangeError, match="spacing"):
        disc(48, "dens")
    with pytest.raises(RangeError, match="spacing"):
        specular_map("glossy:spacing=1")


def test_a_map_of_one_spacing_becomes_one_of_the_other():
    for before, after in ((EVEN, DENSE), (DENSE, EVEN)):
        one, other = (specular_map("soft", 96, spacing).double() for spacing in (before, after))
        assert float((respaced(one, before, after) - other).abs().max()) < 0.012  # a texel at the rim is twice as wide
    table = specular_map("glossy", 12)
    assert respaced(table, DENSE, DENSE) is table


def test_materials_of_two_spacings_blend():
    parts = ("specular_mask", "masking")
    shapes = [specular_map("soft", 96, spacing) for spacing in SPACINGS]
    first, second = (
        distribution(4, 5, 1, parts, side=96, **({} if spacing == EVEN else {"specular_spacing": DENSE})).with_maps(specular=shape)
        for spacing, shape in zip(SPACINGS, shapes, strict=True)
    )
    half = blend(first, second, 0.5)
    assert half.specular_spacing == DENSE
    # Both show the same, but for where their texels lie.
    assert float((shaded(half) - shaded(first)).abs().max() / shaded(first).max()) < 5e-3
