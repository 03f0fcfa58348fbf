"""Which triangles meet in which edges, found in linear time."""

from __future__ import annotations

import numpy as np


def order_by(keys: np.ndarray, count: int) -> np.ndarray:
    """Return the numbers that sort `keys` [n], all from 0 to `count` - 1, equal ones in their order, in linear time."""
    from scipy import sparse  # here: a fit that draws nothing needs no mesh, and this takes a quarter of a second

    whole = sparse.csr_array(
        (np.ones(len(keys), dtype=np.int8), keys, np.arange(len(keys) + 1)), shape=(len(keys), count)
    )
    return whole.tocsc().indices  # a counting sort: the rows of each column


def edge_pairs(corner: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Return half-edges (first, second) that exactly two triangles share, and how many half-edges are in no such pair.

    `corner` [F, 3] are numbers from 0 that are equal where positions are. Half-edge k runs from corner k, into F * 3,
    to the next one of its triangle.
    """
    start, end = corner.reshape(-1), corner[:, [1, 2, 0]].reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    points = int(corner.max()) + 1
    order = order_by(high, points)
    order = order[order_by(low[order], points)]
    low, high = low[order], high[order]
    same = (low[1:] == low[:-1]) & (high[1:] == high[:-1])
    alone = same.copy()
    alone[1:] &= ~same[:-1]
    alone[:-1] &= ~same[1:]
    first, second = order[:-1][alone], order[1:][alone]
    return first, second, len(start) - 2 * len(first)


def open_edges(corner: np.ndarray) -> int:
    """Return how many half-edges are not met by exactly one that runs the other way: 0 in a closed surface."""
    first, second, others = edge_pairs(corner)
    start = corner.reshape(-1)
    return others + 2 * int((start[first] == start[second]).sum())
