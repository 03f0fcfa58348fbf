"""Raw files of cameras as linear light, through rawpy (LibRaw)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchmat.capture.extra import rawpy
from torchmat.errors import DataError, message

RAW_SUFFIXES = frozenset({
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".iiq", ".kdc", ".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf",
    ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
})
_FULL = 0.99  # of the white level from which a photosite counts as clipped
# LibRaw's codes of how the stored picture is turned to stand upright.
_TURNS = {0: 0, 3: 2, 5: 1, 6: 3}  # times 90 degrees, anticlockwise


class Raw(NamedTuple):
    """A raw file: `size` (width, height) upright, `linear` [H, W, 3] float32 and `clipped` [H, W], both None where only the
    head is read; exposure `seconds`, `f_number`, `iso` and `focal` length in mm where rawpy tells them."""

    size: tuple[int, int]
    linear: np.ndarray | None
    clipped: np.ndarray | None
    seconds: float | None
    f_number: float | None
    iso: float | None
    focal: float | None


def read_raw(path: str | Path, pixels: bool = True) -> Raw:
    """Return a raw file's colours as linear Rec. 709, 1 at the sensor's white level.

    No curve, no automatic brightness or scaling by what is in the picture, 16 bits, and LibRaw's balance for daylight, the
    same for all photographs of a camera: what the camera or a guess would set differs from one to the next. What is clipped
    is told by the sensor's own values, since the matrix to Rec. 709 mixes channels. Raises DataError, which names the file,
    when it cannot be read or rawpy is not installed.
    """
    library = rawpy()
    try:
        with library.imread(str(path)) as raw:
            turns = _TURNS.get(raw.sizes.flip, 0)
            size = (raw.sizes.width, raw.sizes.height) if turns % 2 == 0 else (raw.sizes.height, raw.sizes.width)
            facts = [_said(raw, name) for name in ("shutter_speed", "aperture", "iso_speed", "focal_length")]
            if not pixels:
                return Raw(size, None, None, *facts)
            developed = raw.postprocess(
                gamma=(1, 1), no_auto_bright=True, use_camera_wb=False, use_auto_wb=False, output_color=library.ColorSpace.sRGB,
                output_bps=16, highlight_mode=library.HighlightMode.Clip, adjust_maximum_thr=0.0,
            )
            linear = developed.astype(np.float32) / np.float32(65535)
            return Raw(size, linear, _clipped(raw, turns, linear.shape[:2]), *facts)
    except library.LibRawError as error:
        step = "Check that the file is complete, or convert it to DNG or 16-bit TIFF."
        raise DataError(message(str(path), "the raw file", "be readable", str(error), step)) from error


def _said(raw: Any, name: str) -> float | None:
    """Return a field of the exposure, None where this release of rawpy has none."""
    return getattr(getattr(raw, "other", None), name, None)


def _clipped(raw: Any, turns: int, shape: tuple[int, int]) -> np.ndarray:
    """Return which pixels [H, W] of the developed picture have a photosite at the white level among their neighbours."""
    from scipy.ndimage import maximum_filter

    sites = raw.raw_image_visible
    levels = raw.camera_white_level_per_channel or [raw.white_level] * 4
    levels = [level or raw.white_level for level in levels]
    full = sites if sites.ndim == 2 else sites[..., :3].max(axis=2)
    limit = np.asarray(levels, np.float32)[np.minimum(raw.raw_colors_visible, 3)] if sites.ndim == 2 else min(levels)
    mask = np.rot90(maximum_filter(full >= _FULL * limit, size=3), turns)
    if mask.shape == shape:
        return np.ascontiguousarray(mask)
    rows, columns = (np.minimum(np.arange(n) * m // n, m - 1) for n, m in zip(shape, mask.shape, strict=True))
    return mask[np.ix_(rows, columns)]  # sensors whose rows or columns are thinned or stretched
