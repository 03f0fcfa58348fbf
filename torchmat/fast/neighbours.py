"""The nearest measured directions, their weights, and what PCA makes of them, by the compiled part: without gradients."""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.fast.call import call, fits, wants_gradient
from torchmat.fast.directions import Directions
from torchmat.fast.switch import library

_CELLS, _MOST_ON_A_SIDE, _MOST_FACTORS, _EIGHT, _MOST_PAIRS = 32, 512, 64, 8, 65536  # as in neighbours.h
_FEWEST = 4096  # queries: below it a tree is as fast, for the cells must be made first
_MOST_HOLES = 4  # places for a pair of light and view that there may be for each one that is known
_MOST_NEIGHBOURS = 12


class _Side(NamedTuple):
    """The distinct lights, or views: places [n, 2], and by cells their distances from the centre and their order [cells, n]."""

    places: Tensor
    away: Tensor
    order: Tensor


def neighbours(known: Tensor, queries: Tensor, whole: Tensor, one: float) -> tuple[Tensor, Tensor] | None:
    """Return the numbers (int32) and the weights [q, k] of the nearest of `known` [n, 4] to `queries` [q, 4].

    `whole` are the known in whole numbers, of which `one` make 1. None where that is for plain torch, which it is for
    known pairs that are not few lights by few views.
    """
    found = library()
    if found is None or len(queries) < _FEWEST or len(known) > _MOST_PAIRS or not fits(known, queries) or wants_gradient(known, queries):
        return None
    made = _sides(whole, one)
    if made is None or not bool(queries.abs().amax() <= 2):  # or no number
        return None
    lights, views, sample = made
    count = min(_MOST_NEIGHBOURS, len(known))
    index, weight = torch.empty(len(queries), count, dtype=torch.int32), known.new_empty(len(queries), count)
    call(
        found, "neighbours", known.detach().contiguous(), queries.detach().contiguous(), *lights, *views, sample, index, weight,
        len(lights.places), len(views.places), len(queries), count,
    )
    return index, weight


def components(
    light: Tensor, view: Tensor, index: Tensor, weight: Tensor, table: Tensor, layers: Tensor
) -> Tensor | None:
    """Return what is shown [..., 3, H, W] of `layers` [3 K, H, W]; None where that is for plain torch.

    `index` and `weight` [q, k] pick the factors of each texel of each sample from a `table` [n, K].
    """
    found = library()
    maps = (weight, table, layers)
    if found is None or not fits(light, view, *maps) or wants_gradient(light, view, *maps) or table.shape[1] > _MOST_FACTORS:
        return None
    pair = Directions.of(light, view, layers.shape[-2:])
    out, texels, terms = pair.new_value(), layers.shape[-2] * layers.shape[-1], table.shape[1]
    rows = functional.pad(table.detach(), (0, -terms % _EIGHT)).contiguous()
    call(
        found, "components", *pair.planes, index, weight, rows, layers.detach().contiguous(), out, *pair.sizes,
        pair.count, texels, index.shape[1], terms, rows.shape[1],
    )
    return out


def _sides(whole: Tensor, one: float) -> tuple[_Side, _Side, Tensor] | None:
    """Return lights, views, and the number of the sample of each pair [lights, views], -1 for none."""
    lights, of_light = torch.unique(whole[:, :2], dim=0, return_inverse=True)
    views, of_view = torch.unique(whole[:, 2:], dim=0, return_inverse=True)
    if max(len(lights), len(views)) > _MOST_ON_A_SIDE or len(lights) * len(views) > _MOST_HOLES * len(whole):
        return None
    sample = torch.full((len(lights), len(views)), -1, dtype=torch.int32)
    sample[of_light, of_view] = torch.arange(len(whole), dtype=torch.int32)
    if int((sample >= 0).sum()) < len(whole):  # one pair is known twice
        return None
    return _side(lights, one), _side(views, one), sample


def _side(places: Tensor, one: float) -> _Side:
    axis = ((torch.arange(_CELLS, dtype=torch.float64) + 0.5) / (_CELLS / 2) - 1) * one
    row, column = torch.meshgrid(axis, axis, indexing="ij")
    away = torch.hypot(column.reshape(-1, 1) - places[:, 0], row.reshape(-1, 1) - places[:, 1])
    away, order = away.sort(dim=1)
    return _Side(places.contiguous(), away.contiguous(), order.to(torch.int32).contiguous())
