"""Slow float64 oracles of the geometry room: plain loops over texels, all steps of a ray at once, sharing no code with the package."""

from __future__ import annotations

import math

import numpy as np


def bilinear(height: np.ndarray, u: float, v: float, tiles: bool) -> float:
    """Return the bilinear height at texture coordinates u (right), v (up)."""
    rows, columns = height.shape
    x, y = u * columns - 0.5, (1 - v) * rows - 0.5
    if not tiles:
        x, y = min(max(x, 0.0), columns - 1.0), min(max(y, 0.0), rows - 1.0)
    left, top = math.floor(x), math.floor(y)
    fx, fy = x - left, y - top

    def texel(row: int, column: int) -> float:
        if tiles:
            return float(height[row % rows, column % columns])
        return float(height[min(row, rows - 1), min(column, columns - 1)])

    upper = texel(top, left) * (1 - fx) + texel(top, left + 1) * fx
    lower = texel(top + 1, left) * (1 - fx) + texel(top + 1, left + 1) * fx
    return upper * (1 - fy) + lower * fy


def bilinear_along(height: np.ndarray, u: np.ndarray, v: np.ndarray, tiles: bool) -> np.ndarray:
    """Return what `bilinear` does at many places, [n] each."""
    rows, columns = height.shape
    x, y = u * columns - 0.5, (1 - v) * rows - 0.5
    if not tiles:
        x, y = np.clip(x, 0.0, columns - 1.0), np.clip(y, 0.0, rows - 1.0)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - left, y - top
    above, below = (r % rows if tiles else np.minimum(r, rows - 1) for r in (top, top + 1))
    near, far = (c % columns if tiles else np.minimum(c, columns - 1) for c in (left, left + 1))
    upper = height[above, near] * (1 - fx) + height[above, far] * fx
    lower = height[below, near] * (1 - fx) + height[below, far] * fx
    return upper * (1 - fy) + lower * fy


def cubic(height: np.ndarray, u: float, v: float, tiles: bool) -> float:
    """Return the height at u, v by Catmull and Rom's cubic convolution (Keys 1981, a = -0.5)."""
    rows, columns = height.shape
    x, y = u * columns - 0.5, (1 - v) * rows - 0.5
    left, top = math.floor(x), math.floor(y)

    def weight(distance: float) -> float:
        d = abs(distance)
        if d <= 1:
            return 1.5 * d**3 - 2.5 * d**2 + 1
        return -0.5 * d**3 + 2.5 * d**2 - 4 * d + 2 if d < 2 else 0.0

    total = 0.0
    for row in range(top - 1, top + 3):
        for column in range(left - 1, left + 3):
            r = row % rows if tiles else min(max(row, 0), rows - 1)
            c = column % columns if tiles else min(max(column, 0), columns - 1)
            total += weight(x - column) * weight(y - row) * float(height[r, c])
    return total


def refined(height: np.ndarray, factor: int, tiles: bool) -> np.ndarray:
    """Return the height at `factor` times its resolution, texel by texel."""
    rows, columns = height.shape[0] * factor, height.shape[1] * factor
    found = np.zeros((rows, columns))
    for row, column in np.ndindex(rows, columns):
        found[row, column] = cubic(height, (column + 0.5) / columns, 1 - (row + 0.5) / rows, tiles)
    return found


def slope_of(direction: np.ndarray, shape: tuple[int, int]) -> tuple[float, float]:
    """Return du, dv for each unit of height along `direction`, u in texture widths, v in texture heights."""
    return direction[0] / direction[2], direction[1] / direction[2] * shape[1] / shape[0]


def first_hit(height: np.ndarray, view: np.ndarray, u: float, v: float, tiles: bool, steps: int = 4000) -> float:
    """Return the height at which the view ray through (u, v, 0) first meets the surface, by tiny steps and bisection."""
    du, dv = slope_of(view, height.shape)
    low, high = float(height.min()), float(height.max())

    def gap(z: float) -> float:
        return bilinear(height, u + z * du, v + z * dv, tiles) - z

    heights = high - (high - low) * np.arange(steps + 1) / steps
    met = bilinear_along(height, u + heights * du, v + heights * dv, tiles) >= heights
    first = int(met.argmax()) if met.any() else steps
    above, below = float(heights[max(first - 1, 0)]), float(heights[first])
    for _ in range(60):
        middle = (above + below) / 2
        above, below = (middle, below) if gap(middle) < 0 else (above, middle)
    return (above + below) / 2


def least_clearance(height: np.ndarray, direction: np.ndarray, u: float, v: float, tiles: bool, steps: int = 4000) -> float:
    """Return the least (ray height - surface height) / distance over the ray from the surface toward `direction`."""
    du, dv = slope_of(direction, height.shape)
    run = math.hypot(du, dv)
    start, span = bilinear(height, u, v, tiles), float(height.max() - height.min())
    z = span * np.arange(1, steps + 1) / steps
    surface = bilinear_along(height, u + z * du, v + z * dv, tiles)
    return min(1 / run, float(((start + z - surface) / (z * run)).min()))


def sobel(height: np.ndarray, tiles: bool) -> np.ndarray:
    """Return the 3 x 3 Sobel response toward +x and +y (up), [2, H, W]."""
    rows, columns = height.shape

    def texel(row: int, column: int) -> float:
        if tiles:
            return float(height[row % rows, column % columns])
        return float(height[min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)])

    found = np.zeros((2, rows, columns))
    weights = {-1: 1.0, 0: 2.0, 1: 1.0}
    for row in range(rows):
        for column in range(columns):
            for side, weight in weights.items():
                found[0, row, column] += weight * (texel(row + side, column + 1) - texel(row + side, column - 1))
                found[1, row, column] += weight * (texel(row - 1, column + side) - texel(row + 1, column + side))
    return found
