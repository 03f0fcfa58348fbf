"""Near lamps' positions from the shading of white paper alone: estimates, with their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from torchmat.capturing.evenness import LENSES
from torchmat.capturing.light import Light
from torchmat.errors import DataError, message

_STARTS = (250.0, 600.0, 1500.0)  # mm above the paper
_LEAST_POINTS = 50
_WIDEST = 10.0  # degrees of standard error beyond which nothing is told
_KNOWN = 0.15  # of its distance to which a lamp's distance must be known: from paper that is lit evenly nothing follows
_OUTLIER = 4.0  # spreads; shadows, for the most part
_ALIKE = 9.0  # neighbouring points share their errors: about one in so many counts
_LEAST_RMS = 0.005
_SMOOTH = 0.03  # relative, at 100 mm: by how much lamps and paper may be uneven along x, along y and with the distance
_PRIOR = 0.03  # residual of a vignetting of one standard deviation of lenses
_TOGETHER = 300  # points of a photograph that tell the lens's vignetting


def lamp_of_shading(where: str, points: np.ndarray, values: np.ndarray) -> Light:
    """Return the lamp that explains how bright white paper is at points [n, 3] in mm; `values` [n], without vignetting.

    Matte paper under a lamp at p shows k z / |p - x|^3: the cosine z / d and the fall-off 1 / d^2. The logarithm is fitted by
    robust least squares over p and k from several heights. Its covariance is that of the Jacobian at the residual found, one in
    nine points counted as independent, with 3 % at 100 mm left open for lamps and paper that are a little uneven. The
    further the lamp, the more even the light, and a slope alone may come from a near lamp above or a far one beside: raises
    DataError, which starts with `where`, where the distance is not known to 15 % and the direction to 10 degrees.
    """
    good = values > 0
    if good.sum() < _LEAST_POINTS:
        step = "Leave more of the board in the picture, or put mirror spheres on it."
        raise DataError(message(where, "the paper", f"show at least {_LEAST_POINTS} points", f"there are {int(good.sum())}", step))
    points, target = points[good], np.log(values[good])
    found, kept = _fitted(points, target)
    return _light(where, points[kept], target[kept], found)


def _predicted(unknown: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the logarithm of what paper shows at points under a lamp at x, y and the height exp(h), and a level."""
    x, y, height, level = unknown
    return level + height - 1.5 * np.log((points[:, 0] - x) ** 2 + (points[:, 1] - y) ** 2 + np.exp(2 * height))


def _fitted(points: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x, y, logarithm of the height and level of a lamp, and which points [n] are no shadows."""
    # Where the paper is brightest along its slope, as far as a lamp of that height would be.
    slope = np.linalg.lstsq(np.column_stack((np.ones(len(points)), points[:, :2])), target, rcond=None)[0][1:]
    tried = []
    for height in _STARTS:
        start = np.array([*np.clip(slope * height**2 / 3, -2 * height, 2 * height), np.log(height), 0.0])
        start[3] = np.median(target - _predicted(start, points))
        scale = [height, height, 1, 1]
        tried.append(least_squares(lambda one: _predicted(one, points) - target, start, loss="soft_l1", f_scale=0.02, x_scale=scale, max_nfev=200))
    found = min(tried, key=lambda one: one.cost).x
    kept = np.ones(len(points), bool)
    for _ in range(3):
        off = _predicted(found, points) - target
        spread = max(1.4826 * float(np.median(np.abs(off[kept] - np.median(off[kept])))), 1e-4)
        kept = np.abs(off) < _OUTLIER * spread
        found = least_squares(lambda one: (_predicted(one, points) - target)[kept], found, x_scale=[100, 100, 1, 1], max_nfev=200).x
    return found, kept


def _light(where: str, points: np.ndarray, target: np.ndarray, found: np.ndarray) -> Light:
    """Return a fitted lamp with its covariance; raises DataError where it is not told well enough."""
    x, y, logarithm, _ = found
    height = float(np.exp(logarithm))
    rms = float(np.sqrt(np.mean((_predicted(found, points) - target) ** 2)))
    step = np.array([1e-3 * height, 1e-3 * height, 1e-3, 1e-3])
    jacobian = np.stack([(_predicted(found + move, points) - _predicted(found - move, points)) / 2e-3 for move in np.diag(step)], axis=1)  # in heights
    place = points[:, :2] / 100
    jacobian = np.column_stack((jacobian, place, (place**2).sum(1)))
    information = jacobian.T @ jacobian / (max(rms, _LEAST_RMS) ** 2 * _ALIKE) + np.diag([1e-6] * 4 + [1 / _SMOOTH**2] * 3)
    covariance = np.linalg.inv(information)[:3, :3] * height**2
    position = np.array([x, y, height])
    distance = float(np.linalg.norm(position))
    along = position / distance
    across = np.eye(3) - np.outer(along, along)
    sigma = float(np.degrees(np.sqrt(np.trace(across @ covariance @ across) / 2) / distance))
    depth = float(np.sqrt(along @ covariance @ along)) / distance
    if not (sigma < _WIDEST and depth < _KNOWN):
        fact = f"it tells the direction to {min(sigma, 90):.0f} degrees and the distance to {min(100 * depth, 100):.0f} %, at a residual of {100 * rms:.1f} %"
        hint = "Put mirror spheres on the board, give the lights, or bring the lamp nearer."
        raise DataError(message(where, "the shading of the paper", "tell where the lamp is", fact, hint))
    return Light(along, sigma, position, covariance, rms, "the paper's shading, an estimate")


def lamps_of_shading(
    names: Sequence[str], points: Sequence[np.ndarray], values: Sequence[np.ndarray], terms: Sequence[np.ndarray],
) -> tuple[list[Light | None], list[str]]:
    """Return the lamp of each photograph, and why it has none ("" where it has), with a vignetting that all share.

    A lens that darkens its corners makes paper look as if the lamp were nearer. What stays on the sensor from photograph to
    photograph is the lens's, so that all lamps and one radial course are fitted together, to some hundred points of each;
    each lamp is then fitted again to all its points without that course.

    Args:
        names: of the photographs.
        points: [n, 3] of white paper, in mm.
        values: [n], what it shows there.
        terms: [n, k], of the vignetting's logarithm there (`vignetting_terms`); k = 0 where it is divided out already.
    """
    usable = [number for number, one in enumerate(values) if (one > 0).sum() >= _LEAST_POINTS]
    shared = np.zeros(terms[0].shape[1])
    if usable and len(shared):
        shared = _shared([points[n] for n in usable], [np.log(np.maximum(values[n], 1e-9)) for n in usable], [terms[n] for n in usable])
    lights: list[Light | None] = []
    faults = []
    for name, place, value, term in zip(names, points, values, terms, strict=True):
        try:
            lights.append(lamp_of_shading(name, place, value / np.exp(term @ shared)))
            faults.append("")
        except DataError as error:
            lights.append(None)
            faults.append(str(error))
    return lights, faults


def _shared(points: list[np.ndarray], targets: list[np.ndarray], terms: list[np.ndarray]) -> np.ndarray:
    """Return the weights [k] of a vignetting that photographs share, from all of them together."""
    chosen, starts = [], []
    for number, place in enumerate(points):
        some = np.unique(np.linspace(0, len(place) - 1, _TOGETHER).astype(int))
        found, kept = _fitted(place[some], targets[number][some])
        chosen.append(some[kept])
        starts.append(found)
    count = terms[0].shape[1]

    def residual(unknown: np.ndarray) -> np.ndarray:
        lamps = unknown[count:].reshape(-1, 4)
        off = [_predicted(lamp, place[some]) + term[some] @ unknown[:count] - target[some] for lamp, place, term, target, some in zip(lamps, points, terms, targets, chosen, strict=True)]
        return np.concatenate([*off, _PRIOR * unknown[:count] / LENSES])

    sparsity = np.zeros((sum(map(len, chosen)) + count, count + 4 * len(points)), np.int8)
    sparsity[:, :count] = 1
    owner = np.repeat(np.arange(len(points)), [len(some) for some in chosen])
    for column in range(4):
        sparsity[np.arange(len(owner)), count + 4 * owner + column] = 1
    scale = np.concatenate([np.ones(count), *[[100.0, 100, 1, 1]] * len(points)])
    start = np.concatenate([np.zeros(count), *starts])
    return least_squares(residual, start, loss="soft_l1", f_scale=0.02, x_scale=scale, jac_sparsity=sparsity, max_nfev=100).x[:count]
