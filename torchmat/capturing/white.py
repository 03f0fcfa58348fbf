"""Exposure and white balance from white of known reflectance, and grey as a check that the values are linear light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchmat.capturing.board import GREY, WHITE
from torchmat.errors import RangeError, check_positive, message

_BENT = 0.03  # relative spread of the grey patch from photograph to photograph that a straight response does not make
_WRONG = 0.1  # relative deviation from a grey whose reflectance is given
_LEAST = 4  # photographs before a course over the exposure means anything


@dataclass(frozen=True, eq=False)
class White:
    """What white tells: `scale` [n, 3], the value that each photograph has for a matte reflectance of 1 under the irradiance 1
    (its exposure, its lamp and its white balance in one), from the patch or, where that cannot be used, from the `paper`'s
    reflectance [3]; `grey` [3], what the grey patch reflects, NaN where it was not seen, and its relative `spread` over the
    photographs; `bend`, the exponent by which values deviate from linear light (0: straight) as the grey patch shows it."""

    scale: np.ndarray
    paper: np.ndarray
    grey: np.ndarray
    spread: float
    bend: float
    notes: tuple[str, ...]


def calibrate_white(
    level: np.ndarray, patch: np.ndarray, grey: np.ndarray, reflectance: float = WHITE, grey_reflectance: float | None = None
) -> White:
    """Return the scale of each photograph.

    Matte white of reflectance rho shows k rho E for the irradiance E that the lamp's position tells, so that k is its value
    over rho. The paper stands for the patch everywhere: it is read at thousands of points around the sample, and the patch,
    over all photographs, tells its reflectance. A grey patch reflects the same share of the paper's light in every photograph
    if values are linear; the course of that share over the exposure is the bend of the response.

    Args:
        level: [n, 3], of the paper (`Course.level`).
        patch: [n, 3], what the white patch shows over what paper there would; NaN where it is clipped, hidden or in shadow.
        grey: [n, 3], the same of the grey patch.
        reflectance: of the white patch, or of the paper where no photograph shows the patch.
        grey_reflectance: of the grey patch where it is known; None measures it.

    Raises RangeError when a reflectance is not in (0, 1], or when the known grey deviates by more than a tenth.
    """
    for name, value in (("white", reflectance), ("grey", grey_reflectance)):
        if value is not None:
            check_positive("capture", f"the {name} patch's reflectance", value, "Give it as a share, such as 0.9.")
            if value > 1:
                fact, step = f"it is {value:g}", "Give it as a share, such as 0.9 for 90 %."
                raise RangeError(message("capture", f"the {name} patch's reflectance", "be at most 1", fact, step))
    seen = np.isfinite(patch).all(1)
    notes = []
    if seen.any():
        paper = reflectance / np.median(patch[seen], axis=0)
    else:
        paper = np.full(3, reflectance)
        notes.append(f"the white patch is clipped, hidden or in shadow in every photograph: the paper is taken for {reflectance:g}")
    share, spread, bend, more = _greys(level, grey, paper, grey_reflectance)
    return White(level / paper, paper, share, spread, bend, (*notes, *more))


def _greys(
    level: np.ndarray, grey: np.ndarray, paper: np.ndarray, known: float | None
) -> tuple[np.ndarray, float, float, list[str]]:
    seen = np.isfinite(grey).all(1)
    if not seen.any():
        return np.full(3, np.nan), np.nan, np.nan, ["no photograph shows the grey patch: that values are linear light is not checked"]
    share = grey[seen] * paper
    middle = np.median(share, axis=0)
    if not (share.mean(1) > 0).all() or not middle.mean() > 0:
        return middle, np.nan, np.nan, ["the grey patch shows no light: is it covered, or the board another one (--size)? That values are linear light is not checked"]
    off = np.log(share.mean(1) / middle.mean())
    spread = float(1.4826 * np.median(np.abs(off - np.median(off))))
    at = np.log(level[seen].mean(1))
    bend, notes = 0.0, []
    if len(at) >= _LEAST and np.ptp(at) > 0.2:
        bend = float(np.polyfit(at, off, 1)[0])
    if spread > _BENT:
        notes.append(f"the grey patch reflects {middle.mean():.3f} give or take {100 * spread:.0f} % from photograph to photograph: values may not be linear light")
    if known is not None and abs(np.log(middle.mean() / known)) > _WRONG:
        fact = f"it shows {middle.mean():.3f} where {known:g} is given"
        step = "Photograph raw or without a picture style, or correct the reflectance; a curve in the values would bend every map."
        raise RangeError(message("capture", "the grey patch", "show its reflectance within 10 %", fact, step))
    if known is None and abs(np.log(middle.mean() / GREY)) > 0.5:
        notes.append(f"the grey patch shows {middle.mean():.3f}, where {GREY:g} was meant: a printer's, or a curve in the values")
    return middle, spread, bend, notes
