"""Texture coordinates for meshes that have none: four projections, all of which keep a texture's aspect about right.

Each gives [F, 3, 2], a pair for each corner of each triangle, so that neighbours may lie apart in the texture. Up is y.
"""

from __future__ import annotations

import numpy as np

PROJECTIONS = ("box", "spherical", "cylindrical", "planar")
# (u axis, sign), (v axis, sign) of the sides +x, -x, +y, -y, +z, -z, each as one looks at it from outside.
_SIDES = (((2, -1), (1, 1)), ((2, 1), (1, 1)), ((0, 1), (2, -1)), ((0, 1), (2, 1)), ((0, 1), (1, 1)), ((0, -1), (1, 1)))
# A side is near when the normal's component is at least this part of its largest: a texture is stretched by 3 at most.
_CLOSE = 0.5
_ROUNDS = 6


def project(
    kind: str, position: np.ndarray, faces: np.ndarray, corner: np.ndarray, flat: np.ndarray
) -> np.ndarray:
    """Return uv [F, 3, 2] for triangles `faces` [F, 3], rows of `position` [V, 3], with unit normals `flat` [F, 3].

    `corner` [F, 3] are numbers from 0 that are equal where positions are.
    "box": seen along the axis that the triangle's normal is near, six sides, 1 of uv = the largest extent.
    "planar": the same, all seen from +z. "spherical": about the box's centre, u 0..4 round from +z toward +x, v 0..2
    from below to above. "cylindrical": about the upright axis, u a whole number round, so that a tiling texture closes,
    and v in the same measure from the lowest point up.
    """
    used = np.zeros(len(position), dtype=bool)
    used[faces] = True
    low, high = position[used].min(axis=0), position[used].max(axis=0)
    extent = (high - low).max()
    if kind == "box":
        return _box(position, faces, _sides(corner, flat), low, high) / extent
    if kind == "planar":
        return ((position - low)[:, :2] / extent)[faces]
    from_centre = (position - (low + high) / 2)[faces]
    ring = np.hypot(from_centre[..., 0], from_centre[..., 2])
    turns = _turns(from_centre, ring)
    if kind == "spherical":
        latitude = np.arctan2(from_centre[..., 1], ring)
        return np.stack((4 * turns, latitude * 2 / np.pi + 1), axis=-1)
    around = np.pi * (high - low)[[0, 2]].mean()
    repeats = max(1, round(around / extent))
    # A shape without width has no measure round its axis; its height then is the unit.
    per_height = repeats / around if around > 0 else 1 / extent
    return np.stack((repeats * turns, (position[faces, 1] - low[1]) * per_height), axis=-1)


def _box(
    position: np.ndarray, faces: np.ndarray, side: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Return uv in the mesh's own lengths, each side starting from 0 at its left and lower edge."""
    result = np.empty((*faces.shape, 2))
    for number, axes in enumerate(_SIDES):
        chosen = np.flatnonzero(side == number)
        rows = faces[chosen]
        for column, (axis, sign) in enumerate(axes):
            along = position[:, axis] - low[axis] if sign > 0 else high[axis] - position[:, axis]
            result[chosen, :, column] = along[rows]
    return result


def _sides(corner: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Return the side [F], into _SIDES, that each triangle is seen from: the nearest, or near ones' where it is close.

    Bumps would scatter a rough surface over several sides, with a seam round each bump. So triangles that lie between
    sides take, a few times over, the one that most of those about them have.
    """
    component = np.stack((flat, -flat), axis=-1).reshape(-1, 6)
    side = component.argmax(axis=1)
    largest = component.max(axis=1)
    near = component > _CLOSE * largest[:, None]
    close = np.flatnonzero(near.sum(axis=1) > 1)
    if not len(close):
        return side
    near, component = near[close], component[close]
    places = corner[close]
    votes = np.bincount((corner * 6 + side[:, None]).reshape(-1), minlength=6 * (int(corner.max()) + 1)).reshape(-1, 6)
    for _ in range(_ROUNDS):
        about = component.copy()
        for k in range(3):
            about += votes[places[:, k]]
        about[~near] = -np.inf
        before, after = side[close], about.argmax(axis=1)
        moved = np.flatnonzero(before != after)
        if not len(moved):
            break
        for k in range(3):
            np.subtract.at(votes.reshape(-1), places[moved, k] * 6 + before[moved], 1)
            np.add.at(votes.reshape(-1), places[moved, k] * 6 + after[moved], 1)
        side[close] = after
    return side


def _turns(from_axis: np.ndarray, ring: np.ndarray) -> np.ndarray:
    """Return longitude in turns [F, 3], 0 at +z, 0.25 at +x, without a jump inside a triangle.

    A corner on the axis, which has no longitude, takes the mean of its triangle's others.
    """
    turns = np.arctan2(from_axis[..., 0], from_axis[..., 2]) / (2 * np.pi) % 1
    on_axis = ring <= 1e-6 * ring.max()
    anchor = np.take_along_axis(turns, (~on_axis).argmax(axis=1)[:, None], axis=1)
    turns = turns - np.round(turns - anchor)
    count = np.maximum((~on_axis).sum(axis=1), 1)
    mean = np.where(on_axis, 0, turns).sum(axis=1) / count
    return np.where(on_axis, mean[:, None], turns)
