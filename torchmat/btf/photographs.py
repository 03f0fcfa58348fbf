"""Photographs of one view whose lights stand in a table of numbers or in a chrome ball, without any manifest."""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchmat.btf.decode import Decoder, resolve_encoding
from torchmat.btf.listing import is_image
from torchmat.btf.pixels import split_channels
from torchmat.errors import DataError, ShapeError, message
from torchmat.images import read_image
from torchmat.text_file import read_text


def image_files(folder: str | Path) -> list[Path]:
    """Return the image files of a folder, sorted by name; raises DataError when there are none."""
    folder = Path(folder)
    if not os.path.isdir(folder):
        raise DataError(message(str(folder), "the path", "be a folder of photographs", "it is none", "Check the spelling."))
    found = sorted(path for path in folder.iterdir() if is_image(path.name))
    if not found:
        raise DataError(message(str(folder), "the folder", "hold photographs", "it holds none", "Check the spelling."))
    return found


def read_linear(path: str | Path, encoding: str = "auto") -> Tensor:
    """Return one picture [3, H, W], float32, linear; grey becomes three equal channels, alpha is dropped."""
    codes = np.ascontiguousarray(split_channels(read_image(path), str(path))[0])
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


def read_lights(path: str | Path, images: int) -> Tensor:
    """Return unit directions [n, 3] from a text file with one light a line, or one a column in three lines."""
    text = read_text(path, "the lights")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an empty file, which the check below names
            table = np.loadtxt(io.StringIO(text), ndmin=2, comments=("#", "%"))
    except ValueError as error:
        step = "Write x y z of one light a line, in the order of the photographs' names."
        raise DataError(message(str(path), "the lights", "be a table of numbers", str(error), step)) from error
    if table.shape[0] == 3 and table.shape[1] == images and images != 3:
        table = table.T
    largest = np.abs(table).max(axis=1, keepdims=True, initial=0)
    if table.shape != (images, 3) or not np.isfinite(table).all() or (largest == 0).any():
        fact = f"it is {table.shape[0]} x {table.shape[1]} for {images} photographs"
        raise DataError(message(str(path), "the table", "hold x y z for each photograph", fact, "One light a line."))
    table = table / largest  # or squares of positions far away would leave the range of numbers
    return torch.from_numpy(table / np.linalg.norm(table, axis=1, keepdims=True)).float()
