"""What paint programs make of a texture, brought back to its form: alpha, grey or colour, another size. Each is said."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchmat.errors import DataError, message, notice
from torchmat.models.hue import is_grey
from torchmat.models.resample import VECTORS, resample, resample_map
from torchmat.models.storage import MapSpec

_LUMA = (0.2126, 0.7152, 0.0722)  # Rec. 709, of the codes as they are: what programs do that turn a picture to grey
_TABLES = ("specular", "tilt")  # shared by all texels, and drawn as pictures of any size


def in_channels(path: Path, pixels: np.ndarray, entry: Mapping[str, Any]) -> np.ndarray:
    """Return pixels [H, W, C] with the channels that a texture has by its entry in the manifest.

    An opaque alpha is dropped, a grey painting of a colour texture is taken for all three channels, and a colour painting
    of a grey one by its brightness. Raises DataError for alpha that is not opaque and for what cannot be converted.
    """
    wanted = entry["channels"]
    if wanted in (1, 3) and pixels.shape[2] in (2, 4):
        pixels = _without_alpha(path, pixels)
    have = pixels.shape[2]
    if have == wanted:
        return pixels
    if (have, wanted) == (1, 3) and entry["map"] not in VECTORS:
        notice(str(path), "it is grey, and was taken for all three channels")
        return np.repeat(pixels, 3, axis=2)
    equal = have == 3 and bool((pixels == pixels[:, :, :1]).all())
    if (have, wanted) == (3, 1) and (equal or entry["filter"] != "nearest"):
        how = "its channels are equal, and one was taken" if equal else "it is in colour, and its brightness was taken"
        notice(str(path), how)
        return pixels[:, :, :1] if equal else _brightness(pixels)
    fact = f"it is {pixels.shape[0]} x {pixels.shape[1]} with {have} channels"
    size = f"{entry['height']} x {entry['width']} x {wanted}"
    raise DataError(message(str(path), "the texture", f"be {size}", fact, "Save it with those channels."))


def _brightness(pixels: np.ndarray) -> np.ndarray:
    found = (pixels.astype(np.float64) @ np.array(_LUMA))[:, :, None]
    return (found.round() if np.issubdtype(pixels.dtype, np.integer) else found).astype(pixels.dtype)


def _without_alpha(path: Path, pixels: np.ndarray) -> np.ndarray:
    """Drop the alpha that paint programs like to add; what is not opaque has lost its colour to it."""
    full = np.iinfo(pixels.dtype).max if np.issubdtype(pixels.dtype, np.integer) else 1.0
    clear = int((pixels[:, :, -1] != full).sum())
    if clear:
        fact = f"{clear} of {pixels[:, :, -1].size} texels are not"
        raise DataError(message(str(path), "alpha", "be opaque", fact, "Flatten the picture or remove its alpha."))
    return pixels[:, :, :-1]


def check_hues(path: Path, pixels: np.ndarray) -> None:
    """Say how many texels of a rotation have no hue, and so no turn; raises DataError when most have none."""
    picture = torch.from_numpy(pixels.transpose(2, 0, 1).astype(np.float64) / np.iinfo(pixels.dtype).max)
    grey = int(is_grey(picture).sum())
    if 2 * grey > picture[0].numel():
        fact = f"{grey} of {picture[0].numel()} texels are grey"
        step = "Red is no turn, and the hue turns counter-clockwise."
        raise DataError(message(str(path), "the rotation", "be painted in hues", fact, step))
    if grey:
        notice(str(path), f"{grey} of {picture[0].numel()} texels are grey, and were taken for no turn")


def in_size(path: Path, texture: torch.Tensor, entry: Mapping[str, Any], full: tuple[int, int] | None, tiles: bool):
    """Return a texture [C, h, w] in the size that its entry in the manifest says, or in the `full` one, if there is another.

    Any other size is resampled. Raises DataError where that has no meaning: for tables that are no pictures.
    """
    size = (entry["height"], entry["width"])
    have = tuple(texture.shape[-2:])
    if have in (size, full or size):
        return texture
    if not entry["per_texel"] and entry["map"] not in _TABLES:
        fact = f"it is {have[0]} x {have[1]} with {texture.shape[0]} channels"
        requirement = f"be {size[0]} x {size[1]} x {entry['channels']}"
        raise DataError(message(str(path), "the texture", requirement, fact, "Scale it back, or export the material again."))
    wanted = full or size
    notice(str(path), f"it is {have[0]} x {have[1]}, and was resampled to {wanted[0]} x {wanted[1]}")
    spec = MapSpec(entry["map"], entry["meaning"], index=entry["filter"] == "nearest")
    tiles = tiles and entry["per_texel"]
    if len(texture) == 1 and entry["map"] in VECTORS:  # one component of a vector has no length of its own
        return resample(texture, wanted, tiles=tiles)
    return resample_map(spec, texture, wanted, tiles=tiles)
