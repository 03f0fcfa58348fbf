"""Polygons cut into triangles: fans where a fan covers the polygon, ears where it does not (Meisters 1975)."""

from __future__ import annotations

from collections import deque

import numpy as np

# Of the polygon's area: a triangle below this has turned over, or is a line.
_NOTHING = 1e-9
_TURN = 1e-14  # of the square of its size: a corner that bends less is straight
_LARGEST = 20_000
_MANY = 24  # reflex corners; for more NumPy's overhead is the smaller part
_TRIES = 60  # candidates for an ear, times the corners: more have only polygons that cross themselves, or are spirals


def triangulate(position: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return triangles [F, 3] as numbers into `corners`, for polygons with `sizes` corners each, one after the other.

    `corners` [sum of sizes] are rows of `position` [V, 3]. Triangles turn as their polygon does, and those of a polygon
    follow each other. Polygons need be neither convex nor plane: they are looked at along the mean normal (Newell). One
    that crosses itself has no right answer; what is left of it when no ear is to be found is fanned. Sizes are 3 or more.
    """
    if (sizes == 3).all():
        return np.arange(len(corners)).reshape(-1, 3)
    starts = np.cumsum(sizes) - sizes
    first = np.cumsum(sizes - 2) - (sizes - 2)
    result = np.empty((int((sizes - 2).sum()), 3), dtype=np.int64)
    for size in np.unique(sizes):
        chosen = np.flatnonzero(sizes == size)
        ring = starts[chosen, None] + np.arange(size)
        local = _triangles(position, corners[ring]) if size > 3 else np.array([[[0, 1, 2]]])
        result[first[chosen, None] + np.arange(size - 2)] = starts[chosen, None, None] + local
    return result


def _triangles(position: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return triangles [P, n - 2, 3] as numbers below n for polygons `rows` [P, n] of one size."""
    count, size = rows.shape
    points = position[rows] - position[rows[:, :1]]
    with np.errstate(over="ignore", invalid="ignore"):  # numbers without bound are looked for afterwards
        normal = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
        area = np.sqrt((normal * normal).sum(axis=1))
        fan = np.stack(np.broadcast_arrays(0, np.arange(1, size - 1), np.arange(2, size)), axis=-1)
        result = np.repeat(fan[None], count, axis=0)
        flat = ~(np.isfinite(area) & (area > 0))  # any cut of nothing is as good
        normal = normal / np.where(flat, 1, area)[:, None]
        left = np.flatnonzero(~flat)
        for turn in range(min(size, 8)):
            turned = (fan + turn) % size
            good = _all_face(points[left], turned, normal[left], area[left])
            result[left[good]] = turned
            left = left[~good]
            if not len(left):
                return result
        if size > _LARGEST:
            # The work grows with the square of the corners; such a polygon is an outline, not a face.
            raise ValueError(f"a polygon that is not convex has {size} corners, more than {_LARGEST}: triangulate the mesh")
        for number in left:
            result[number] = _ears(_seen_along(points[number], normal[number]), size)
    return result


def _all_face(points: np.ndarray, triangles: np.ndarray, normal: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Tell for polygons [P, n, 3] whether all their `triangles` [n - 2, 3] face along the normal."""
    a, b, c = (points[:, triangles[:, k]] for k in range(3))
    facing = (np.cross(b - a, c - a) * normal[:, None]).sum(axis=-1)
    return (facing > _NOTHING * area[:, None]).all(axis=1)


def _seen_along(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the polygon [n, 2] in a plane in which it runs counter-clockwise, its area 1/2 or so."""
    axis = int(np.abs(normal).argmax())
    flat = points[:, [(axis + 1) % 3, (axis + 2) % 3]]
    if normal[axis] < 0:
        flat = flat[:, ::-1]
    return flat / max(float(np.ptp(flat, axis=0).max()), 1e-300)


def _ears(flat: np.ndarray, size: int) -> list[tuple[int, int, int]]:
    """Return triangles of a polygon [n, 2], counter-clockwise, by clipping ears."""
    after, before = [*range(1, size), 0], [size - 1, *range(size - 1)]
    xy = flat.tolist()

    def bend(corner: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = xy[before[corner]], xy[corner], xy[after[corner]]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    reflex = {corner for corner in range(size) if bend(corner) <= _TURN}
    triangles: list[tuple[int, int, int]] = []
    there, fresh = [True] * size, True
    waiting, tries = deque(range(size)), _TRIES * size
    while len(triangles) < size - 3 and tries > 0:
        if not waiting:
            if not fresh:
                break  # it crosses itself
            # What was no ear may be one now that corners inside of it are gone.
            waiting, fresh = deque(corner for corner in range(size) if there[corner]), False
        corner, tries = waiting.popleft(), tries - 1
        if not there[corner] or corner in reflex:
            continue
        one, other = before[corner], after[corner]
        if not _is_empty(flat, xy, reflex, one, corner, other):
            continue
        triangles.append((one, corner, other))
        after[one], before[other], there[corner], fresh = other, one, False, True
        for beside in (one, other):
            (reflex.add if bend(beside) <= _TURN else reflex.discard)(beside)
        waiting += (one, other)
    corner = there.index(True)
    second, third = after[corner], after[after[corner]]
    while third != corner:
        triangles.append((corner, second, third))
        second, third = third, after[third]
    return triangles


def _is_empty(flat: np.ndarray, xy: list, reflex: set[int], a: int, b: int, c: int) -> bool:
    """Tell whether no reflex corner lies in a triangle, or on its border elsewhere than in a corner of it."""
    ends = (xy[a], xy[b], xy[c])
    if len(reflex) > _MANY:
        inside = flat[list(reflex)]
        for k in range(3):
            (px, py), (qx, qy) = ends[k - 1], ends[k]
            inside = inside[(qx - px) * (inside[:, 1] - py) - (qy - py) * (inside[:, 0] - px) >= 0]
        return all(point in ends for point in inside.tolist())
    for corner in reflex:
        x, y = point = xy[corner]
        if point in ends:
            continue
        if all(
            (qx - px) * (y - py) - (qy - py) * (x - px) >= 0
            for (px, py), (qx, qy) in zip(ends, (*ends[1:], ends[0]), strict=True)
        ):
            return False
    return True
