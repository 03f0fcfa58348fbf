"""The planes that relight and OpenLIME share: ``info.json`` and ``plane_0.jpg``, ``plane_1.jpg`` ..., three coefficients in each.

A coefficient is ``(code / 255 - bias) * scale``, for values of 0 to 1. Of "rgb" plane k is the k-th term of red, green and blue; of
"lrgb" plane 0 is a colour, and the others hold terms of luminance.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from torchmat.errors import DataError, message
from torchmat.material_io.rti.coefficients import Coefficients, Ranges, arranged, harmonics_in_files

INFO = "info.json"
POLYNOMIAL = (5, 3, 4, 0, 2, 1)  # which of our terms stand where: 1, x, y, x^2, x y, y^2
LARGEST = 65_535  # texels of a side, in a JPEG
_KNOWN = {("ptm", "rgb", 18): "ptm", ("ptm", "lrgb", 9): "lptm", ("hsh", "rgb", 12): "hsh", ("hsh", "rgb", 27): "hsh"}
_STEP = "Build it again in RelightLab as PTM or HSH, colour RGB or LRGB."


def order_of(model: str, channels: int) -> Ranges:
    """Return which channel of ours stands at each plane of relight's, and with which sign."""
    if model == "hsh":
        return harmonics_in_files(channels // 3)
    if model == "lptm":
        return np.array([0, 1, 2, *(3 + term for term in POLYNOMIAL)]), np.ones(channels)
    return np.repeat(3 * np.array(POLYNOMIAL), 3) + np.tile(np.arange(3), 6), np.ones(channels)


def info_of(found: Coefficients, image: str, quality: int) -> tuple[dict[str, Any], np.ndarray]:
    """Return what ``info.json`` says, and the planes [k, H, W, 3] as pixels."""
    place, sign = order_of(found.model, len(found.codes))
    low, high = sign * found.low[place], sign * found.high[place]
    _, height, width = found.codes.shape
    info = {
        "width": width, "height": height, "format": image, "type": "hsh" if found.model == "hsh" else "ptm",
        "colorspace": "lrgb" if found.model == "lptm" else "rgb", "nplanes": len(place), "quality": quality, "lights": [],
        "materials": [{"scale": (high - low).tolist(), "bias": (-low / (high - low)).tolist()}],
    }
    return info, np.ascontiguousarray(found.codes[place].reshape(-1, 3, height, width).transpose(0, 2, 3, 1))


def checked_info(where: str, info: dict[str, Any]) -> tuple[str, int, int, Ranges]:
    """Return the model, height, width, and the ends of each plane, of what an ``info.json`` says; raises DataError."""
    try:
        kind, space, planes = info["type"], info["colorspace"], info["nplanes"]
        size = [info["height"], info["width"]]
        materials = info["materials"]
    except KeyError as error:
        raise DataError(message(where, "info.json", "describe a relightable image", f"{error} is missing", _STEP)) from error
    model = _KNOWN.get((kind, space, planes)) if isinstance(planes, int) and isinstance(kind, str) and isinstance(space, str) else None
    if model is None:
        fact = f"it is {kind!r}, {space!r} with {planes!r} planes"
        requirement = "be ptm of 6 terms, or hsh of 4 or 9, in rgb, or ptm in lrgb"
        raise DataError(message(where, "the basis", requirement, fact, _STEP))
    if not all(isinstance(side, int) and not isinstance(side, bool) and 1 <= side <= LARGEST for side in size):
        raise DataError(message(where, "height and width", f"lie in 1 to {LARGEST}", f"they are {size}", "Correct the file."))
    return model, *size, _ends(where, materials, planes)


def _ends(where: str, materials: Any, planes: int) -> Ranges:
    try:
        if len(materials) != 1:
            step = "Build it again with one material."
            raise DataError(message(where, "materials", "be one", f"there are {len(materials)}", step))
        scale, bias = (np.array(materials[0][name], np.float64) for name in ("scale", "bias"))
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        fact = f"{type(error).__name__}: {error}"
        raise DataError(message(where, "materials", "hold a scale and a bias for each plane", fact, _STEP)) from error
    sound = scale.shape == bias.shape == (planes,) and bool(np.isfinite(scale).all() and np.isfinite(bias).all())
    if not sound or (scale == 0).any() or abs(scale).max() > 1e6 or abs(bias).max() > 1e6:
        fact = f"their shapes are {scale.shape} and {bias.shape}"
        raise DataError(message(where, "scale and bias", f"be {planes} finite numbers each, scales not 0", fact, _STEP))
    return -bias * scale, (1 - bias) * scale


def coefficients_from(model: str, planes: np.ndarray, ends: Ranges) -> Coefficients:
    """Return the coefficients of planes [channels, H, W] in relight's order."""
    return arranged(model, planes, *ends, *order_of(model, len(planes)))
