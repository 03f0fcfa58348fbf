"""Rbf: its spline by hand, at its knots and far from them; tables that do not fit."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.examples import assert_same, directions, make, make_maps, per_image

from torchmat.errors import RangeError, ShapeError
from torchmat.models import Rbf
from torchmat.models.rbf import coordinates

UP = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)


def one_knot(**more) -> Rbf:
    """Return a grey texel of 1 whose weight is 0.2 + 3 |light - up|^3, seen from above."""
    table = torch.zeros(3, 1, 10, dtype=torch.float64)
    table[..., 0], table[..., 1] = 3.0, 0.2
    maps = {
        "component": torch.ones(1, 1, 1, dtype=torch.float64), "weight": table, "half_scale": torch.zeros(1, dtype=torch.float64),
        "knots": torch.cat((UP, UP), dim=1).T[:, None], "reach": torch.tensor([-9.0, 9.0], dtype=torch.float64).repeat(3, 1, 1), **more,
    }
    return Rbf(maps, components=1)


def test_a_knot_alone_by_hand(dtype):
    light = torch.tensor([[math.sin(0.5), 0.0, math.cos(0.5)]], dtype=dtype)
    value = one_knot().to(dtype).shade(per_image(light), per_image(UP.to(dtype)))
    wanted = 0.2 + 3 * (2 * math.sin(0.25)) ** 3  # the chord of half a radian, cubed
    assert_same(value, torch.full((1, 3, 1, 1), wanted, dtype=dtype))


def test_beyond_its_reach_no_weight_goes():
    reach = torch.tensor([0.1, 0.5], dtype=torch.float64).repeat(3, 1, 1)
    far = per_image(directions(1, lowest=0.0) * 0 + torch.tensor([[0.99, 0.0, 0.141]], dtype=torch.float64))
    assert_same(one_knot(reach=reach).shade(far, per_image(UP)), torch.full((1, 3, 1, 1), 0.5, dtype=torch.float64))
    assert float(one_knot().shade(far, per_image(UP)).detach().max()) > 3


def test_it_is_smooth_through_a_knot_and_the_normal():
    # Of the half vector's spread the azimuth has no meaning at the normal, and a root of the distance no slope at a knot.
    material = make("rbf", {"components": 2})
    knots = material.maps["knots"][:, 0].T.detach()
    for light, view in ((knots[:, :3], knots[:, 3:]), (UP, UP)):
        slopes = []
        for turn in (1e-4, 0.0, -1e-4):
            tilt = torch.tensor([[0.0, -math.sin(turn), 0.0]], dtype=torch.float64)
            moved = per_image(torch.nn.functional.normalize(light + tilt, dim=1)).requires_grad_()
            material.shade(moved, per_image(view)).sum().backward()
            slopes.append(moved.grad[:, 1, 0, 0])
        both = torch.stack(slopes)
        assert float((both - both[1]).abs().max()) < 2e-2 * (1 + float(both.abs().max()))


def test_narrow_highlights_are_told_apart_near_the_normal():
    tilts = torch.tensor([0.0, 0.02, 0.3, 0.32], dtype=torch.float64)
    light = torch.stack((torch.sin(2 * tilts), 0 * tilts, torch.cos(2 * tilts)), dim=1)
    places = coordinates(light, UP.expand(4, 3), torch.tensor([2.0], dtype=torch.float64))[:, 0]
    assert_same(places, 2 * torch.asinh(10 * torch.sin(tilts)), 1e-12)
    assert float(places[1] - places[0]) > 3 * float(places[3] - places[2])
    assert bool((coordinates(light, UP.expand(4, 3), torch.zeros(1, dtype=torch.float64))[:, :2] == 0).all())


@pytest.mark.parametrize(("name", "columns"), [("weight", 14), ("reach", 2)])
def test_tables_must_fit_the_knots(name, columns):
    maps = make_maps("rbf", {"components": 2})
    with pytest.raises(ShapeError, match=f"{name} must have 1 row and {columns} columns; it is .* with 5 knots"):
        Rbf({**maps, name: maps[name][..., 1:]}, components=2)


@pytest.mark.parametrize("bad", [0, 2.5, "8"])
def test_components_are_whole_and_positive(bad):
    with pytest.raises(RangeError, match="components must be a whole number of at least 1; it is"):
        Rbf({}, components=bad)
