"""The known directions around any other one: a triangulation of the hemisphere, and barycentric weights in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

_COLLINEAR = 1e-4  # directions closer than that count as one, so a strip as narrow has no inside
_BLOCK_VALUES = 1_000_000


@dataclass(frozen=True)
class Neighbours:
    """Around each of P directions: `index` [P, k] of known ones, `weight` [P, k] that add up to 1, and `ratio` [P].

    `ratio` is z of the direction over z of the one that the weights stand for: 1 among the known ones, and beyond them
    a share that falls to 0 at the horizon. `beyond` [P] is how far apart the two are in the disc, 0 among the known
    ones. All float64.
    """

    index: Tensor
    weight: Tensor
    ratio: Tensor
    beyond: Tensor


def to_disc(direction: Tensor) -> Tensor:
    """Return the parabolic projection ``(x, y) / (1 + z)`` [P, 2], float64, of unit directions [P, 3].

    Seen from -z it is the stereographic one, which turns circles into circles. A triangulation by empty circles
    (Delaunay) in the disc is therefore the one on the sphere; (x, y) itself would squeeze the horizon together.
    """
    x, y, z = direction.double().unbind(1)
    return torch.stack((x, y), dim=1) / (1 + z)[:, None]


def how_far_beyond(known: Tensor, wanted: Tensor) -> Tensor:
    """Return how far in the disc each of `wanted` [P, 3] lies outside of what encloses `known` [n, 3], unit, above the horizon, [P].

    It is what `Triangulation(known).find(wanted).beyond` says, without triangles: scipy's import takes as long as a small fit.
    """
    outline, points = _outline(to_disc(known).numpy()), to_disc(wanted).numpy()
    step = np.roll(outline, -1, axis=0) - outline
    offset = points[:, None] - outline
    along = (offset * step).sum(axis=2) / np.maximum((step**2).sum(axis=1), np.finfo(float).tiny)
    distance = np.linalg.norm(offset - along.clip(0, 1)[:, :, None] * step, axis=2).min(axis=1)
    left = step[:, 0] * offset[:, :, 1] - step[:, 1] * offset[:, :, 0] >= 0
    return torch.from_numpy(np.where(left.all(axis=1) & (len(outline) > 2), 0.0, distance))


def _outline(points: np.ndarray) -> np.ndarray:
    """Return the corners [m, 2] of the convex outline of points [n, 2], counter-clockwise (Andrew 1979, monotone chains)."""
    ordered = [tuple(point) for point in np.unique(points, axis=0).tolist()]
    if len(ordered) < 3:
        return np.array(ordered)
    chains = []
    for way in (ordered, ordered[::-1]):
        chain: list[tuple[float, float]] = []
        for x, y in way:
            while len(chain) > 1:
                (ax, ay), (bx, by) = chain[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                chain.pop()
            chain.append((x, y))
        chains.append(chain[:-1])
    return np.array(chains[0] + chains[1])


class Triangulation:
    """Known directions [n, 3] above the horizon, in any number and arrangement, a single one or an arc among them.

    `find` gives the corners of the triangle around a direction: three, two along an arc, or one.
    """

    def __init__(self, known: Tensor) -> None:
        self.points = to_disc(known).numpy()
        centred = self.points - self.points.mean(axis=0)
        _, spread, axes = np.linalg.svd(centred, full_matrices=False)
        self._axis = axes[0]
        self._cells: Any = None  # scipy's Delaunay
        if len(known) > 2 and spread[1] > _COLLINEAR * spread[0]:
            from scipy.spatial import Delaunay

            self._cells = Delaunay(self.points)
            self._from, self._to = self._cells.convex_hull.T
        else:
            order = np.argsort(self.points @ self._axis, kind="stable")
            self._from, self._to = order[:-1], order[1:]

    def find(self, wanted: Tensor) -> Neighbours:
        """Return the neighbours of unit directions `wanted` [P, 3], z > 0, with weights in float64.

        The weights are 1 for a known direction, continuous, and beyond the known ones those of the nearest point of
        their outline (in the disc).
        """
        points = to_disc(wanted.detach()).numpy()
        if len(self.points) == 1:
            index, weight = np.zeros((len(points), 1), dtype=np.int64), np.ones((len(points), 1))
            outside = np.ones(len(points), dtype=bool)
        elif self._cells is None:
            index, weight = self._along(points)
            outside = np.ones(len(points), dtype=bool)
        else:
            index, weight, outside = self._within(points)
        reached = (self.points[index[outside]] * weight[outside, :, None]).sum(axis=1)
        ratio = np.ones(len(points))
        # Both from the disc, so that rounding in float32 directions near the horizon cancels for a known one.
        ratio[outside] = _cosine(points[outside]) / _cosine(reached)
        beyond = np.zeros(len(points))
        beyond[outside] = np.linalg.norm(points[outside] - reached, axis=1)
        return Neighbours(*map(torch.from_numpy, (index, weight, ratio, beyond)))

    def _along(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the two known points around the foot of each point on the arc, [P, 2] each."""
        place = self.points @ self._axis
        known = np.append(place[self._from], place[self._to[-1]])
        foot = np.clip(points @ self._axis, known[0], known[-1])
        cell = np.clip(np.searchsorted(known, foot, side="right") - 1, 0, len(known) - 2)
        share = (foot - known[cell]) / np.maximum(known[cell + 1] - known[cell], np.finfo(float).tiny)
        return np.stack((self._from[cell], self._to[cell]), axis=1), np.stack((1 - share, share), axis=1)

    def _within(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the corners [P, 3] around each point, their weights [P, 3], and where it lies outside of all cells."""
        cell = self._cells.find_simplex(points)
        outside = cell < 0
        index = self._cells.simplices[cell].astype(np.int64)
        corners = self.points[index]
        first, second, third = corners[:, 0], corners[:, 1], corners[:, 2]
        areas = np.stack(
            (_area(points, second, third), _area(first, points, third), _area(first, second, points)), axis=1
        )
        # Rounding puts a point on an edge a hair beyond it.
        areas = np.maximum(areas * np.sign(_area(first, second, third))[:, None], 0)
        total = areas.sum(axis=1, keepdims=True)
        weight = np.divide(areas, total, out=np.full_like(areas, 1 / 3), where=total > 0)
        if outside.any():
            index[outside], weight[outside] = self._on_outline(points[outside])
        return index, weight, outside

    def _on_outline(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends of the outline's nearest edge, with a third that counts 0, and their weights, [P, 3] each."""
        start, edge = self.points[self._from], self.points[self._to] - self.points[self._from]
        length = (edge**2).sum(axis=1)
        nearest = np.empty(len(points), dtype=np.int64)
        share = np.empty(len(points))
        step = max(1, _BLOCK_VALUES // len(edge))
        for first in range(0, len(points), step):
            block = slice(first, first + step)
            offset = points[block, None] - start
            along = np.clip((offset * edge).sum(axis=2) / length, 0, 1)
            distance = ((offset - along[:, :, None] * edge) ** 2).sum(axis=2)
            nearest[block] = distance.argmin(axis=1)
            share[block] = np.take_along_axis(along, nearest[block, None], axis=1)[:, 0]
        ends = np.stack((self._from[nearest], self._to[nearest], self._to[nearest]), axis=1)
        return ends.astype(np.int64), np.stack((1 - share, share, np.zeros_like(share)), axis=1)


def _cosine(points: np.ndarray) -> np.ndarray:
    """Return z [P] of the directions that lie at `points` [P, 2] of the disc; 0 at its rim and beyond."""
    squared = (points**2).sum(axis=1)
    return np.maximum(1 - squared, 0) / (1 + squared)


def _area(first: np.ndarray, second: np.ndarray, third: np.ndarray) -> np.ndarray:
    """Return twice the signed area [P] of triangles with corners [P, 2]."""
    one, other = second - first, third - first
    return one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]


def nearest_pairs(known: Tensor, wanted: Tensor) -> Tensor:
    """Return for each of `wanted` [m, 4] which of `known` [n, 4] is nearest; both are (light, view) in the disc."""
    from scipy.spatial import cKDTree

    return torch.from_numpy(cKDTree(known.numpy()).query(wanted.numpy())[1].astype(np.int64))
