"""Rendered pictures as files: 8-bit sRGB for people, linear EXR for programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from torch import Tensor

from torchmat import atomic, colour
from torchmat.errors import DataError, check_finite, message
from torchmat.images import write_image


NEUTRAL = 0.18  # linear: the grey that photographers expose for, between dark and light materials


def on_neutral(picture: Tensor, coverage: Tensor, level: float = NEUTRAL) -> Tensor:
    """Return `picture` [3, H, W] before an even grey of that `level`; `coverage` [1, H, W] is the object's share."""
    return picture + level * (1 - coverage)


def write_picture(
    picture: Tensor, path: Path, exposure: float = 1.0, exr: bool = False, coverage: Tensor | None = None
) -> list[Path]:
    """Write linear `picture` [3, H, W] times `exposure` as an 8-bit file, and on request unscaled as EXR beside it.

    With `coverage` [1, H, W], the object's share of each pixel, the 8-bit file shows it before a neutral grey, whatever
    the exposure; the EXR stays black there. Each file appears whole or not at all. Raises RangeError for values that are not finite, DataError, which names the
    file, when it cannot be written.
    """
    check_finite(str(path), "the picture", picture)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        step = "Choose another folder with --out."
        raise DataError(message(str(path.parent), "the folder", "be writable", str(error), step)) from error
    lit = picture * exposure
    shown = (colour.display(lit if coverage is None else on_neutral(lit, coverage)) * 255).round()
    _write_whole(path, shown.permute(1, 2, 0).numpy().astype(np.uint8))
    if not exr:
        return [path]
    linear = path.with_suffix(".exr")
    _write_whole(linear, picture.permute(1, 2, 0).numpy().astype(np.float32))
    return [path, linear]


def _write_whole(path: Path, pixels: np.ndarray) -> None:
    with atomic.building_file(path) as built:
        write_image(built, pixels)
