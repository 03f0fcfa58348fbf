"""Rendered pictures as files: 8-bit sRGB for people, linear EXR for programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from torch import Tensor

from torchmat import atomic, colour
from torchmat.errors import DataError, check_finite, message
from torchmat.images import write_image


def write_picture(picture: Tensor, path: Path, exposure: float = 1.0, exr: bool = False) -> list[Path]:
    """Write linear `picture` [3, H, W] times `exposure` as an 8-bit file, and on request unscaled as EXR beside it.

    Each file appears whole or not at all. Raises RangeError for values that are not finite, DataError, which names the
    file, when it cannot be written.
    """
    check_finite(str(path), "the picture", picture)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        step = "Choose another folder with --out."
        raise DataError(message(str(path.parent), "the folder", "be writable", str(error), step)) from error
    shown = (colour.display(picture * exposure) * 255).round()
    _write_whole(path, shown.permute(1, 2, 0).numpy().astype(np.uint8))
    if not exr:
        return [path]
    linear = path.with_suffix(".exr")
    _write_whole(linear, picture.permute(1, 2, 0).numpy().astype(np.float32))
    return [path, linear]


def _write_whole(path: Path, pixels: np.ndarray) -> None:
    with atomic.building_file(path) as built:
        write_image(built, pixels)
