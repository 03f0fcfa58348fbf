"""Height maps from files: a relief that torchmat wrote, or a floating-point picture."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import DataError, check_finite, message
from torchmat.images import read_image
from torchmat.text_file import read_json


def load_height(path: str | Path) -> Tensor:
    """Return a height [1, H, W] in texture widths: of a folder that `save_relief` wrote, or of a floating-point image.

    Raises DataError for codes whose range nobody states.
    """
    path = Path(path)
    low, high = None, None
    if os.path.isdir(path):
        low, high, path = _described(path)
    pixels = read_image(path)
    if pixels.shape[2] != 1:
        fact = f"it has {pixels.shape[2]}"
        raise DataError(message(str(path), "a height map", "have one channel", fact, "Save it as a grey picture."))
    height = torch.from_numpy(pixels.astype(np.float32)).permute(2, 0, 1)
    if np.issubdtype(pixels.dtype, np.integer):
        if low is None or high is None:
            step = "Give the folder that holds its relief.json, or a floating-point image in texture widths."
            raise DataError(message(str(path), "the range of its codes", "be known", f"they are {pixels.dtype}", step))
        height = low + height * ((high - low) / np.iinfo(pixels.dtype).max)
    check_finite(str(path), "the height", height)
    return height


def _described(folder: Path) -> tuple[float, float, Path]:
    described = read_json(folder / "relief.json", "the relief", "be described")
    try:
        low, high = float(described["height_low"]), float(described["height_high"])
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        step = "Give a folder that `torchmat geometry` wrote, or a floating-point image."
        fact = f"{type(error).__name__}: {error}"
        raise DataError(message(str(folder / "relief.json"), "the relief", "be described", fact, step)) from error
    if not low <= high or math.isinf(high - low):
        fact = f"height_low is {low:.6g} and height_high {high:.6g}"
        step = "Restore the file from the original."
        raise DataError(message(str(folder / "relief.json"), "the range", "be finite and run upward", fact, step))
    for name in ("height.png", "height.exr"):
        if (folder / name).is_file():
            return low, high, folder / name
    step = "Restore it, or run `torchmat geometry` again."
    raise DataError(message(str(folder), "the relief", "hold height.png or height.exr", "it holds neither", step))
