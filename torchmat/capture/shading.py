"""A near lamp's position from the shading of white paper alone: an estimate, with its uncertainty."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from torchmat.capture.light import Light
from torchmat.errors import DataError, message

_STARTS = (250.0, 600.0, 1500.0)  # mm above the paper
_LEAST_POINTS = 50
_WIDEST = 10.0  # degrees of standard error beyond which nothing is told
_KNOWN = 0.15  # of its distance to which a lamp's distance must be known: from paper that is lit evenly nothing follows
_OUTLIER = 4.0  # spreads; shadows, for the most part
_ALIKE = 9.0  # neighbouring points share their errors: about one in so many counts
_SHEEN = 0.01  # relative, what paper is at least away from matte and even


def lamp_of_shading(where: str, points: np.ndarray, values: np.ndarray) -> Light:
    """Return the lamp that explains how bright white paper is at points [n, 3] in mm; `values` [n], without vignetting.

    Matte paper under a lamp at p shows k z / |p - x|^3: the cosine z / d and the fall-off 1 / d^2. The logarithm is fitted by
    robust least squares over p and k from several heights. Its covariance is that of the Jacobian at the residual found, at
    least 1 % for paper that is not quite matte, with one in nine points counted as independent. The further the lamp, the
    more even the light, and a slope alone may come from a near lamp above or a far one beside: raises DataError, which starts
    with `where`, where the distance is not known to 15 % and the direction to 10 degrees.
    """
    good = values > 0
    if good.sum() < _LEAST_POINTS:
        step = "Leave more of the board in the picture, or put mirror spheres on it."
        raise DataError(message(where, "the paper", f"show at least {_LEAST_POINTS} points", f"there are {int(good.sum())}", step))
    points, target = points[good], np.log(values[good])

    def residual(unknown: np.ndarray) -> np.ndarray:
        x, y, height, level = unknown
        square = (points[:, 0] - x) ** 2 + (points[:, 1] - y) ** 2 + np.exp(2 * height)
        return level + height - 1.5 * np.log(square) - target

    # Where the paper is brightest along its slope, as far as a lamp of that height would be.
    slope = np.linalg.lstsq(np.column_stack((np.ones(len(points)), points[:, :2])), target, rcond=None)[0][1:]
    tried = []
    for height in _STARTS:
        start = np.array([*np.clip(slope * height**2 / 3, -2 * height, 2 * height), np.log(height), 0.0])
        start[3] = -np.median(residual(start))
        tried.append(least_squares(residual, start, loss="soft_l1", f_scale=0.02, x_scale=[height, height, 1, 1], max_nfev=200))
    best = min(tried, key=lambda found: found.cost)
    for _ in range(3):
        off = residual(best.x)
        spread = max(1.4826 * float(np.median(np.abs(off - np.median(off)))), 1e-4)
        inner = np.abs(off) < _OUTLIER * spread
        points, target = points[inner], target[inner]
        best = least_squares(residual, best.x, x_scale=[100, 100, 1, 1], max_nfev=200)
    x, y, height, _ = best.x
    rms = float(np.sqrt(np.mean(best.fun**2)))
    # In units of the height, or the numbers of a far lamp would differ too much to be inverted.
    jacobian = best.jac * np.array([np.exp(height), np.exp(height), 1, 1])
    information = jacobian.T @ jacobian / (max(rms, _SHEEN) ** 2 * _ALIKE)
    covariance = np.linalg.inv(information + 1e-6 * np.eye(4))[:3, :3] * np.exp(2 * height)
    position = np.array([x, y, np.exp(height)])
    distance = float(np.linalg.norm(position))
    along = position / distance
    across = np.eye(3) - np.outer(along, along)
    sigma = float(np.degrees(np.sqrt(np.trace(across @ covariance @ across) / 2) / distance))
    depth = float(np.sqrt(along @ covariance @ along)) / distance
    if not (sigma < _WIDEST and depth < _KNOWN):
        fact = f"it tells the direction to {min(sigma, 90):.0f} degrees and the distance to {min(100 * depth, 100):.0f} %, at a residual of {100 * rms:.1f} %"
        step = "Put mirror spheres on the board, give the lights, or bring the lamp nearer."
        raise DataError(message(where, "the shading of the paper", "tell where the lamp is", fact, step))
    return Light(along, sigma, position, covariance, rms, "the paper's shading, an estimate")
