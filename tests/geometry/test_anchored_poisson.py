"""Slopes and heights known from elsewhere, joined by least squares: against a dense solve, and at both extremes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.support import assert_close

from torchmat.errors import RangeError, ShapeError
from torchmat.geometry import integrate, poisson

TRACE = 1e-3  # of the largest weight of slopes, which the package keeps everywhere


def tiling(rows: int, columns: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A height that tiles, and slopes whose means over neighbours are its exact rises: hence tan(k / 2) for k / 2."""
    across, down = (2 * math.pi * torch.arange(size, dtype=torch.float64) / size for size in (columns, rows))
    a, b = 2 * math.pi / columns, 2 * math.pi / rows
    height = 0.03 * torch.sin(across)[None, :] + 0.02 * torch.cos(down)[:, None]
    x = 0.03 * 2 * math.tan(a / 2) * torch.cos(across)[None, :].expand(rows, columns)
    y = 0.02 * 2 * math.tan(b / 2) * torch.sin(down)[:, None].expand(rows, columns)  # up is against the rows
    return height[None] + 0.1, torch.stack((x, y)) * columns


def open_border(rows: int, columns: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A tilted bowl, which does not tile; slopes of a quadratic averaged over an edge are its exact rise."""
    x = (torch.arange(columns, dtype=torch.float64) / columns).expand(rows, columns)
    y = -(torch.arange(rows, dtype=torch.float64) / columns)[:, None].expand(rows, columns)
    height = 0.4 * (x * x + y * y) + 0.2 * x - 0.1 * y + 0.3 * x * y
    return height[None] + 0.1, torch.stack((0.8 * x + 0.2 + 0.3 * y, 0.8 * y - 0.1 + 0.3 * x))


SURFACES = {True: tiling, False: open_border}
both = pytest.mark.parametrize("tiles", [True, False], ids=["tiling", "open"])
sizes = pytest.mark.parametrize("size", [(12, 12), (9, 16), (17, 6)])


@both
@sizes
def test_slopes_and_anchor_that_agree_are_left_alone(size, tiles):
    height, slopes = SURFACES[tiles](*size)
    found = poisson(slopes, tiles=tiles, anchor=height, anchor_weight=torch.full_like(height, 20.0))
    assert_close(found, height, 1e-10)


@both
@sizes
def test_a_few_known_heights_hold_exact_slopes_in_place(size, tiles):
    height, slopes = SURFACES[tiles](*size)
    known = torch.zeros_like(height)
    known[0, 1, 2] = known[0, -2, -1] = 50.0
    wrong = torch.where(known > 0, height, torch.randn_like(height))
    found = poisson(slopes, tiles=tiles, anchor=wrong, anchor_weight=known)
    # Conjugate gradients stop at 1e-5 of the right-hand side: measured 1e-5.
    assert_close(found, height, 1e-4)


@both
@sizes
def test_an_anchor_of_huge_weight_is_returned(size, tiles):
    anchor = torch.randn(1, *size, dtype=torch.float64)
    slopes = torch.randn(2, *size, dtype=torch.float64)
    found = poisson(slopes, tiles=tiles, anchor=anchor, anchor_weight=torch.full_like(anchor, 1e12))
    assert_close(found, anchor, 1e-7)
    weak = poisson(slopes, tiles=tiles, anchor=anchor, anchor_weight=torch.full_like(anchor, 1.0))
    assert float((weak - anchor).abs().max()) > 0.1  # the slopes do say otherwise


@both
@sizes
def test_an_anchor_of_tiny_weight_gives_its_mean_alone(size, tiles):
    anchor = torch.randn(1, *size, dtype=torch.float64) * 0.05 + 0.2
    height, slopes = SURFACES[tiles](*size)
    found = poisson(slopes, tiles=tiles, anchor=anchor, anchor_weight=torch.full_like(anchor, 1e-9))
    assert float(found.mean()) == pytest.approx(float(anchor.mean()), abs=1e-7)
    assert_close(found - found.mean(), height - height.mean(), 1e-7)


def dense(
    slopes: np.ndarray, weight: np.ndarray, anchor: np.ndarray, anchor_weight: np.ndarray, tiles: bool
) -> np.ndarray:
    """Return the minimum of sum w (rise - slope)^2 + sum p (h - anchor)^2 over all edges and texels, by loops."""
    rows, columns = weight.shape
    trust = weight + TRACE * weight.max()
    slopes = np.where(weight > 0, slopes, 0.0)
    matrix, right = np.zeros((rows * columns,) * 2), np.zeros(rows * columns)
    for row in range(rows):
        for column in range(columns):
            here = row * columns + column
            matrix[here, here] += anchor_weight[row, column]
            right[here] += anchor_weight[row, column] * anchor[row, column]
            for channel, (other_row, other_column) in enumerate(((row, column + 1), (row - 1, column))):
                if not tiles and (other_row < 0 or other_column >= columns):
                    continue
                other_row, other_column = other_row % rows, other_column % columns
                there = other_row * columns + other_column
                slope = (slopes[channel, row, column] + slopes[channel, other_row, other_column]) / 2
                share = min(trust[row, column], trust[other_row, other_column])
                # An edge is 1 / columns texture widths long, across and up.
                difference = np.zeros(rows * columns)
                difference[there] += columns
                difference[here] -= columns
                matrix += share * np.outer(difference, difference)
                right += share * slope * difference
    return np.linalg.solve(matrix, right).reshape(1, rows, columns)


@both
@pytest.mark.parametrize("size", [(5, 5), (4, 7), (6, 3), (1, 5), (5, 1), (1, 1)])
@pytest.mark.parametrize("residual", [1e-13, None], ids=["converged", "as it stops"])
def test_random_weights_against_a_dense_solve(size, tiles, residual, monkeypatch):
    if residual is not None:
        monkeypatch.setattr(integrate, "TOLERANCE", residual)
    random = np.random.default_rng(size[0] * 10 + size[1])
    slopes = random.normal(size=(2, *size))
    weight = random.uniform(0.1, 3, size)
    weight[0, 0] = 5.0
    if size[0] > 3 < size[1]:
        weight[2, 1:3] = 0
        slopes[:, 2, 1:3] = 40.0  # what a hole holds is no slope
    anchor = random.normal(size=size)
    anchor_weight = random.uniform(0, 60, size) * (random.random(size) > 0.3)
    anchor_weight[-1, -1] = 30.0
    expected = dense(slopes, weight, anchor, anchor_weight, tiles)
    given = [torch.from_numpy(value) for value in (slopes, weight[None], anchor[None], anchor_weight[None])]
    found = poisson(given[0], given[1], tiles, given[2], given[3])
    # Stopped at 1e-5 of the right-hand side, the worst is the hole of trust 1e-3: measured 2e-3.
    assert_close(found, torch.from_numpy(expected), 1e-9 if residual else 5e-3)


@both
@pytest.mark.parametrize("strength", [1e-8, 1e-4])
def test_one_known_height_sets_the_offset_however_weakly(strength, tiles):
    """Nothing else says where the surface stands, so the weight must not matter; the start has the wrong mean."""
    height, slopes = SURFACES[tiles](9, 16)
    anchor, known = torch.zeros_like(height), torch.zeros_like(height)
    anchor[0, 4, 4], known[0, 4, 4] = height[0, 4, 4] + 1, strength
    found = poisson(slopes, tiles=tiles, anchor=anchor, anchor_weight=known)
    assert_close(found, height + 1, 1e-6)


@both
def test_a_hole_in_the_slopes_is_bridged_by_the_anchor(tiles):
    height, slopes = SURFACES[tiles](20, 24)
    bumped = height.clone()
    bumped[0, 8:11, 10:14] += 0.05  # only the anchor knows of it
    weight = torch.ones_like(height)
    weight[0, 6:13, 8:16] = 0
    slopes[:, 6:13, 8:16] = 30.0
    known = torch.where(weight > 0, 10.0, 1e4)
    found = poisson(slopes, weight, tiles, bumped, known)
    # The trace of weight that smooths holes pulls the bump's walls: 1e-3 * 24^2 against 1e4; measured 9e-5.
    assert_close(found, bumped, 1e-3)
    alone = poisson(slopes, weight, tiles)
    assert float((alone - alone.mean() - bumped + bumped.mean()).abs().max()) > 0.03


def test_single_precision_stays_single():
    height, slopes = tiling(12, 16)
    found = poisson(slopes.float(), anchor=height.float(), anchor_weight=torch.full_like(height, 9.0).float())
    assert found.dtype == torch.float32
    assert_close(found, height.float(), 1e-5)


@pytest.mark.parametrize(("bad", "fact"), [(-1.0, "negative"), (0.0, "all are 0"), (float("nan"), "NaN")])
def test_bad_anchor_weights_are_refused_by_name(bad, fact):
    weight = torch.full((1, 4, 5), bad)
    with pytest.raises(RangeError, match=f"poisson: anchor_weight must.*{fact}"):
        poisson(torch.zeros(2, 4, 5), anchor=torch.zeros(1, 4, 5), anchor_weight=weight)
    one = torch.ones(1, 4, 5)
    one[0, 2, 3] = bad
    if bad != 0:
        with pytest.raises(RangeError, match="poisson: anchor_weight must"):
            poisson(torch.zeros(2, 4, 5), anchor=torch.zeros(1, 4, 5), anchor_weight=one)


def test_an_anchor_that_is_not_finite_is_refused_by_name():
    anchor = torch.zeros(1, 4, 5)
    anchor[0, 1, 1] = float("inf")
    with pytest.raises(RangeError, match="poisson: anchor must be finite"):
        poisson(torch.zeros(2, 4, 5), anchor=anchor)


@pytest.mark.parametrize("shape", [(1, 5, 4), (1, 4, 4), (2, 4, 5)])
@pytest.mark.parametrize("name", ["weight", "anchor", "anchor_weight"])
def test_maps_of_another_size_are_refused_by_name(name, shape):
    given = {"anchor": torch.zeros(1, 4, 5), name: torch.ones(shape)}
    with pytest.raises(ShapeError, match=f"poisson: {name} must be"):
        poisson(torch.zeros(2, 4, 5), **given)
