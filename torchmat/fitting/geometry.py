"""What a fit takes the surface for: flat, a relief that is recovered from the data, or a height map that is given."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchmat.btf import Btf
from torchmat.errors import RangeError, ShapeError, check_finite, check_option, message
from torchmat.geometry.height_file import load_height
from torchmat.geometry.normals import LARGEST_SCALE

FLAT, RECOVER, AUTO_RELIEF = "flat", "recover", "auto"
GEOMETRIES = (FLAT, RECOVER)


@dataclass(frozen=True)
class Flat:
    """Texels are taken for what they seem."""

    word = FLAT


@dataclass(frozen=True)
class Recover:
    """Height and normals are found from the training samples, and kept if they make the model better.

    Where the data has no view or lights to find them from, that is an error, or with `or_flat` the surface is flat and
    the report says why.
    """

    or_flat: bool = False
    word = RECOVER


@dataclass(frozen=True, eq=False)
class Given:
    """A height map [1, H, W] in texture widths over the plane of the images, taken as it is."""

    height: Tensor
    word = "given"


Geometry = Flat | Recover | Given


def resolve_geometry(asked: Any, *, default: str = FLAT, by_itself: bool = False) -> Geometry:
    """Return what a word, a path, a tensor, an array or a Geometry asks for, the same for every way in.

    A word is "flat" or "recover"; `by_itself` admits "auto" too, which leaves the relief to the data as "recover" does.
    None is the model's `default`, whose "recover" makes do with a flat surface where nothing can be recovered.
    A text that has a suffix or a folder, or that exists, is the path of a height map (`load_height`). Raises RangeError
    for other words, with the nearest one, DataError for files that cannot be read.
    """
    if asked is None:
        return Flat() if default == FLAT else Recover(or_flat=True)
    if isinstance(asked, Flat | Recover | Given):
        return asked
    if isinstance(asked, str) and not is_path(asked):
        check_word("fit", asked, by_itself)
        return Flat() if asked == FLAT else Recover()
    if isinstance(asked, str | Path):
        return Given(load_height(asked))
    return Given(_as_height(asked))


def check_word(where: str, text: str, by_itself: bool) -> None:
    """Raise RangeError, with the nearest word, for a text that is neither a way nor the path of a height map."""
    if not is_path(text):
        words = (*GEOMETRIES, *([AUTO_RELIEF] if by_itself else []), "the path of a height map")
        check_option(where, "geometry", text, words)


def is_path(text: str) -> bool:
    """Return whether a text names a height map's file rather than a way."""
    if text in (*GEOMETRIES, AUTO_RELIEF):
        return False
    return bool(Path(text).suffix) or len(Path(text).parts) > 1 or os.path.exists(text)


def check_height(height: Tensor, btf: Btf) -> Tensor:
    """Return a height map that the user gives as [1, H, W]; raises ShapeError or RangeError when it cannot be one."""
    size = (btf.height, btf.width)
    height = height.detach()
    height = height[None] if height.ndim == 2 else height
    if height.shape != (1, *size):
        step = "Resample it, or crop the images: texel by texel they must show the same place."
        raise ShapeError(message("fit", "geometry", f"be [1, {size[0]}, {size[1]}]", f"it is {tuple(height.shape)}", step))
    check_finite("fit", "geometry", height)
    span = float(height.max() - height.min())
    reach = float(height.abs().max())
    if span == 0 or reach >= LARGEST_SCALE:
        fact = "it is the same everywhere" if span == 0 else f"it reaches {reach:g} texture widths"
        step = "Heights are in texture widths; geometry=\"flat\" is a flat surface."
        raise RangeError(message("fit", "geometry", "be a height map of a surface", fact, step))
    return height


def _as_height(geometry: Any) -> Tensor:
    """Return a height map given as a tensor or array; raises RangeError for what is none."""
    try:
        height = torch.as_tensor(geometry)
        if height.is_complex():
            raise TypeError("complex numbers")
        return height if height.is_floating_point() else height.double()
    except (TypeError, ValueError, RuntimeError, NotImplementedError) as error:
        step = "Give 'flat', 'recover', the path of a height map, or one as [1, H, W] in texture widths."
        fact = f"it is {type(geometry).__name__}: {error}"
        raise RangeError(message("fit", "geometry", "be a height map", fact, step)) from error
