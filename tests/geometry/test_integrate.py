"""Slopes to height: exact on what the method can represent, and sane where data is missing."""

from __future__ import annotations

import math

import pytest
import torch
from tests.support import assert_close

from torchmat.errors import RangeError, ShapeError
from torchmat.geometry import frankot_chellappa, poisson


def waves(rows: int, columns: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A tileable height in texture widths with mean 0, and its exact slopes toward +x and +y."""
    u = (torch.arange(columns, dtype=torch.float64) + 0.5) / columns
    v = (rows / columns) * (1 - (torch.arange(rows, dtype=torch.float64) + 0.5) / rows)
    v, u = torch.meshgrid(v, u, indexing="ij")
    a, b = 2 * math.pi, 2 * math.pi * columns / rows
    height = 0.03 * torch.sin(a * u) + 0.02 * torch.cos(b * v) + 0.01 * torch.sin(a * u + 2 * b * v)
    x = 0.03 * a * torch.cos(a * u) + 0.01 * a * torch.cos(a * u + 2 * b * v)
    y = -0.02 * b * torch.sin(b * v) + 0.02 * b * torch.cos(a * u + 2 * b * v)
    return height[None], torch.stack((x, y))


@pytest.mark.parametrize("size", [(16, 16), (15, 24), (33, 12)])
def test_tiling_waves_come_back_exactly(size):
    height, slopes = waves(*size)
    assert_close(frankot_chellappa(slopes), height, 1e-10)


def test_single_precision_stays_single():
    height, slopes = waves(16, 16)
    found = frankot_chellappa(slopes.float())
    assert found.dtype == torch.float32
    assert_close(found, height.float(), 1e-5)


def bowl(size: int = 40) -> tuple[torch.Tensor, torch.Tensor]:
    """A surface that does not tile: a paraboloid, tilted."""
    axis = (torch.arange(size, dtype=torch.float64) + 0.5) / size - 0.5
    up, across = torch.meshgrid(-axis, axis, indexing="ij")
    height = 0.4 * (across**2 + up**2) + 0.2 * across - 0.1 * up
    return (height - height.mean())[None], torch.stack((0.8 * across + 0.2, 0.8 * up - 0.1))


def test_poisson_gives_a_tilted_bowl_exactly():
    height, slopes = bowl()
    # Slopes of a quadratic averaged over an edge are its exact rise.
    assert_close(poisson(slopes, tiles=False), height, 1e-5)


def test_mirrored_transform_keeps_the_tilt_of_a_map_that_does_not_tile():
    height, slopes = bowl()
    mirrored = float((frankot_chellappa(slopes, tiles=False) - height).norm() / height.norm())
    periodic = float((frankot_chellappa(slopes, tiles=True) - height).norm() / height.norm())
    # The mirror has a kink at the border, where a transform rings: measured 0.03 against 0.6 without it.
    assert mirrored < 0.06 < 0.3 < periodic


def test_a_hole_with_garbage_is_bridged():
    height, slopes = bowl()
    weight = torch.ones(1, 40, 40, dtype=torch.float64)
    weight[:, 15:22, 18:24] = 0
    slopes[:, 15:22, 18:24] = 50.0
    found = poisson(slopes, weight, tiles=False)
    outside = weight[0] > 0
    difference = found - height
    difference = difference - difference[0][outside].mean()
    # The trace of weight that smooths the hole lets a little of the garbage through: measured 2e-4 of the range.
    assert float(difference[0][outside].abs().max()) < 2e-3 * float(height.max() - height.min())
    naive = frankot_chellappa(slopes, tiles=False)
    assert float((naive - height).abs().max()) > 0.3


def test_poisson_equals_frankot_chellappa_on_smooth_tiling_slopes():
    height, slopes = waves(64, 64)
    # Edges average two slopes, which damps the finest wave by its sampling: measured 1.3 % here.
    assert_close(poisson(slopes), height, 0.03)


@pytest.mark.parametrize("size", [(1, 1), (1, 8), (8, 1), (2, 3)])
@pytest.mark.parametrize("solve", [frankot_chellappa, poisson])
@pytest.mark.parametrize("tiles", [True, False])
def test_small_maps_are_finite_with_mean_zero(size, solve, tiles):
    found = solve(torch.randn(2, *size, dtype=torch.float64), tiles=tiles)
    assert found.shape == (1, *size)
    assert bool(torch.isfinite(found).all())
    assert abs(float(found.mean())) < 1e-12


def test_flat_stays_flat():
    for solve in (frankot_chellappa, poisson):
        assert float(solve(torch.zeros(2, 9, 9)).abs().max()) == 0.0


def test_wrong_input_is_refused():
    with pytest.raises(ShapeError, match="slopes"):
        frankot_chellappa(torch.zeros(3, 4, 4))
    with pytest.raises(RangeError, match="finite"):
        poisson(torch.full((2, 4, 4), float("nan")))
    with pytest.raises(RangeError, match="negative"):
        poisson(torch.zeros(2, 4, 4), torch.full((1, 4, 4), -1.0))
    with pytest.raises(RangeError, match="all are 0"):
        poisson(torch.zeros(2, 4, 4), torch.zeros(1, 4, 4))
