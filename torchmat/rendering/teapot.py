"""Newell's teapot: the control points of its 32 bicubic patches, and what they make.

Martin Newell's data (University of Utah, 1975), as published with 32 patches. The bodies of revolution are given by
their profiles, handle and spout by one half: the other 28 patches are these turned or mirrored, to the bit.
"""

from __future__ import annotations

import numpy as np

PATCHES = 32
# Four rows of (radius, its share of the inner control points, height), z up. Rows run down or outward; the bottom's
# patches go round the other way, as it looks down.
_PROFILES = {
    "rim": ((1.4, 0.784, 2.4), (1.3375, 0.749, 2.53125), (1.4375, 0.805, 2.53125), (1.5, 0.84, 2.4)),
    "upper body": ((1.5, 0.84, 2.4), (1.75, 0.98, 1.875), (2.0, 1.12, 1.35), (2.0, 1.12, 0.9)),
    "lower body": ((2.0, 1.12, 0.9), (2.0, 1.12, 0.45), (1.5, 0.84, 0.225), (1.5, 0.84, 0.15)),
    "knob": ((0.0, 0.0, 3.15), (0.8, 0.45, 3.15), (0.0, 0.0, 2.85), (0.2, 0.112, 2.7)),
    "lid": ((0.2, 0.112, 2.7), (0.4, 0.224, 2.55), (1.3, 0.728, 2.55), (1.3, 0.728, 2.4)),
    "bottom": ((0.0, 0.0, 0.0), (1.425, 0.798, 0.0), (1.5, 0.84, 0.075), (1.5, 0.84, 0.15)),
}
# Four rows of (x, z of the first column, x, z of the last, y of the two between).
_TUBES = {
    "upper handle": (
        (-1.6, 2.025, -1.5, 2.25, 0.3), (-2.3, 2.025, -2.5, 2.25, 0.3),
        (-2.7, 2.025, -3.0, 2.25, 0.3), (-2.7, 1.8, -3.0, 1.8, 0.3),
    ),
    "lower handle": (
        (-2.7, 1.8, -3.0, 1.8, 0.3), (-2.7, 1.575, -3.0, 1.35, 0.3),
        (-2.5, 1.125, -2.65, 0.9375, 0.3), (-2.0, 0.9, -1.9, 0.6, 0.3),
    ),
    "lower spout": (
        (1.7, 1.425, 1.7, 0.6, 0.66), (2.6, 1.425, 3.1, 0.825, 0.66),
        (2.3, 2.1, 2.4, 2.025, 0.25), (2.7, 2.4, 3.3, 2.4, 0.25),
    ),
    "upper spout": (
        (2.7, 2.4, 3.3, 2.4, 0.25), (2.8, 2.475, 3.525, 2.49375, 0.25),
        (2.9, 2.475, 3.45, 2.5125, 0.15), (2.8, 2.4, 3.2, 2.4, 0.15),
    ),
}
# What the surface fills, y up; the spout reaches furthest where the derivative of its outermost curve is 0.
_BOX = ((-3.0, 0.0, -2.0), (3.4340751254711077, 3.15, 2.0))
# Patches whose first row is a single point: of the knob and of the bottom.
WITH_POLE = frozenset({12, 13, 14, 15, 20, 21, 22, 23})


def _revolved(profile: tuple[tuple[float, float, float], ...], clockwise: bool) -> np.ndarray:
    """Return the four patches [4, 4, 4, 3] of a profile, each a quarter turn on from the one before."""
    radius, inner, height = np.array(profile).T
    nothing = np.zeros(4)
    first = np.stack((
        np.stack((radius, nothing, height), axis=-1), np.stack((radius, inner, height), axis=-1),
        np.stack((inner, radius, height), axis=-1), np.stack((nothing, radius, height), axis=-1),
    ), axis=1)
    quarters = [first]
    for _ in range(3):
        x, y, z = np.moveaxis(quarters[-1], -1, 0)
        quarters.append(np.stack((-y, x, z), axis=-1))
    return np.stack(quarters) * ((1, -1, 1) if clockwise else (1, 1, 1)) + 0.0


def _halves(rows: tuple[tuple[float, ...], ...]) -> np.ndarray:
    """Return the two patches [2, 4, 4, 3] of a piece of handle or spout: the half at y < 0, and its mirror image."""
    x_first, z_first, x_last, z_last, y = np.array(rows).T
    nothing = np.zeros(4)
    near = np.stack((
        np.stack((x_first, nothing, z_first), axis=-1), np.stack((x_first, -y, z_first), axis=-1),
        np.stack((x_last, -y, z_last), axis=-1), np.stack((x_last, nothing, z_last), axis=-1),
    ), axis=1)
    far = near[:, ::-1] * (1, -1, 1) + 0.0
    return np.stack((near, far))


def control_points() -> np.ndarray:
    """Return the control points [32, row, column, xyz] in the data's own frame: z up, lengths as published.

    The cross product of the directions along columns and along rows points outward.
    """
    revolved = [_revolved(profile, clockwise=name != "bottom") for name, profile in _PROFILES.items()]
    return np.concatenate(revolved + [_halves(rows) for rows in _TUBES.values()])


def _bernstein(segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the four cubic weights and their derivatives at 0..1, [4, segments + 1] each.

    Weight 3 - k is weight k from the other end to the bit, whatever 1 - t rounds to.
    """
    t = np.arange(segments + 1) / segments
    back = t[::-1]
    first, second = back * back * back, 3 * t * (back * back)
    slope = -3 * back * back
    inner = 3 * back * (back - 2 * t)
    return np.stack((first, second, second[::-1], first[::-1])), np.stack((slope, inner, -inner[::-1], -slope[::-1]))


def _combine(weight: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the sum of weights [4, n] times points [4, ...] as [n, ...], the same to the bit from either end."""
    terms = weight.reshape(4, -1, *[1] * (points.ndim - 1)) * points[:, None]
    return (terms[0] + terms[3]) + (terms[1] + terms[2])


def _surface(along_rows: np.ndarray, along_columns: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return [32, n, n, 3], row parameter first, of weights [4, n] for either direction."""
    across = _combine(along_columns, np.moveaxis(points, 2, 0))  # [column sample, patch, row, xyz]
    grid = _combine(along_rows, np.moveaxis(across, 2, 0))  # [row sample, column sample, patch, xyz]
    return np.moveaxis(grid, 2, 0)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def _to_scene(vector: np.ndarray) -> np.ndarray:
    """Turn z up into y up; the spout stays at +x."""
    return np.stack((vector[..., 0], vector[..., 2], -vector[..., 1]), axis=-1) + 0.0


def patches(segments: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return position, normal, uv and tangent of the 32 patches, [32, n, n, 3 or 2] float64, n = segments + 1.

    In the scene's frame (y up), the surface's bounding box centred on the origin and 2 wide: so the pot stands on the
    plane y = -0.4896. v = 0 comes first: the rows run from a patch's last control points to its first, so that v rises
    on the body, and u runs to the right seen from outside. Positions along a shared edge are equal to the bit.
    """
    points = control_points()
    weight, slope = _bernstein(segments)
    position = _surface(weight, weight, points)
    along_columns, along_rows = _surface(weight, slope, points), _surface(slope, weight, points)
    # Where a row is a single point the direction along it has length 0; its limit is how it starts to grow.
    growing = _surface(slope, slope, points)
    poles = sorted(WITH_POLE)
    along_columns[poles, 0] = growing[poles, 0]
    position[poles, 0] = points[poles, 0, :1]  # the weights sum to 1 but for rounding
    normal = _unit(np.cross(along_columns, along_rows))
    u, v = np.meshgrid(np.arange(segments + 1) / segments, np.arange(segments + 1) / segments)
    uv = np.repeat(np.stack((u, v), axis=-1)[None], PATCHES, axis=0)
    turned = [_to_scene(part[:, ::-1, ::-1]) for part in (position, normal, _unit(-along_columns))]
    # The one triangle of each column that meets a pole has its last corner there; it belongs in the column's middle.
    uv[poles, -1, 1:, 0] -= 0.5 / segments
    turned[2][poles, -1, 1:] = _unit(turned[2][poles, -1, 1:] + turned[2][poles, -1, :-1])
    low, high = np.array(_BOX)
    return (turned[0] - (low + high) / 2) * (2 / (high - low)[0]), turned[1], uv, turned[2]
