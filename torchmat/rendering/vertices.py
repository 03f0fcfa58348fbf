"""Normals and tangents at the corners of triangles, and corners that agree in everything joined into vertices.

Arrays are NumPy's, float64. A corner is one of the three of a triangle; [F, 3, ...] holds something for each. What is
made of millions of triangles is made block by block, and sorted only where corners of one place differ: time and memory
grow with the mesh, and little more than the result is held.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch

from torchmat import frames
from torchmat.rendering.edges import edge_pairs

# Triangles flatter than this, height over longest edge, are below float32's resolution: no ray meets one.
_FLAT = 1e-7
# A sum of unit tangents shorter than this part of their number has no direction worth the name.
_CANCELS = 1e-4
# A unit tangent that leaves less than this across the normal is along it; the rest is rounding.
_ALONG = 1e-6
_BLOCK = 1 << 14  # triangles: what is in hand then fits into the processor's cache
_MULTIPLIER, _SHIFT = np.uint64(0x9E3779B97F4A7C15), np.uint64(29)  # 2^64 over the golden ratio: spreads bits well


def distinct(*columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (first [n], group [rows]): one row of each group of rows that are equal in all integer columns.

    The same columns give the same numbers, which have no other meaning.
    """
    mixed = np.zeros(len(columns[0]), dtype=np.uint64)
    for column in columns:
        mixed = (mixed ^ (mixed >> _SHIFT) ^ column.astype(np.uint64)) * _MULTIPLIER
    order = np.argsort(mixed, kind="stable")
    new = _changes(mixed[order])
    differs = np.logical_or.reduce([_changes(column[order]) for column in columns])
    if not np.array_equal(new, differs):  # unequal rows met in one product: the sure way, several times slower
        order = np.lexsort(columns)
        new = np.logical_or.reduce([_changes(column[order]) for column in columns])
    group = np.empty(len(order), dtype=np.int64)
    group[order] = np.cumsum(new) - 1
    return order[new], group


def alike(place: np.ndarray, keys: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, int]:
    """Return numbers [n] that are equal where `place` [n] and every key are, and their count; some may be unused.

    A key (values, rows) is ``values[rows]``, rows [n]. Places are numbers from 0. All that agree with one corner of
    their place, as most do, take the number of the place; the others alone are sorted.
    """
    count = int(place.max()) + 1
    chosen = np.zeros(count, dtype=np.int64)
    chosen[place] = np.arange(len(place))
    same = np.ones(len(place), dtype=bool)
    for values, rows in keys:
        same &= values[rows] == values[rows[chosen]][place]
    numbers = place.astype(np.int64)
    others = np.flatnonzero(~same)
    if len(others):
        found, group = distinct(place[others], *(values[rows[others]] for values, rows in keys))
        numbers[others] = count + group
        count += len(found)
    return numbers, count


def blocks(count: int) -> Iterator[slice]:
    """Return slices that cover `count` triangles."""
    return (slice(start, min(start + _BLOCK, count)) for start in range(0, count, _BLOCK))


def _changes(ordered: np.ndarray) -> np.ndarray:
    new = np.ones(len(ordered), dtype=bool)
    np.not_equal(ordered[1:], ordered[:-1], out=new[1:])
    return new


def bits(values: np.ndarray) -> list[np.ndarray]:
    """Return the columns of [rows, n] as integers that are equal where the values, as float32, are; -0 is 0."""
    stored = np.ascontiguousarray(values.T, dtype=np.float32) + np.float32(0)
    return list(stored.view(np.int32))


# NumPy's sums over a last dimension of 3 take ten times as long as three terms written out.
def dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the dot product over the last dimension, of 2 or 3."""
    total = one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1]
    return total + one[..., 2] * other[..., 2] if one.shape[-1] == 3 else total


def unit(vector: np.ndarray) -> np.ndarray:
    """Scale to length 1 along the last dimension; zero stays zero, and so does what is below 1e-150."""
    length = np.sqrt(dot(vector, vector))
    return vector / np.where(length > 0, length, 1)[..., None]


def has_area(points: np.ndarray) -> np.ndarray:
    """Tell for triangles [F, 3, 2 or 3] whether they are more than a line or a point."""
    edges = points[:, [1, 2, 0]] - points
    longest = np.maximum(np.maximum(*(lengths := dot(edges, edges).T)[:2]), lengths[2])
    one, other = edges[:, 0], edges[:, 1]
    if points.shape[-1] == 2:
        double_area = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    else:
        normal = np.cross(one, other)
        double_area = np.sqrt(dot(normal, normal))
    return double_area > _FLAT * longest


def face_normals(points: np.ndarray) -> np.ndarray:
    """Return unit normals [F, 3] of triangles [F, 3, xyz] with area."""
    return unit(np.cross(unit(points[:, 1] - points[:, 0]), unit(points[:, 2] - points[:, 0])))


def corner_angles(points: np.ndarray) -> np.ndarray:
    """Return the angle in radians [F, 3] at each corner of triangles [F, 3, xyz]."""
    ahead = unit(points[:, [1, 2, 0]] - points)
    back = -ahead[:, [2, 0, 1]]
    return np.arccos(np.clip(dot(ahead, back), -1, 1))


def triangles_with_area(position: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Tell which triangles, bool [F], are more than a line or a point; `faces` [F, 3] are rows of `position`."""
    result = np.empty(len(faces), dtype=bool)
    for block in blocks(len(faces)):
        result[block] = has_area(position[faces[block]])
    return result


def flat_normals(position: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return unit normals [F, 3] of triangles with area."""
    result = np.empty((len(faces), 3))
    for block in blocks(len(faces)):
        result[block] = face_normals(position[faces[block]])
    return result


def _after(half_edge: np.ndarray) -> np.ndarray:
    """Return the corners that half-edges end in."""
    return np.where(half_edge % 3 == 2, half_edge - 2, half_edge + 1)


def _fans(corner: np.ndarray, normal: np.ndarray, crease: float) -> tuple[np.ndarray, int]:
    """Return a number [F * 3] for each corner, equal where smooth edges join the triangles about its point; the count.

    An edge is smooth where exactly two triangles meet in it, one way round each, at an angle of at most `crease`.
    """
    first, second, _ = edge_pairs(corner)
    points = corner.reshape(-1)
    smooth = points[first] != points[second]
    limit = np.cos(crease)
    for block in blocks(len(first)):
        smooth[block] &= dot(normal[first[block] // 3], normal[second[block] // 3]) >= limit
    first, second = first[smooth], second[smooth]
    one, other = np.concatenate((first, _after(first))), np.concatenate((_after(second), second))
    from scipy import sparse  # as in edges.py: only where a mesh is made
    from scipy.sparse import csgraph

    links = sparse.coo_array((np.ones(len(one), dtype=np.int8), (one, other)), shape=(len(points), len(points)))
    count, fan = csgraph.connected_components(links, directed=False)
    return fan, count


def smooth_normals(
    position: np.ndarray, faces: np.ndarray, corner: np.ndarray, crease: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return unit normals [N, 3], smooth but for edges above `crease` (radians), and the row [F, 3] of each corner.

    `faces` [F, 3] are rows of `position` [V, 3], `corner` [F, 3] numbers that are equal where positions are. A
    normal is the mean, weighted by the angle at the corner (Thuermer and Wuethrich 1998), over the fan of triangles
    that smooth edges connect about the point: so it is one and the same on both sides of a smooth edge.
    """
    flat = flat_normals(position, faces)
    fan, count = _fans(corner, flat, crease)
    total, angles = np.zeros((3, count)), np.zeros(count)
    rows = fan.reshape(-1, 3)
    for block in blocks(len(faces)):
        angle, at = corner_angles(position[faces[block]]), rows[block].reshape(-1)
        np.add.at(angles, at, angle.reshape(-1))
        for axis in range(3):
            np.add.at(total[axis], at, (angle * flat[block, axis, None]).reshape(-1))
    total = total.T
    # A fan that winds back on itself may sum to nothing; then each triangle keeps its own.
    lost = (np.sqrt(dot(total, total)) <= _CANCELS * angles)[rows]
    rows = rows.astype(np.int64)
    rows[lost] = count + np.arange(int(lost.sum()))
    return unit(np.concatenate((total, flat[np.nonzero(lost)[0]]))), rows


def _across(vector: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the part of a unit vector that is perpendicular to a unit normal, made length 1; 0 if there is none."""
    across = vector - dot(vector, normal)[..., None] * normal
    return unit(across * (dot(across, across) > _ALONG**2)[..., None])


def fallback_tangent(normal: np.ndarray) -> np.ndarray:
    """Return unit tangents [n, 3] for unit normals: +x, turned as +z is turned to the normal; continuous but at -z."""
    return _across(unit(frames.tangent_frame(torch.from_numpy(normal), dim=-1)[0].numpy()), normal)


def _side(uv: np.ndarray) -> np.ndarray:
    """Return the side [F] of the texture that triangles [F, 3, uv] show: 1, -1 mirrored, 0 where uv have no area."""
    step = uv[:, 1:] - uv[:, :1]
    return np.sign(step[:, 0, 0] * step[:, 1, 1] - step[:, 0, 1] * step[:, 1, 0]) * has_area(uv)


def _along(points: np.ndarray, uv: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Return unit dP/du [F, 3] of triangles."""
    edge, step = points[:, 1:] - points[:, :1], uv[:, 1:] - uv[:, :1]
    return unit((edge[:, 0] * step[:, 1, 1, None] - edge[:, 1] * step[:, 0, 1, None]) * side[:, None])


def join(
    position: np.ndarray, faces: np.ndarray, corner: np.ndarray, normal: np.ndarray, normal_of: np.ndarray,
    uv: np.ndarray, uv_of: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return (first, faces, tangent, handedness): corners that agree joined into V vertices, with tangents.

    `faces`, `normal_of` and `uv_of` [F, 3] are the rows that corners take of `position`, `normal` [n, 3] and `uv`
    [n, 2]; `corner` [F, 3] as in `smooth_normals`. `first` [V] is a corner (into F * 3) of each vertex, `faces` [F, 3]
    their numbers, `tangent` [V, 3], `handedness` [V].

    Section 4.1 of the thesis: tangents of faces are summed only where position, normal and texture coordinate are
    shared. We add that the texture must not be mirrored between them, and weigh each, laid into the plane of the
    normal, by the angle at its corner. Where no face has a direction, or they cancel, `fallback_tangent` stands in.
    """
    side = np.empty(len(faces))
    for block in blocks(len(faces)):
        side[block] = _side(uv[uv_of[block]])
    keys = [(column, rows.reshape(-1)) for table, rows in ((normal, normal_of), (uv, uv_of)) for column in bits(table)]
    group, count = alike(corner.reshape(-1), keys)
    del keys
    hand = np.repeat(side.astype(np.int8), 3)
    if not (hand == 1).all():
        # A triangle without texture area joins the vertices that are there: mirrored ones where there are no others.
        kinds = np.zeros((2, count), dtype=bool)
        kinds[0, group[hand > 0]] = kinds[1, group[hand < 0]] = True
        mirrored = ~kinds[0] & kinds[1]
        joins = np.where(mirrored[group].reshape(-1, 3).any(axis=1), -1, 1).astype(np.int8)
        hand = np.where(hand == 0, np.repeat(joins, 3), hand)
        group, count = alike(group, [(hand, np.arange(len(hand)))])
    first = np.full(count, -1)
    first[group] = np.arange(len(group))
    used = first >= 0
    vertex = (np.cumsum(used) - 1)[group].reshape(-1, 3)
    first = first[used]
    at = normal[normal_of.reshape(-1)[first]]
    tangent = _tangents(position, faces, vertex, at, uv, uv_of, side)
    return first, vertex, tangent, hand[first].astype(np.float64)


def _tangents(
    position: np.ndarray, faces: np.ndarray, vertex: np.ndarray, at: np.ndarray, uv: np.ndarray, uv_of: np.ndarray,
    side: np.ndarray,
) -> np.ndarray:
    """Return the tangents [V, 3] of vertices with unit normals `at` [V, 3]."""
    total, angles = np.zeros((3, len(at))), np.zeros(len(at))
    for block in blocks(len(faces)):
        points, row = position[faces[block]], vertex[block].reshape(-1)
        angle = corner_angles(points).reshape(-1)
        along = _across(np.repeat(_along(points, uv[uv_of[block]], side[block]), 3, axis=0), at[row])
        np.add.at(angles, row, angle)
        for axis in range(3):
            np.add.at(total[axis], row, angle * along[:, axis])
    total = total.T
    lost = np.sqrt(dot(total, total)) <= _CANCELS * angles
    total[lost] = fallback_tangent(at[lost])
    return _across(unit(total), at)
