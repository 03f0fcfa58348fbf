"""Rays against a height field, against a slow oracle and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.reference import relief as oracle

from torchmat.errors import RangeError, ShapeError
from torchmat.geometry import clearance, rays, soft_shadow, trace_view, visible
from torchmat.geometry.rays import texel_centres


def unit(x: float, y: float, z: float, dtype=torch.float64) -> torch.Tensor:
    vector = torch.tensor([x, y, z], dtype=dtype)
    return (vector / vector.norm())[:, None, None]


def smooth_height(rows: int, columns: int, seed: int = 0, amplitude: float = 0.08) -> torch.Tensor:
    """A tileable height of a few waves, with an offset."""
    random = np.random.default_rng(seed)
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
    total = np.zeros((rows, columns))
    for _ in range(4):
        a, b = random.integers(-2, 3, 2)
        total += random.uniform(0.3, 1) * np.cos(2 * np.pi * (a * u + b * v) + random.uniform(0, 6))
    total = (total - total.min()) / max(np.ptp(total), 1e-9)
    return torch.from_numpy(amplitude * total + 0.01)[None]


@pytest.mark.parametrize("tiles", [True, False])
def test_the_oracle_finds_the_same_at_many_places_as_one_by_one(tiles):
    height = smooth_height(5, 7)[0].numpy()
    u, v = np.random.default_rng(2).uniform(-1.5, 2.5, (2, 200))
    one_by_one = [oracle.bilinear(height, *place, tiles) for place in zip(u.tolist(), v.tolist(), strict=True)]
    assert np.array_equal(oracle.bilinear_along(height, u, v, tiles), one_by_one)


VIEWS = [(0.0, 0.0, 1.0), (0.5, 0.2, 0.8), (-0.9, 0.3, 0.6), (0.3, -0.95, 0.35)]


@pytest.mark.parametrize("tiles", [True, False])
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("size", [(12, 16), (16, 9)])
def test_hits_agree_with_the_oracle(view, size, tiles):
    height = smooth_height(*size)
    hits = trace_view(height, unit(*view), tiles=tiles)
    direction = unit(*view)[:, 0, 0].numpy()
    centres = texel_centres(*size, dtype=torch.float64)
    worst = 0.0
    for row in range(size[0]):
        for column in range(size[1]):
            u, v = centres[:, row, column].tolist()
            expected = oracle.first_hit(height[0].numpy(), direction, u, v, tiles)
            worst = max(worst, abs(expected - float(hits.height[0, row, column])))
    # Regula falsi ends within a thousandth of the relief's 0.08; a missed first crossing would be off by far more.
    assert worst < 8e-5


@pytest.mark.parametrize("light", VIEWS[1:])
@pytest.mark.parametrize("tiles", [True, False])
def test_clearance_agrees_with_the_oracle(light, tiles):
    height = smooth_height(10, 14, seed=3)
    free = clearance(height, unit(*light), tiles=tiles)[0]
    direction = unit(*light)[:, 0, 0].numpy()
    centres = texel_centres(10, 14, dtype=torch.float64)
    for row in range(10):
        for column in range(14):
            u, v = centres[:, row, column].tolist()
            expected = oracle.least_clearance(height[0].numpy(), direction, u, v, tiles)
            # One step a texel against 4,000: the least lies between two steps, measured at most 0.06 apart.
            assert abs(expected - float(free[row, column])) < 0.1
            assert float(free[row, column]) >= expected - 1e-9


def test_a_plane_moves_by_its_height_times_the_slope_of_the_view():
    height = torch.full((1, 8, 8), 0.1, dtype=torch.float64)
    hits = trace_view(height, unit(1.0, 0.0, 1.0))
    moved = hits.uv - texel_centres(8, 8, dtype=torch.float64)
    assert torch.allclose(moved[0], torch.full((8, 8), 0.1, dtype=torch.float64), atol=1e-9)
    assert torch.allclose(moved[1], torch.zeros(8, 8, dtype=torch.float64), atol=1e-9)


def test_v_counts_in_texture_heights_on_a_map_that_is_not_square():
    height = torch.full((1, 8, 16), 0.1, dtype=torch.float64)
    moved = trace_view(height, unit(0.0, 1.0, 1.0)).uv - texel_centres(8, 16, dtype=torch.float64)
    assert torch.allclose(moved[1], torch.full((8, 16), 0.2, dtype=torch.float64), atol=1e-9)


def test_a_wall_casts_its_shadow_away_from_the_light():
    height = torch.zeros(1, 16, 32, dtype=torch.float64)
    height[..., 15:17] = 0.1
    lit = soft_shadow(height, unit(1.0, 0.0, 1.0), softness=1e-3)[0]
    # At 45 degrees the shadow of 0.1 is 0.1 wide, 3.2 of 32 texels, and lies left of the wall; texel 12 just meets its edge.
    assert float(lit[8, 13:15].max()) == 0.0
    assert float(lit[8, 5:10].min()) == 1.0 and float(lit[8, 18:28].min()) == 1.0


def test_the_penumbra_widens_with_softness_and_stays_in_range():
    height = smooth_height(24, 24, seed=5)
    light = unit(0.8, 0.4, 0.4)
    hard, soft = soft_shadow(height, light, 1e-3), soft_shadow(height, light, 0.6)
    partly = [float(((s > 0.01) & (s < 0.99)).double().mean()) for s in (hard, soft)]
    assert partly[1] > partly[0] + 0.1
    assert float(soft.min()) >= 0 and float(soft.max()) <= 1


def test_light_at_or_below_the_horizon_gives_nothing():
    height = smooth_height(8, 8)
    for z in (0.0, -0.3):
        lit = soft_shadow(height, torch.tensor([0.9, 0.1, z], dtype=torch.float64)[:, None, None])
        assert float(lit.abs().max()) == 0.0


def test_straight_up_everything_is_seen_and_nothing_moves():
    height = smooth_height(9, 9)
    hits = trace_view(height, unit(0.0, 0.0, 1.0))
    assert torch.allclose(hits.uv, texel_centres(9, 9, dtype=torch.float64))
    assert torch.allclose(hits.height, height, atol=1e-6)
    assert bool(visible(height, unit(0.0, 0.0, 1.0)).all())


def test_one_view_an_image_equals_one_view_a_pixel():
    height = smooth_height(10, 12)
    per_image = torch.stack([unit(*view) for view in VIEWS])
    per_pixel = per_image.expand(-1, -1, 10, 12)
    assert torch.allclose(trace_view(height, per_image).uv, trace_view(height, per_pixel).uv, atol=1e-12)
    assert torch.allclose(soft_shadow(height, per_image), soft_shadow(height, per_pixel), atol=1e-9)


@pytest.mark.parametrize("tiles", [True, False])
def test_shifted_maps_equal_looked_up_ones(monkeypatch, tiles):
    height = smooth_height(20, 24)
    views = torch.stack([unit(*view) for view in VIEWS[1:]])
    looked_up = trace_view(height, views, tiles=tiles), clearance(height, views, tiles=tiles)
    monkeypatch.setattr(rays, "SHIFT_TEXELS", 1)
    shifted = trace_view(height, views, tiles=tiles), clearance(height, views, tiles=tiles)
    assert torch.allclose(looked_up[0].uv, shifted[0].uv, atol=1e-9)
    assert torch.allclose(looked_up[1], shifted[1], atol=1e-9)


def test_gradient_in_the_height_is_that_of_the_implicit_equation():
    height = smooth_height(10, 10, amplitude=0.05).requires_grad_()
    view = unit(0.5, 0.3, 0.8)
    weight = torch.randn(1, 10, 10, dtype=torch.float64)
    (gradient,) = torch.autograd.grad((trace_view(height, view).height * weight).sum(), height)
    random = torch.randn_like(height)
    step = 1e-3
    with torch.no_grad():
        values = [(trace_view(height + sign * step * random, view).height * weight).sum() for sign in (1, -1)]
    numeric = float((values[0] - values[1]) / (2 * step))
    # The root itself is found to about 1e-6, which central differences divide by their step: measured 0.2 % apart.
    assert abs(numeric - float((gradient * random).sum())) < 0.01 * abs(numeric)


def test_gradient_of_the_shadow_reaches_the_height():
    height = smooth_height(8, 8).requires_grad_()
    soft_shadow(height, unit(0.9, 0.2, 0.3), 0.5).sum().backward()
    assert bool(torch.isfinite(height.grad).all()) and float(height.grad.abs().max()) > 0


def test_deep_relief_at_75_degrees_enters_the_tile_from_the_other_side():
    polar = math.radians(75)
    height = torch.zeros(1, 16, 16, dtype=torch.float64)
    height[..., :2] = 1.0  # a step of the full range at the left border
    view = unit(math.sin(polar), 0.0, math.cos(polar))
    hits = trace_view(height, view)
    # From the middle the ray climbs to the right, leaves the tile and meets the wall on its left border.
    assert float(hits.uv[0, 8, 8]) > 0.9
    assert float(hits.height[0, 8, 8]) > 0.05
    assert not bool(visible(height, view)[0, 8, 12])


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 1), (3, 5)])
def test_odd_sizes_and_flat_maps_are_finite(size, dtype):
    height = torch.rand(1, *size, dtype=dtype) * 0.1
    view = unit(0.6, 0.2, 0.7, dtype)
    assert bool(torch.isfinite(trace_view(height, view).uv).all())
    assert bool(torch.isfinite(soft_shadow(torch.zeros_like(height), view)).all())
    assert float(soft_shadow(torch.zeros_like(height), view).min()) == 1.0


def test_rays_along_the_horizon_are_finite():
    height = smooth_height(6, 6)
    for z in (1e-4, 1e-12, 0.0):
        hits = trace_view(height, torch.tensor([1.0, 0.0, z], dtype=torch.float64)[:, None, None])
        assert bool(torch.isfinite(hits.uv).all())


def test_wrong_input_is_refused():
    with pytest.raises(ShapeError, match="height"):
        trace_view(torch.zeros(8, 8), unit(0, 0, 1))
    with pytest.raises(ShapeError, match="direction"):
        trace_view(torch.zeros(1, 8, 8), torch.zeros(3))
    with pytest.raises(RangeError, match="softness"):
        soft_shadow(torch.zeros(1, 8, 8), unit(0, 0, 1), 0.0)
