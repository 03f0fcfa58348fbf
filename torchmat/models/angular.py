"""Values known at some pairs of light and view, interpolated to any other pair.

Factorised models (PCA) have numbers at the measured directions only. Between them we fit a plane to the nearest
neighbours in the four projected coordinates (light x, y, view x, y), weighted by inverse distance (moving least
squares); at a measured direction this returns the measured number.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat.fast import neighbours as fast_neighbours

NEIGHBOURS = 12
# Distances are compared in whole numbers of this part of 1, about the last place of single precision. Their squares are
# exact in double precision, so that directions as far are known to be, and the one with the lower number is nearer.
_ONE = 2.0**24
_QUERIES = 4096  # at a time: what stays in the processor's cache
_SLOPE_DAMPING = 0.05  # of the weighted spread; too few or coplanar neighbours fall back to a weighted mean


def neighbour_weights(known: Tensor, light: Tensor, view: Tensor) -> tuple[Tensor, Tensor]:
    """Return (index [q, k], weight [q, k]) such that the sum of weight * table[index] interpolates a table [n, C].

    `known` [n, 4] are projected directions, `light` and `view` [q, 3] unit vectors. Weights sum to 1. Of neighbours as near
    those with the lower number count.
    """
    queries = projected(light, view)
    found = nearby(known, light, view)
    if found is not None:
        return found[0].long(), found[1]
    index = _nearest(_whole(known), _whole(queries))
    weight = [_local_weights(known[some], part) for some, part in zip(index.split(_QUERIES), queries.split(_QUERIES), strict=True)]
    return index, torch.cat(weight)


def nearby(known: Tensor, light: Tensor, view: Tensor) -> tuple[Tensor, Tensor] | None:
    """Return what `neighbour_weights` does, numbers in 32 bits, by the compiled part; None where that is for plain torch."""
    return fast_neighbours.neighbours(known, projected(light, view), _whole(known), _ONE)


def _whole(directions: Tensor) -> Tensor:
    return (directions.detach().double() * _ONE).round()


def _nearest(known: Tensor, queries: Tensor) -> Tensor:
    """Return the numbers [q, k] of the nearest known directions, by a tree: a thirteenth of the time of all distances."""
    from scipy.spatial import cKDTree  # here: most models interpolate nothing, and it takes a tenth of a second

    count = min(NEIGHBOURS, len(known))
    asked = min(count + 1, len(known))
    away, index = (torch.from_numpy(one) for one in cKDTree(known.numpy()).query(queries.numpy(), k=range(1, asked + 1)))
    if asked > count:
        # The tree takes any of those as far as the last; roots of squares that differ may be the same.
        tied = (away[:, count] <= away[:, count - 1] * (1 + 1e-15)).nonzero()[:, 0]
        for some in tied.split(_QUERIES):
            squared = (queries[some][:, None] - known).square().sum(dim=2)
            index[some, :count] = squared.sort(dim=1, stable=True).indices[:, :count]
    return index[:, :count]


def _local_weights(points: Tensor, queries: Tensor) -> Tensor:
    """Return the weights [q, k] of the nearest `points` [q, k, 4]."""
    # Differences squared, not the expanded form: at a measured direction the distance must be exactly 0.
    distance = (queries[:, None] - points).square().sum(dim=2)
    scale = distance.amax(dim=1, keepdim=True).clamp(min=1e-12)
    # The square of the inverse distance, falling to 0 at the last neighbour so that none drops out with a jump.
    near = (1 / (distance / scale + 1e-7) ** 1.0) * (1 - 0.999 * distance / scale)
    near = near / near.sum(dim=1, keepdim=True)
    return _plane(near, points, queries, scale[..., None])


def _plane(near: Tensor, points: Tensor, queries: Tensor, scale: Tensor) -> Tensor:
    """Turn mean weights into those of a fitted plane's value at the query: near * (1 - slope correction)."""
    # Measured from the first neighbour: a coordinate that all share then has no spread at all, not one of rounding
    # errors, whose slope would be noise far larger than 1. The second damping meets directions equal but for rounding.
    first = points[:, :1]
    offset = points - first
    mean = (near[..., None] * offset).sum(dim=1, keepdim=True)
    spread = offset - mean
    centre = mean + (first - queries[:, None, :])
    moment = torch.einsum("qk,qki,qkj->qij", near, spread, spread)
    trace = moment.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None]
    damped = moment + (_SLOPE_DAMPING * trace + 1e-6 * scale) * torch.eye(moment.shape[-1], dtype=moment.dtype)
    slope = torch.linalg.solve(damped, centre.transpose(1, 2))
    return near * (1 - (spread @ slope)[..., 0])


def projected(light: Tensor, view: Tensor) -> Tensor:
    """Return the projected coordinates [n, 4] of unit vectors [n, 3]."""
    return torch.cat((light[:, :2], view[:, :2]), dim=1)


def pairs(light: Tensor, view: Tensor) -> tuple[Tensor, Tensor, torch.Size]:
    """Flatten planes of directions to rows [q, 3], and return the shape [..., h, w] that rows go back to."""
    light, view = torch.broadcast_tensors(light, view)
    shape = light.shape[:-3] + light.shape[-2:]
    return light.movedim(-3, -1).reshape(-1, 3), view.movedim(-3, -1).reshape(-1, 3), shape
