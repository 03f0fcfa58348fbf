"""Registration on the sample itself: its height above the board, and photographs that do not lie on the others, as of a sample that was moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchmat.capturing.align import IDENTITY, Alignment, align, correlation, features, moved_by, remaining, warped
from torchmat.capturing.rectify import Grid
from torchmat.capturing.scene import Photometry, Scene, Step
from torchmat.capturing.texels import texels_of
from torchmat.progress import progress

_SIDE = 512  # texels along the longer side suffice to register on
_LEAST, _GAIN = 0.35, 0.97  # texels that a shift must be larger than, and what of the unexplained it must leave at most
_PATTERN = 0.3  # correlation below which photographs have no pattern in common
_ROUNDS = 2
_RELIEF = 0.3  # of the photographs that would be moved a little, from which on it is relief that lights move
_MOVED, _FARTHER = 1.0, 2.5  # mm beside the others: the sample was moved; of relief, times what is usual of it
_HEIGHTS, _REFINED = 4, 0.05  # times that a height is looked for, and texels that one which is known is refined by
_SURE, _BETTER = 4.0, 0.7  # standard errors of a height, and what it must leave of the shifts


@dataclass(frozen=True, eq=False)
class Registered:
    """Affine maps [2, 3] of the texels by photograph, None where none gains; the sample's `height` above the board in mm; what was found."""

    shifts: list[np.ndarray | None]
    height: float
    step: Step


def register(scene: Scene, photometry: Photometry, grid: Grid, find_height: bool = True, show: bool | None = None) -> Registered:
    """Return how photographs are moved so that the sample's pattern lies on itself.

    Poses place photographs well already, and lights move what relief shows: a photograph is moved only where its pattern then explains
    clearly more of the others' mean, and by more than a third of a texel. Shifts that grow with the view's slope are the height of the
    sample's surface over the board, which is found first.
    """
    coarse = _coarse(grid)
    patterns = _patterns(scene, photometry, coarse, show)
    notes: list[str] = []
    for round_ in range(_HEIGHTS if find_height and len(patterns) > 2 else 0):  # the mean of the others gets sharper each time
        rise = _height([align(*_others(patterns, index)) for index in range(len(patterns))], scene, coarse, _LEAST if round_ == 0 else _REFINED)
        if rise is None:
            break
        coarse = replace(coarse, height=coarse.height + rise)
        patterns = _patterns(scene, photometry, coarse, show)
    if coarse.height != grid.height:
        notes.append(f"The sample's surface lies {coarse.height:.2f} mm above the board: found from its own pattern, and taken into account")
    before = [_rest(*_others(patterns, index)) for index in range(len(patterns))]
    shifts, alike = _aligned(patterns, coarse)
    shifts = _without_relief(shifts, coarse, notes)
    moved = [pattern if shift is None else warped(pattern, shift) for pattern, shift in zip(patterns, shifts, strict=True)]
    after = [_rest(*_others(moved, index)) for index in range(len(patterns))]
    scale = grid.shape[1] / coarse.shape[1]
    step = _step(scene, coarse, scale, shifts, alike, before, after, notes)
    return Registered([None if shift is None else _finer(shift, scale) for shift in shifts], coarse.height, step)


def _coarse(grid: Grid) -> Grid:
    factor = max(1.0, max(grid.shape) / _SIDE)
    return replace(grid, shape=(round(grid.shape[0] / factor), round(grid.shape[1] / factor)))


def _finer(shift: np.ndarray, scale: float) -> np.ndarray:
    """Return an affine map of texels for ones that are so many times smaller."""
    linear, offset = shift[:, :2], shift[:, 2]
    return np.column_stack((linear, scale * offset + (scale - 1) / 2 * (1 - linear.sum(1))))


def _patterns(scene: Scene, photometry: Photometry, grid: Grid, show: bool | None) -> list[np.ndarray]:
    found = []
    for index in progress(range(len(scene.photographs)), "looking at the sample", show=show):
        one = texels_of(scene, photometry, index, grid)
        found.append(features(one.values.numpy(), one.valid.numpy()))
    return found


def _others(patterns: Sequence[np.ndarray], index: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of all patterns but one, and that one: it must not be compared with itself."""
    if len(patterns) < 2:
        return patterns[index], patterns[index]
    return ((sum(patterns) - patterns[index]) / (len(patterns) - 1)).astype(np.float32), patterns[index]


def _rest(reference: np.ndarray, pattern: np.ndarray) -> float:
    """Return the shift that remains, rms in texels; NaN where there is no pattern."""
    shifts = remaining(reference, pattern)
    return float(np.sqrt((shifts**2).sum(1).mean())) if len(shifts) else np.nan


def _aligned(patterns: Sequence[np.ndarray], grid: Grid) -> tuple[list[np.ndarray | None], list[float]]:
    """Return the maps of those photographs that gain by one, and how much each pattern is like the others'."""
    shifts: list[np.ndarray | None] = [None] * len(patterns)
    alike = [0.0] * len(patterns)
    for _ in range(_ROUNDS):
        moved = [pattern if shift is None else warped(pattern, shift) for pattern, shift in zip(patterns, shifts, strict=True)]
        for index in range(len(patterns)):
            reference = _others(moved, index)[0]
            current = shifts[index]
            found = align(reference, patterns[index], IDENTITY if current is None else current)
            plain = correlation(reference, patterns[index])
            alike[index] = max(plain, found.after)
            gains = found.after > _PATTERN and 1 - found.after**2 < _GAIN * (1 - max(plain, 0) ** 2)
            shifts[index] = found.shift if gains and found.moves(grid.shape) > _LEAST else None
    return shifts, alike


def _without_relief(shifts: list[np.ndarray | None], grid: Grid, notes: list[str]) -> list[np.ndarray | None]:
    """Return the maps without those of relief that lights move: where a good part of the photographs would each be moved a little, it is
    not the sample that was."""
    lengths = [0.0 if shift is None else moved_by(shift, grid.shape) * grid.texel[1] for shift in shifts]
    little = [0 < length <= _MOVED for length in lengths]
    if sum(little) <= _RELIEF * len(shifts):
        return shifts
    most = max(_MOVED, _FARTHER * float(np.median([length for length in lengths if length > 0])))
    little = [0 < length <= most for length in lengths]
    notes.append(f"{sum(little)} photographs would each be moved by less than {most:.2g} mm: lights move what relief shows, so that they lie as their poses say")
    return [None if small else shift for shift, small in zip(shifts, little, strict=True)]


def _height(found: Sequence[Alignment], scene: Scene, grid: Grid, least: float) -> float | None:
    """Return by how many mm the sample's surface lies above the grid; None where no height explains how patterns lie to each other,
    or it moves none by `least` texels.

    A point that is h higher is seen h v_xy / v_z beside where the plane would show it, away from the camera (v: towards the camera).
    """
    centre = np.array([[0.0, 0.0, grid.height]])
    views = np.array([pose.views(centre)[0] for pose in scene.poses])
    step_y, step_x = grid.texel
    middle = np.array([grid.shape[1] - 1, grid.shape[0] - 1]) / 2
    beside = np.array([one.shift[:, :2] @ middle + one.shift[:, 2] - middle for one in found]) * (step_x, -step_y)
    known = np.array([one.after > _PATTERN for one in found])
    if known.sum() < 4:
        return None
    slope, target = -(views[known, :2] / views[known, 2:]), beside[known]
    count = len(slope)
    design = np.zeros((2 * count, 3))  # the height, and where the mean of the others lies
    design[:, 0], design[:count, 1], design[count:, 2] = slope.T.reshape(-1), 1, 1
    values, weight = np.concatenate((target[:, 0], target[:, 1])), np.ones(2 * count)
    for _ in range(10):  # Huber's weights: a sample that was moved in one photograph does not count much
        solution, *_ = np.linalg.lstsq(design * weight[:, None], values * weight, rcond=None)
        rest = np.abs(values - design @ solution)
        scale = 1.5 * float(np.median(rest)) + 1e-9
        weight = np.sqrt(np.minimum(1, 1.5 * scale / np.maximum(rest, 1e-12)))
    flat = np.abs(values - np.concatenate([np.full(count, np.median(target[:, axis])) for axis in (0, 1)]))
    normal = np.linalg.inv((design * weight[:, None] ** 2).T @ design)
    error = float(np.sqrt(normal[0, 0])) * scale
    height = float(solution[0])
    large = abs(height) * float(np.abs(slope).max()) > least * step_x
    return height if large and abs(height) > _SURE * error and np.median(rest) < _BETTER * np.median(flat) else None


def _step(
    scene: Scene, grid: Grid, scale: float, shifts: Sequence[np.ndarray | None], alike: Sequence[float], before: Sequence[float],
    after: Sequence[float], notes: list[str],
) -> Step:
    names = [one.name for one in scene.photographs]
    lengths = [0.0 if shift is None else moved_by(shift, grid.shape) * grid.texel[1] for shift in shifts]
    for name, shift, length in zip(names, shifts, lengths, strict=True):
        if shift is not None and length > _MOVED:  # of relief, what `_without_relief` left
            notes.append(f"{name}: the sample lies {length:.1f} mm beside where it lies in the others; it was moved, and is followed")
    patterned = [value for value in alike if value > _PATTERN]
    if len(patterned) < len(names):
        why = "matte relief under other lights, or nothing to see"
        notes.append(f"{len(names) - len(patterned)} photographs have no pattern in common with the others ({why}): they lie as their poses say")
    count = sum(shift is not None for shift in shifts)
    rms = [scale * float(np.sqrt(np.nanmean(np.square(some)))) if np.isfinite(some).any() else np.nan for some in (before, after)]
    rows = list(zip(names, alike, [scale * one for one in before], [scale * one for one in after], lengths, strict=True))
    residual = f"{rms[1]:.2f} texels rms" if np.isfinite(rms[1]) else "not measured: no pattern in common"
    figures = {"moved": count, "before_texels": rms[0], "after_texels": rms[1], "height_mm": grid.height}
    header = ("photograph", "correlation with the others", "texels beside them before", "after", "moved by mm")
    return Step("registration", f"{count} of {len(names)} photographs moved onto the others", residual, figures, header, rows, notes=notes)
