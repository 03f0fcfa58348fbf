"""Which texels of a height field see each other: form factors, by rays over the sphere of directions.

A ray of one direction starts in every texel at once, so one step along all of them is a shift of the whole map.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat import frames
from torchmat.geometry.normals import check_height, normals_from_slopes, slopes_from_height

DIRECTIONS = 160
_LOWEST = -0.7  # z of the lowest directions: a steep texel looks down, too
_FARTHEST = 2  # textures that a ray is followed for
_CLEAR = 1e-3  # texels that a ray has to be below the surface by: one that grazes its own plane meets nothing


def form_factors(height: Tensor, tiles: bool = True, directions: int | None = None) -> Tensor:
    """Return how much of what each texel receives comes from each other, a sparse matrix [H W, H W].

    Row i holds the share of the cosine-weighted sphere over texel i that texel j fills, so its sum is what the relief hides of
    the sky there; the product with values [H W, C] is the light that arrives by way of other texels, in the unit in which
    a white texel that a light of 1 hits along its normal sends 1.

    Args:
        height: [1, H, W] in texture widths.
        tiles: whether the relief repeats; else rays that leave it meet nothing.
        directions: rays of a texel; None is 160.

    Raises ShapeError or RangeError when the height is not one.
    """
    check_height("form_factors", height)
    directions = DIRECTIONS if directions is None else directions
    rows, columns = height.shape[-2:]
    normal = normals_from_slopes(slopes_from_height(height, tiles=tiles))
    factors: list[Tensor] = []
    sources: list[Tensor] = []
    targets: list[Tensor] = []
    ground = (height[0] - height.min()) * columns  # texels
    every = torch.arange(rows * columns).reshape(rows, columns)
    share = 2 * (1 - _LOWEST) / directions  # the solid angle of a ray over pi
    for x, y, z in frames.spiral(directions, _LOWEST).tolist():
        towards = torch.tensor([x, y, z], dtype=height.dtype)[:, None, None]
        weight = ((normal * towards).sum(dim=0) * share).clamp(min=0)
        met = _first_met(ground, every, (x, y, z), tiles)
        found = (met >= 0) & (weight > 0)
        targets.append(every[found])
        sources.append(met[found])
        factors.append(weight[found])
    index = torch.stack((torch.cat(targets), torch.cat(sources)))
    size = rows * columns
    return torch.sparse_coo_tensor(index, torch.cat(factors), (size, size), check_invariants=False).coalesce()


def _first_met(ground: Tensor, every: Tensor, direction: tuple[float, float, float], tiles: bool) -> Tensor:
    """Return the number [H, W] of the texel that a ray from each texel meets first, -1 for none; heights in texels."""
    x, y, z = direction
    across = math.hypot(x, y)
    none = torch.full_like(every, -1)
    if across < 1e-6:
        return none
    (x, y), rise = (x / across, -y / across), z / across  # of one texel's way; rows run downward
    top, met = float(ground.max()), none
    farthest = _FARTHEST * max(ground.shape) if tiles else max(ground.shape)
    longest = farthest if rise <= 0 else min(farthest, math.ceil(top / rise))
    start = ground + _CLEAR
    for step in range(1, longest + 1):
        there, number = (_shifted(one, step * x, step * y, tiles) for one in (ground, every))
        hit = (there > start + step * rise) & (met < 0) & (number >= 0)
        met = torch.where(hit, number, met)
        if rise <= 0 and bool((met >= 0).all()):
            break
    return met


def _shifted(values: Tensor, right: float, down: float, tiles: bool) -> Tensor:
    """Return what stands so many texels to the right and below of each texel: heights blended, numbers of the nearest."""
    if not values.is_floating_point():
        return _moved(values, round(right), round(down), tiles, -1)
    left, top = math.floor(right), math.floor(down)
    a, b = right - left, down - top
    corners = [_moved(values, left + i, top + j, tiles, -math.inf) for j in (0, 1) for i in (0, 1)]
    upper, lower = (left * (1 - a) + right * a if a else left for left, right in (corners[:2], corners[2:]))
    return upper * (1 - b) + lower * b if b else upper


def _moved(values: Tensor, right: int, down: int, tiles: bool, outside: float) -> Tensor:
    if tiles:
        return torch.roll(values, (-down, -right), (0, 1))
    rows, columns = values.shape
    if abs(right) >= columns or abs(down) >= rows:
        return torch.full_like(values, outside)
    padded = functional.pad(values, (max(0, -right), max(0, right), max(0, -down), max(0, down)), value=outside)
    return padded[max(0, down) : max(0, down) + rows, max(0, right) : max(0, right) + columns]
