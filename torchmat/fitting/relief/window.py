"""Windows: a part of the texels, and the images around it as far as parallax reaches."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.btf import Btf

_MARGIN = 3  # texels that bicubic interpolation looks beyond a place, and one for rounding


class Window(NamedTuple):
    """Texels from row `top` and column `left`, `height` x `width` of them, or every `step`-th both ways."""

    top: int
    left: int
    height: int
    width: int
    step: int = 1

    @property
    def rows(self) -> slice:
        """Its rows in the whole."""
        return slice(self.top, self.top + self.height, self.step)

    @property
    def columns(self) -> slice:
        """Its columns in the whole."""
        return slice(self.left, self.left + self.width, self.step)

    def crop(self, maps: Tensor) -> Tensor:
        """Return maps [..., H, W] of the whole at the window's texels."""
        return maps[..., self.rows, self.columns]

    def of(self, btf: Btf) -> Btf:
        """Return the same samples of just these texels."""
        return btf.window(*self)


@dataclass(frozen=True)
class Surroundings:
    """Images from row `top` and column `left` of a surface that is unrolled, in windows that stand side by side."""

    parts: list[list[Btf]]
    top: int
    left: int
    whole: tuple[int, int]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in texels."""
        return sum(row[0].height for row in self.parts), sum(part.width for part in self.parts[0])

    def images(self, rows: Tensor, dtype: torch.dtype) -> Tensor:
        """Return chosen images [k, 3, h, w], linear."""
        return self._joined(lambda btf: btf.images(rows, dtype))

    def valid(self, rows: Tensor) -> Tensor:
        """Return where chosen images hold data, bool [k, 1, h, w]."""
        return self._joined(lambda btf: btf.valid(rows))

    def clipped(self, rows: Tensor) -> Tensor:
        """Return where chosen images are clipped, bool [k, 1, h, w]."""
        return self._joined(lambda btf: btf.clipped(rows))

    def _joined(self, read: Callable[[Btf], Tensor]) -> Tensor:
        if len(self.parts) == len(self.parts[0]) == 1:
            return read(self.parts[0][0])
        return torch.cat([torch.cat([read(part) for part in row], dim=-1) for row in self.parts], dim=-2)

    def place(self, uv: Tensor) -> Tensor:
        """Return texture coordinates [..., 2, h, w] of the whole as coordinates of this part."""
        (rows, columns), (height, width) = self.size, self.whole
        u, v = uv[..., 0, :, :], uv[..., 1, :, :]
        if columns < width:
            u = (u * width - self.left) / columns
        if rows < height:
            v = 1 - ((1 - v) * height - self.top) / rows
        return torch.stack((u, v), dim=-3)


def surroundings(btf: Btf, window: Window, reach: tuple[float, float], tiles: bool) -> Surroundings:
    """Return the images around a window, `reach` (rows, columns) texels beyond it; on the other side where it tiles."""
    rows = _runs(window.top, window.height, reach[0], btf.height, tiles)
    columns = _runs(window.left, window.width, reach[1], btf.width, tiles)
    parts = [[btf.window(top, left, height, width) for left, width in columns[1]] for top, height in rows[1]]
    return Surroundings(parts, rows[0], columns[0], (btf.height, btf.width))


def _runs(first: int, length: int, reach: float, whole: int, tiles: bool) -> tuple[int, list[tuple[int, int]]]:
    """Return where the surroundings begin along one side, unrolled, and the runs (first, length) they are read in."""
    margin = math.ceil(reach) + _MARGIN
    low, high = first - margin, first + length + margin
    if not tiles:
        low, high = max(0, low), min(whole, high)
    if high - low >= whole:
        return 0, [(0, whole)]
    runs, at = [], low
    while at < high:
        start = at % whole
        runs.append((start, min(whole - start, high - at)))
        at += runs[-1][1]
    return low, runs
