"""Pictures, one or a folder of them, decoded at once."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchmat.btf.decode import Decoder, resolve_encoding
from torchmat.btf.listing import is_image, natural
from torchmat.btf.pixels import split_channels
from torchmat.channels import rgb_of_xyz
from torchmat.errors import DataError, ShapeError, message
from torchmat.images import read_picture


def image_files(folder: str | Path) -> list[Path]:
    """Return the image files of a folder, as people count (img2 before img10); raises DataError when there are none."""
    folder = Path(folder)
    if not os.path.isdir(folder):
        raise DataError(message(str(folder), "the path", "be a folder of photographs", "it is none", "Check the spelling."))
    found = sorted((path for path in folder.iterdir() if is_image(path.name)), key=lambda path: natural(path.name))
    if not found:
        raise DataError(message(str(folder), "the folder", "hold photographs", "it holds none", "Check the spelling."))
    return found


def read_linear(path: str | Path, encoding: str = "auto") -> Tensor:
    """Return one picture [3, H, W], float32, linear; grey becomes three equal channels, alpha is dropped.

    `encoding` "auto" follows the picture's colour profile. CIE XYZ, by the names of the channels or the `encoding` "xyz",
    becomes linear Rec. 709 RGB.
    """
    return read_with_alpha(path, encoding)[0]


def read_with_alpha(path: str | Path, encoding: str = "auto") -> tuple[Tensor, Tensor | None, int]:
    """Return a picture as `read_linear` does, its alpha [1, H, W] or None, and how many channels its file has."""
    pixels, xyz = read_picture(path, by_profile=encoding == "auto")
    codes, alpha = split_channels(pixels, str(path))
    codes = np.ascontiguousarray(codes)
    if xyz or encoding == "xyz":
        codes, encoding = rgb_of_xyz(str(path), codes.astype(np.float32) if xyz else codes), "linear"
    share = None if alpha is None else _decoded(np.ascontiguousarray(alpha[None]), "linear")
    return _decoded(codes, encoding), share, pixels.shape[2]


def _decoded(codes: np.ndarray, encoding: str) -> Tensor:
    decoder = Decoder(codes.dtype, resolve_encoding(encoding, codes.dtype), 1.0)
    return decoder.into(codes, torch.empty(codes.shape))


def read_photographs(folder: str | Path, encoding: str = "auto") -> Tensor:
    """Return all pictures of a folder, in the order of their names, as [n, 3, H, W]; they must have one size."""
    files = image_files(folder)
    images = [read_linear(path, encoding) for path in files]
    for path, image in zip(files, images, strict=True):
        if image.shape != images[0].shape:
            fact = f"it is {tuple(image.shape[1:])}, {files[0].name} is {tuple(images[0].shape[1:])}"
            raise ShapeError(message(str(path), "the photograph", "have the size of the others", fact, "Crop them alike."))
    return torch.stack(images)
