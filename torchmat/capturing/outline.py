"""Where a mirror sphere stands: its outline as the camera must see it, and as the photographs show it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates, maximum_filter1d

from torchmat.capturing.view import Camera, Pose

Reflectance = Callable[[np.ndarray, np.ndarray], np.ndarray]
_POINTS = 240  # of an outline
_REACH = 2.0  # mm that a sphere may stand beside its place
_STEP = 0.5  # pixels between samples across the outline
_EDGES = 6  # of a profile that are looked at, the steepest
_LEAST_EDGE = 0.02  # of the paper's brightness, a pixel; weaker edges are noise
_PRINT = 2.0  # pixels beside a printed edge in which no other one is looked for
_INLIER = 1.5  # pixels
_LEAST_SHARE = 0.5  # of the outline's points that must lie on edges
_ROUNDS = 8
_LEAST_PHOTOGRAPHS = 5  # that must tell a sphere's place before it is believed to stand elsewhere
_MEANT = 0.1  # mm, of a sphere on its ring
_SAME = 3.0  # deviations within which two photographs see a sphere at one place


class Placed(NamedTuple):
    """Where a photograph shows a sphere: `centre` [3] in mm, its standard error `sigma` in mm (the larger one of x and y),
    `rms` in pixels of the edges about the outline, and the `share` of the outline that lies on edges, 0 to 1."""

    centre: np.ndarray
    sigma: float
    rms: float
    share: float


class Standing(NamedTuple):
    """Where a sphere stands: its `centre` [3] in mm, the standard error `sigma` in mm along x and y each, whether it was
    `moved` from where it was meant to stand, and the photographs (numbers) that see it `elsewhere`, as after a push."""

    centre: np.ndarray
    sigma: float
    moved: bool
    elsewhere: tuple[int, ...]


def outline(camera: Camera, pose: Pose, centre: np.ndarray, radius: float, points: int = _POINTS) -> np.ndarray:
    """Return the outline [points, 2] of a sphere in pixels: the circle where rays of the camera graze it, projected.

    The grazing circle of a sphere of radius r at distance d from the camera lies r^2 / d in front of its centre and has the
    radius r sqrt(1 - r^2 / d^2): the outline is right in perspective and under the lens's distortion.
    """
    towards = pose.position - centre
    distance = float(np.linalg.norm(towards))
    axis = towards / distance
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across /= np.linalg.norm(across)
    turn = np.linspace(0, 2 * np.pi, points, endpoint=False)[:, None]
    circle = np.cos(turn) * across + np.sin(turn) * np.cross(axis, across)
    middle = centre + axis * radius**2 / distance
    return pose.project(camera, middle + radius * np.sqrt(1 - (radius / distance) ** 2) * circle)


def refined_centre(
    grey: np.ndarray, camera: Camera, pose: Pose, centre: np.ndarray, radius: float, reflectance: Reflectance | None = None,
    corner: np.ndarray | None = None,
) -> Placed | None:
    """Return where a photograph `grey` [H, W], or its part from a `corner` (column, row) on, shows a sphere that should stand at
    `centre` [3] in mm; None where it does not tell.

    The sphere stands on the paper, so that two numbers are sought. Edges are looked for across the expected outline; the
    shift on which most of the outline agrees wins, for mirrors have edges of reflections inside theirs and shadows outside,
    and is then refined by least squares on the edges near it. Edges that are printed are left out where the paper's
    `reflectance` of x and y is given. A mirror reflects at its outline what is right behind it, so that its edge is weak:
    one photograph tells the place to some tenths of a millimetre, and all together (`common_centre`) to less.
    """
    around = outline(camera, pose, centre, radius)
    shifts = [outline(camera, pose, centre + np.eye(3)[axis] * 0.1, radius) - around for axis in (0, 1)]
    tangent = np.roll(around, -1, axis=0) - np.roll(around, 1, axis=0)
    normal = np.stack((tangent[:, 1], -tangent[:, 0]), axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= np.sign((normal * (around - around.mean(0))).sum(1, keepdims=True))  # outwards
    slope = np.stack([(shift * normal).sum(1) / 0.1 for shift in shifts], axis=1)  # pixels along the normal for a mm
    reach = _REACH * float(np.abs(slope).max())
    offsets = np.arange(-reach, reach + _STEP, _STEP)
    places = around[:, None] + offsets[:, None] * normal[:, None]
    first = np.zeros(2) if corner is None else corner
    inside = ((places >= first) & (places <= first + np.array(grey.shape[::-1]) - 1)).all((1, 2))
    if inside.mean() < _LEAST_SHARE:
        return None
    printed = np.zeros(places[inside].shape[:-1], bool)
    if reflectance is not None:
        ray = pose.rays(camera, places[inside])
        hit = pose.position - ray * (pose.position[2] / np.minimum(ray[..., 2:], -1e-6))
        change = np.abs(np.gradient(reflectance(hit[..., 0], hit[..., 1]), axis=1)) > 0.01
        printed = maximum_filter1d(change, 2 * int(_PRINT / _STEP) + 1, axis=1)
    edges = _edges(grey, places[inside] - first, offsets, printed)
    return _fitted(edges, slope[inside], centre)


def _edges(grey: np.ndarray, places: np.ndarray, offsets: np.ndarray, printed: np.ndarray) -> np.ndarray:
    """Return the offsets [k, _EDGES] of edges across the outline at `places` [k, offsets, 2], NaN where there are fewer."""
    low, high = np.floor(places.min((0, 1))).astype(int), np.ceil(places.max((0, 1))).astype(int) + 1
    part = grey[low[1] : high[1] + 1, low[0] : high[0] + 1]
    profile = map_coordinates(part, [places[..., 1] - low[1], places[..., 0] - low[0]], order=1, mode="nearest", output=np.float64)
    paper = np.percentile(profile[:, -profile.shape[1] // 4 :], 75)
    slope = np.where(printed, 0, np.abs(gaussian_filter1d(profile, 1 / _STEP, axis=1, order=1)) / _STEP / max(paper, 1e-6))
    peak = np.zeros_like(slope, dtype=bool)
    peak[:, 1:-1] = (slope[:, 1:-1] >= slope[:, :-2]) & (slope[:, 1:-1] > slope[:, 2:]) & (slope[:, 1:-1] > _LEAST_EDGE)
    order = np.argsort(np.where(peak, -slope, 0), axis=1)[:, :_EDGES]
    rows = np.arange(len(slope))[:, None]
    before, here, after = (slope[rows, np.clip(order + step, 0, slope.shape[1] - 1)] for step in (-1, 0, 1))
    bend = before - 2 * here + after
    between = np.where(bend < 0, (before - after) / (2 * np.where(bend < 0, bend, -1)), 0)
    return np.where(peak[rows, order], offsets[order] + between * _STEP, np.nan)


def _fitted(edges: np.ndarray, slope: np.ndarray, centre: np.ndarray) -> Placed | None:
    """Return the shift of the outline on which edges [k, n] agree; `slope` [k, 2] is what a mm moves it along its normals."""
    filled = np.where(np.isnan(edges), 1e3, edges)
    steps = np.linspace(-_REACH, _REACH, 41)
    shift, best = np.zeros(2), -1.0
    for x in steps:
        along = slope[:, :1] * x + slope[:, 1:] * steps  # [k, 41]
        apart = np.abs(filled[:, :, None] - along[:, None]).min(1)
        score = np.exp(-(apart**2) / 2).sum(0)
        if score.max() > best:
            best, shift = float(score.max()), np.array([x, steps[score.argmax()]])
    for _ in range(_ROUNDS):
        off = filled - (slope @ shift)[:, None]
        nearest = off[np.arange(len(off)), np.abs(off).argmin(1)]
        near = np.abs(nearest) < _INLIER
        if near.mean() < _LEAST_SHARE:
            return None
        weight = np.where(near, (1 - (nearest / _INLIER) ** 2) ** 2, 0)
        normal = slope.T @ (weight[:, None] * slope)
        shift = shift + np.linalg.solve(normal, slope.T @ (weight * nearest))
    rms = float(np.sqrt(np.mean(nearest[near] ** 2)))
    # Neighbouring edges share their errors: about every sixth counts as one of its own.
    covariance = np.linalg.inv(slope[near].T @ slope[near]) * rms**2 * 6
    return Placed(centre + np.array([*shift, 0.0]), float(np.sqrt(np.diag(covariance).max())), rms, float(near.mean()))


def common_centre(placed: Sequence[Placed | None], centre: np.ndarray) -> Standing:
    """Return where photographs, taken together, show a sphere that should stand at `centre` [3] in mm.

    The place that was meant holds unless they agree on another one: each photograph alone is less sure than whoever put the
    sphere onto its ring.
    """
    known = [(number, one) for number, one in enumerate(placed) if one is not None]
    if len(known) < _LEAST_PHOTOGRAPHS:
        return Standing(centre, _MEANT, False, ())
    centres = np.stack([one.centre for _, one in known])
    apart = np.linalg.norm(centres - np.median(centres, axis=0), axis=1)
    spread = max(1.4826 * float(np.median(apart)), float(np.median([one.sigma for _, one in known])), 0.05)
    good = apart < _SAME * spread
    found, sigma = centres[good].mean(0), spread / np.sqrt(good.sum())
    elsewhere = tuple(number for (number, _), one in zip(known, good, strict=True) if not one)
    if np.linalg.norm(found - centre) < _SAME * np.hypot(sigma, _MEANT):
        return Standing(centre, _MEANT, False, elsewhere)
    return Standing(found, float(sigma), True, elsewhere)
