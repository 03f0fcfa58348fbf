"""Normals and tangents at the corners of triangles, and corners that agree in everything joined into vertices.

Arrays are NumPy's, float64. A corner is one of the three of a triangle; [F, 3, ...] holds something for each.
"""

from __future__ import annotations

import numpy as np
import torch

from torchmat import frames

# Triangles flatter than this, height over longest edge, are below float32's resolution: no ray meets one.
_FLAT = 1e-7
# A sum of unit tangents shorter than this part of their number has no direction worth the name.
_CANCELS = 1e-4
# A unit tangent that leaves less than this across the normal is along it; the rest is rounding.
_ALONG = 1e-6
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


def _linked(count: int, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return for each of `count` things the lowest number among those that chains of links join it to."""
    label = np.arange(count)
    while True:
        low = np.minimum(label[one], label[other])
        if np.array_equal(label[one], low) and np.array_equal(label[other], low):
            return label
        np.minimum.at(label, label[one], low)
        np.minimum.at(label, label[other], low)
        label = label[label]


def _smooth_links(corner: np.ndarray, normal: np.ndarray, crease: float) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of corners (numbers into F * 3) that lie at one end of an edge across which the surface is smooth.

    An edge is smooth where exactly two triangles meet in it, one way round each, at an angle of at most `crease`.
    """
    count = len(corner)
    start, end = np.arange(3 * count), np.arange(3 * count).reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)
    points = corner.reshape(-1)
    low, high = np.minimum(points[start], points[end]), np.maximum(points[start], points[end])
    key = low * (int(points.max()) + 1) + high
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    same = ordered[1:] == ordered[:-1]
    alone = np.ones(len(same), dtype=bool)
    alone[1:] &= ~same[:-1]
    alone[:-1] &= ~same[1:]
    first, second = order[:-1][same & alone], order[1:][same & alone]
    cosine = dot(normal[first // 3], normal[second // 3])
    smooth = (cosine >= np.cos(crease)) & (points[start[first]] == points[end[second]])
    first, second = first[smooth], second[smooth]
    return np.concatenate((start[first], end[first])), np.concatenate((end[second], start[second]))


def smooth_normals(points: np.ndarray, corner: np.ndarray, crease: float) -> np.ndarray:
    """Return unit normals [F, 3, xyz] at the corners of triangles, smooth but for edges above `crease` (radians).

    `points` [F, 3, xyz] are the corners' positions, `corner` [F, 3] numbers that are equal where positions are. A
    normal is the mean, weighted by the angle at the corner (Thuermer and Wuethrich 1998), over the fan of triangles
    that smooth edges connect about the point: so it is one and the same on both sides of a smooth edge.
    """
    normal = face_normals(points)
    fan = _linked(3 * len(points), *_smooth_links(corner, normal, crease))
    angle = corner_angles(points)
    total = _sums(fan, (angle[..., None] * normal[:, None]).reshape(-1, 3))[fan]
    # A fan that winds back on itself may sum to nothing; then each triangle keeps its own.
    lost = np.sqrt(dot(total, total)) <= _CANCELS * np.bincount(fan, angle.reshape(-1))[fan]
    total[lost] = np.repeat(normal, 3, axis=0)[lost]
    return unit(total).reshape(points.shape)


def _sums(group: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the sum of the rows of `values` [n, 3] in each group."""
    return np.stack([np.bincount(group, column) for column in values.T], axis=-1)


def _across(vector: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the part of a unit vector that is perpendicular to a unit normal, made length 1; 0 if there is none."""
    across = vector - dot(vector, normal)[..., None] * normal
    return unit(across * (dot(across, across) > _ALONG**2)[..., None])


def fallback_tangent(normal: np.ndarray) -> np.ndarray:
    """Return unit tangents [n, 3] for unit normals: +x, turned as +z is turned to the normal; continuous but at -z."""
    return _across(unit(frames.tangent_frame(torch.from_numpy(normal), dim=-1)[0].numpy()), normal)


def _face_tangents(points: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit dP/du [F, 3], and the side [F] of the texture that shows: 1, -1 mirrored, 0 where uv have no area."""
    edge, step = points[:, 1:] - points[:, :1], uv[:, 1:] - uv[:, :1]
    side = np.sign(step[:, 0, 0] * step[:, 1, 1] - step[:, 0, 1] * step[:, 1, 0]) * has_area(uv)
    along = edge[:, 0] * step[:, 1, 1, None] - edge[:, 1] * step[:, 0, 1, None]
    return unit(along * side[:, None]), side


def join(
    points: np.ndarray, corner: np.ndarray, normal: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return (first, faces, tangent, handedness): corners that agree joined into V vertices, with tangents.

    `points`, `normal` [F, 3, xyz], `uv` [F, 3, 2], `corner` [F, 3] as in `smooth_normals`. `first` [V] is a corner
    (into F * 3) of each vertex, `faces` [F, 3] their numbers, `tangent` [V, 3], `handedness` [V].

    Section 4.1 of the thesis: tangents of faces are summed only where position, normal and texture coordinate are
    shared. We add that the texture must not be mirrored between them, and weigh each, laid into the plane of the
    normal, by the angle at its corner. Where no face has a direction, or they cancel, `fallback_tangent` stands in.
    """
    along, side = _face_tangents(points, uv)
    alike = [corner.reshape(-1), *bits(normal.reshape(-1, 3)), *bits(uv.reshape(-1, 2))]
    hand = np.repeat(side, 3).astype(np.int64)
    group = distinct(*alike)[1]
    # A triangle without texture area joins the vertices that are there: mirrored ones where there are no others.
    mirrored = ~(np.bincount(group, hand > 0) > 0) & (np.bincount(group, hand < 0) > 0)
    joins = np.where(mirrored[group].reshape(-1, 3).any(axis=1), -1, 1)
    hand = np.where(hand == 0, np.repeat(joins, 3), hand)
    first, vertex = distinct(group, hand)
    at = normal.reshape(-1, 3)
    angle = corner_angles(points).reshape(-1)
    total = _sums(vertex, angle[:, None] * _across(np.repeat(along, 3, axis=0), at))
    lost = np.sqrt(dot(total, total)) <= _CANCELS * np.bincount(vertex, angle)
    total[lost] = fallback_tangent(at[first[lost]])
    return first, vertex.reshape(-1, 3), _across(unit(total), at[first]), hand[first].astype(np.float64)
