"""Raw files of cameras as linear light, through rawpy (LibRaw)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchmat.capturing.extra import rawpy
from torchmat.errors import DataError, message
from torchmat.images import Exif

RAW_SUFFIXES = frozenset({
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".iiq", ".kdc", ".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf",
    ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
})
_FULL = 0.99  # of the white level from which a photosite counts as clipped
# LibRaw's codes of how the stored picture is turned to stand upright: EXIF's orientation, and quarter turns counterclockwise.
_TURNS = {0: (1, 0), 3: (3, 2), 5: (8, 1), 6: (6, 3)}


class Raw(NamedTuple):
    """A raw file as it is shown: `linear` [3, H, W] float32 and `clipped` [H, W] (empty where only the head is read), and what
    it says of how it was taken, as far as rawpy tells."""

    exif: Exif
    linear: np.ndarray
    clipped: np.ndarray


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
            orientation, turns = _TURNS.get(raw.sizes.flip, (1, 0))
            numbers = (_said(raw, name) for name in ("focal_length", "", "shutter_speed", "aperture", "iso_speed"))
            exif = Exif((raw.sizes.width, raw.sizes.height), orientation, "", *numbers)
            if not pixels:
                return Raw(exif, np.empty((3, 0, 0), np.float32), np.empty((0, 0), bool))
            developed = raw.postprocess(
                gamma=(1, 1), no_auto_bright=True, use_camera_wb=False, use_auto_wb=False, output_color=library.ColorSpace.sRGB,
                output_bps=16, highlight_mode=library.HighlightMode.Clip, adjust_maximum_thr=0.0,
            )
            linear = developed.transpose(2, 0, 1).astype(np.float32) / np.float32(65535)
            return Raw(exif, np.ascontiguousarray(linear), _clipped(raw, turns, linear.shape[1:]))
    except library.LibRawError as error:
        step = "Check that the file is complete, or convert it to DNG or 16-bit TIFF."
        raise DataError(message(str(path), "the raw file", "be readable", str(error), step)) from error


def _said(raw: Any, name: str) -> float | None:
    """Return a number that the file says, None where it does not, or where this release of rawpy has none."""
    number = getattr(getattr(raw, "other", None), name, None)
    return float(number) if number and 0 < number < float("inf") else None


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
