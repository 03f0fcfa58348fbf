"""Functions on the unit square given by grids, one grid per angle of incidence, and the warp that makes one uniform.

What Mitsuba calls `Marginal2D`, as far as the evaluation of a measured BRDF needs it (Dupuy & Jakob 2018, section 4).
All of it is a gather of a few corners per point, so directions of any shape go through at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat import safe


@dataclass(frozen=True)
class Slices:
    """Numbers and weights of the grids that are blended at a point; all tensors broadcast with the points."""

    index: tuple[Tensor, ...]
    weight: tuple[Tensor, ...]

    def blend(self, table: Tensor, size: int, offset: Tensor) -> Tensor:
        """Return the blend of `table` [slices * size, ...] at `offset` inside the slices."""
        total = torch.zeros((), dtype=table.dtype)
        for index, weight in zip(self.index, self.weight, strict=True):
            found = table[index * size + offset]
            total = total + (weight if found.ndim == weight.ndim else weight[..., None]) * found
        return total


def find_slices(axes: tuple[Tensor, ...], places: tuple[Tensor, ...]) -> Slices:
    """Return the slices around `places` on a grid of `axes`, each [n] and increasing, the last running fastest.

    Beyond the ends of an axis the end counts.
    """
    index: tuple[Tensor, ...] = (torch.zeros((), dtype=torch.long),)
    weight: tuple[Tensor, ...] = (torch.ones((), dtype=axes[0].dtype),)
    for axis, place in zip(axes, places, strict=True):
        if len(axis) == 1:
            continue
        lower = (torch.searchsorted(axis, place.detach().contiguous(), right=True) - 1).clamp(0, len(axis) - 2)
        share = ((place - axis[lower]) / (axis[lower + 1] - axis[lower])).clamp(0, 1)
        index = tuple(i * len(axis) + step for i in index for step in (lower, lower + 1))
        weight = tuple(w * part for w in weight for part in (1 - share, share))
    return Slices(index, weight)


def _cell(place: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Return the cell between `count` grid lines over [0, 1] that `place` lies in, and where in it."""
    scaled = place * (count - 1)
    cell = scaled.detach().floor().clamp(0, count - 2)
    return cell.long(), scaled - cell


class Grid:
    """A function on the unit square, bilinear between values [slices, rows, columns] or [..., channels] of a grid."""

    def __init__(self, values: Tensor) -> None:
        self.rows, self.columns = values.shape[1:3]
        self.table = values.flatten(0, 2).contiguous()

    def at(self, x: Tensor, y: Tensor, slices: Slices) -> Tensor:
        """Return the value at `x` (along columns) and `y`, both in [0, 1]; channels come last."""
        column, dx = _cell(x, self.columns)
        row, dy = _cell(y, self.rows)
        size, corner = self.rows * self.columns, row * self.columns + column
        if self.table.ndim > 1:
            dx, dy = dx[..., None], dy[..., None]
        top = (1 - dx) * slices.blend(self.table, size, corner) + dx * slices.blend(self.table, size, corner + 1)
        corner = corner + self.columns
        bottom = (1 - dx) * slices.blend(self.table, size, corner) + dx * slices.blend(self.table, size, corner + 1)
        return (1 - dy) * top + dy * bottom


class Warp:
    """The map from a density on the unit square to a uniform one: first the rows, then the place in a row.

    `density` [slices, rows, columns], not negative, is bilinear between its values and brought to integral 1 slice by
    slice; sums are taken in float64 and kept in `dtype`. Blended slices blend their sums too, as Mitsuba does.
    """

    def __init__(self, density: Tensor, dtype: torch.dtype) -> None:
        self.rows, self.columns = density.shape[1:]
        density = density.double()
        within = torch.zeros(density.shape, dtype=torch.float64)
        within[..., 1:] = torch.cumsum((density[..., 1:] + density[..., :-1]) / 2, dim=-1)
        whole = within[..., -1]
        above = torch.zeros(whole.shape, dtype=torch.float64)
        above[:, 1:] = torch.cumsum((whole[:, 1:] + whole[:, :-1]) / 2, dim=-1)
        total = above[:, -1:]
        self.density = safe.divide(density, total[..., None]).to(dtype).flatten()
        self.within = safe.divide(within, total[..., None]).to(dtype).flatten()
        self.whole = safe.divide(whole, total).to(dtype).flatten()
        self.above = safe.divide(above, total).to(dtype).flatten()

    def invert(self, x: Tensor, y: Tensor, slices: Slices) -> tuple[Tensor, Tensor]:
        """Return where in the uniform square the point (`x`, `y`) of the density comes from."""
        column, dx = _cell(x, self.columns)
        row, dy = _cell(y, self.rows)
        size, corner = self.rows * self.columns, row * self.columns + column

        def between_rows(table: Tensor, offset: Tensor) -> Tensor:
            upper = slices.blend(table, size, offset)
            return (1 - dy) * upper + dy * slices.blend(table, size, offset + self.columns)

        left, right = between_rows(self.density, corner), between_rows(self.density, corner + 1)
        reached = between_rows(self.within, corner) + dx * (left + dx * (right - left) / 2)
        upper, lower = (slices.blend(self.whole, self.rows, row + step) for step in (0, 1))
        across = safe.divide(reached, (1 - dy) * upper + dy * lower)
        down = slices.blend(self.above, self.rows, row) + dy * (upper + dy * (lower - upper) / 2)
        return across, down
