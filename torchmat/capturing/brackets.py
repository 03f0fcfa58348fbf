"""Exposure brackets: several exposures of one thing, merged in linear light, each checked against the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchmat.capturing.develop import Developed, exposure_of
from torchmat.capturing.extra import opencv
from torchmat.capturing.photographs import Photograph, photograph
from torchmat.errors import DataError, RangeError, message

_BRIGHT, _FULL = 0.85, 0.97  # of the largest value: from the first on a sample counts less, from the second not at all
_DARK_STEPS = 6.0  # codes above black from which a sample counts fully
_READ = 2e-4  # standard deviation of dark noise, of the largest value, where codes are finer
_BESIDE = 1e-6  # what a channel counts beside one that is clipped: profiles and raw data mix them
_PHOTONS = 1e-4  # variance per value of photons: 10,000 of them at the largest
_LEAST_OVERLAP = 500  # values that two exposures must both show
_NOMINAL = 0.10  # of a ratio by which rounded shutter times (1/15 for 1/16) differ
_MOVED = 0.7  # pixels
_WINDOW = 1024  # pixels along a side of the part in which movement is looked for
_LEAST_RESPONSE = 0.05  # of the phase correlation; less has no texture to tell
_MOST = 15  # exposures of one bracket


class Merged(NamedTuple):
    """A merged bracket: `developed`, in values of the exposure number `reference` (larger than 1 where only shorter ones
    show them); `ratios` [k] of the exposures to it as measured, and as they were `said` (NaN: not at all); the shift of each
    in pixels, `moved` [k]; which are `used` [k]; and `notes`."""

    developed: Developed
    reference: int
    ratios: np.ndarray
    said: np.ndarray
    moved: np.ndarray
    used: np.ndarray
    notes: tuple[str, ...]


def merge_bracket(names: Sequence[str], frames: Sequence[Developed], exposures: Sequence[float | None]) -> Merged:
    """Return one photograph of several exposures.

    A sample weighs as the inverse of its variance in the merged value (photons, dark noise, the step of its codes), less
    towards the clipping point and nothing there. Ratios are measured where two exposures both show a value well, and what
    files say only stands where they do not overlap. A frame that moved against the others is left out and named.

    Args:
        names: of the files, for what is said.
        frames: the exposures, of one size, in any order.
        exposures: what files say (`exposure_of`), or given; None where nothing is known.

    Raises DataError, which names a file, when sizes differ, or when neither files nor overlap tell an exposure.
    """
    for name, frame in zip(names, frames, strict=True):
        if frame.linear.shape != frames[0].linear.shape:
            fact = f"it is {tuple(frame.linear.shape[1:])}, {names[0]} is {tuple(frames[0].linear.shape[1:])}"
            raise DataError(message(name, "the exposure", "have the size of the others", fact, "Bracket with one camera, held alike."))
    said = np.array([np.nan if one is None else one for one in exposures], float)
    means = [float(frame.linear.clamp(max=1).mean()) for frame in frames]
    order = sorted(range(len(frames)), key=lambda one: (said[one] if np.isfinite(said).all() else means[one], means[one]))
    ratios, notes = _ratios(names, frames, order, said)
    reference = _best_exposed(frames)
    ratios = ratios / ratios[reference]
    moved = np.array([_shift(frames[reference], frame, ratio) for frame, ratio in zip(frames, ratios, strict=True)])
    used = moved <= _MOVED
    notes += [f"{name}: moved by {by:.1f} pixels against {names[reference]}: left out of its bracket" for name, by in zip(names, moved, strict=True) if by > _MOVED]
    good = [frame for frame, kept in zip(frames, used, strict=True) if kept]
    linear, clipped = _merged(good, ratios[used])
    step = min(frame.step / ratio for frame, ratio in zip(good, ratios[used], strict=True))
    told = tuple(dict.fromkeys(note for frame in frames for note in frame.notes))
    return Merged(Developed(linear, clipped, step, told), reference, ratios, said / said[reference], moved, used, tuple(notes))


def _best_exposed(frames: Sequence[Developed]) -> int:
    shares = [float(((frame.linear > 0.02) & (frame.linear < _BRIGHT)).float().mean()) for frame in frames]
    return int(np.argmax(shares))


def _ratios(names: Sequence[str], frames: Sequence[Developed], order: Sequence[int], said: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return exposures [k], relative to the shortest, and notes on those that are otherwise than their files say."""
    ratios, notes = np.ones(len(frames)), []
    for shorter, longer in zip(order, order[1:], strict=False):
        measured = _measured_ratio(frames[shorter], frames[longer])
        told = said[longer] / said[shorter]
        if measured is None:
            if not np.isfinite(told):
                fact = f"it shows too little that {names[shorter]} shows too, and the files say no exposure"
                raise DataError(message(names[longer], "its exposure", "be known", fact, "Give the exposures, or take steps of at most 4 stops."))
            notes.append(f"{names[longer]}: shows too little that {names[shorter]} shows too: its exposure is taken as its file says")
        elif np.isfinite(told) and abs(np.log(measured / told)) > _NOMINAL:
            notes.append(f"{names[longer]}: its file says {told:.3g} times the exposure of {names[shorter]}, the photographs show {measured:.3g}: that is taken")
        ratios[longer] = ratios[shorter] * (told if measured is None else measured)
    return ratios, notes


def _measured_ratio(shorter: Developed, longer: Developed) -> float | None:
    """Return by how much the longer exposure is brighter, None where they do not overlap."""
    a, b = shorter.linear, longer.linear
    low = max(0.01, _DARK_STEPS * shorter.step)
    good = (a > low) & (a < _BRIGHT) & (b > 0.02) & (b < _BRIGHT) & ~(shorter.clipped | longer.clipped)[None]
    if int(good.sum()) < _LEAST_OVERLAP:
        return None
    # Sums, not single ratios: what the dark threshold cuts off of the noise would bias those.
    return float(b[good].double().sum() / a[good].double().sum())


def _shift(reference: Developed, other: Developed, ratio: float) -> float:
    """Return by how many pixels an exposure is shifted against another, `ratio` times shorter one; 0 where nothing tells it."""
    if other is reference:
        return 0.0
    cv2 = opencv()
    height, width = reference.clipped.shape
    top, left = max(0, (height - _WINDOW) // 2), max(0, (width - _WINDOW) // 2)
    part = (slice(top, top + _WINDOW), slice(left, left + _WINDOW))
    # Both as an exposure shows them that clips where either does, so that they are alike.
    most = _BRIGHT * min(1.0, 1 / ratio)
    pictures = []
    for frame, scale in ((reference, 1.0), (other, ratio)):
        grey = (frame.linear[:, *part].mean(0).double() / scale).clamp(max=most)
        pictures.append(np.sqrt(np.maximum(grey.numpy(), 0)))
    window = cv2.createHanningWindow(pictures[0].shape[::-1], cv2.CV_64F)
    (x, y), response = cv2.phaseCorrelate(pictures[0] - pictures[0].mean(), pictures[1] - pictures[1].mean(), window)
    return float(np.hypot(x, y)) if response > _LEAST_RESPONSE else 0.0


def _merged(frames: Sequence[Developed], ratios: np.ndarray) -> tuple[Tensor, Tensor]:
    shortest, longest = int(np.argmin(ratios)), int(np.argmax(ratios))
    total = torch.zeros_like(frames[0].linear)
    weights = torch.zeros_like(total)
    for number, (frame, ratio) in enumerate(zip(frames, ratios, strict=True)):
        value = frame.linear
        variance = _PHOTONS * value.clamp(min=0) + max(_READ, frame.step / 2) ** 2
        weight = ratio**2 / variance * ((_FULL - value) / (_FULL - _BRIGHT)).clamp(0, 1)
        if number != longest:
            weight = weight * (value / max(_DARK_STEPS * frame.step, 1e-6)).clamp(0, 1)
        weight = torch.where(frame.clipped, _BESIDE * weight, weight)
        total += weight * value / float(ratio)
        weights += weight
    # What no exposure shows well is as the shortest has it.
    none = weights <= 0
    linear = torch.where(none, frames[shortest].linear / float(ratios[shortest]), total / weights.clamp(min=1e-30))
    return linear, none.any(0) & frames[shortest].clipped


def bracket_groups(exposures: Sequence[float | None], count: int | None = None) -> list[list[int]]:
    """Return which photographs, in their order, are exposures of one thing: lists of their numbers.

    Args:
        exposures: of the photographs, by their files.
        count: exposures of each bracket; None finds the shortest run of different exposures that repeats throughout.

    Raises RangeError when they do not come out even.
    """
    total = len(exposures)
    if count is not None:
        if not 1 <= count <= _MOST or total % count:
            fact = f"{total} photographs in brackets of {count}"
            raise RangeError(message("capture", "photographs", "be whole brackets", fact, "Take the incomplete bracket out, or give its size."))
        return [list(range(first, first + count)) for first in range(0, total, count)]
    if all(one is not None for one in exposures):
        stops = np.round(np.log2(np.array(exposures, float)) * 3)  # thirds of stops
        for size in range(2, min(_MOST, total // 2) + 1):
            rows = stops[: total - total % size].reshape(-1, size)
            if total % size == 0 and (rows == rows[0]).all() and len(set(rows[0])) == size:
                return bracket_groups(exposures, size)
    return [[number] for number in range(total)]


def merge_photographs(photographs: Sequence[Photograph], count: int | None = None, encoding: str = "auto") -> tuple[list[Photograph], list[str]]:
    """Return photographs of which brackets are merged into one each, called by its best exposed file, and notes.

    Each bracket is read now, to be checked, and merged again whenever its pixels are asked for: a merged photograph takes as
    much memory as a plain one.
    """
    groups = bracket_groups([exposure_of(one.exif) for one in photographs], count)
    if all(len(group) == 1 for group in groups):
        return list(photographs), []
    merged: list[Photograph] = []
    notes: list[str] = []
    for group in groups:
        some = [photographs[number] for number in group]
        found = _merge(some)
        notes += found.notes
        merged.append(photograph(some[found.reference].path, encoding, lambda some=some: _merge(some).developed))  # type: ignore[misc]
    return merged, [f"{len(photographs)} photographs are brackets of {len(groups[0])} exposures", *notes]


def _merge(photographs: Sequence[Photograph]) -> Merged:
    frames = [one.read() for one in photographs]
    return merge_bracket([one.name for one in photographs], frames, [exposure_of(one.exif) for one in photographs])
