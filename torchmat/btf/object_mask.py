"""Which texels show the object: by a picture beside the photographs, by their alpha, or found from a dark background."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
import torch
from torch import Tensor

from torchmat.btf.background import dark_border, without_background
from torchmat.btf.btf import Btf
from torchmat.btf.listing import Listing, is_mask
from torchmat.btf.pixels import read_pixels
from torchmat.btf.source import File, Folder, Zip
from torchmat.errors import DataError, ShapeError, message
from torchmat.images import read_image

NONE, ALPHA, BACKGROUND = "none", "alpha", "background"
MASK_WORDS = (NONE, ALPHA, BACKGROUND)
Asked = str | Path | Tensor | np.ndarray | None


@dataclass(frozen=True)
class Placed:
    """How texels come from the photographs: their `size` (rows, columns), what is cropped of it, and the factor it shrinks by."""

    size: tuple[int, int]
    crop: tuple[int, int, int, int] | None = None
    downscale: int = 1

    def place(self, where: str, mask: np.ndarray, texels: tuple[int, int]) -> np.ndarray:
        """Return a mask of the photographs, or of `texels` (rows, columns) themselves, as one of the texels.

        A texel that shrinking makes of object and background is background. Raises ShapeError for other sizes.
        """
        if mask.shape == texels and mask.shape != self.size:
            return mask
        if mask.shape != self.size:
            fact = f"it is {mask.shape[0]} x {mask.shape[1]} and they are {self.size[0]} x {self.size[1]}"
            step = "Give the mask that belongs to these photographs, or --mask none (mask=\"none\")."
            raise ShapeError(message(where, "the mask", "have the photographs' size", fact, step))
        if self.crop is not None:
            top, left, height, width = self.crop
            mask = mask[top : top + height, left : left + width]
        rows, columns, factor = *texels, self.downscale
        blocks = mask[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
        return np.asarray(blocks.all(axis=(1, 3)))


def read_mask(path: str | Path) -> np.ndarray:
    """Return a picture as an object mask, bool [H, W]: white is the object.

    From half white on; of a picture whose alpha is not the same throughout its alpha counts, else the mean of its colours.
    Codes of 0 and 1 alone count as black and white. Raises DataError, which names the file, when it cannot be read.
    """
    pixels = read_image(path)
    channels = pixels.shape[2]
    alpha = pixels[:, :, -1] if channels in (2, 4) else None
    use_alpha = alpha is not None and bool((alpha != alpha.flat[0]).any())
    grey = alpha if use_alpha and alpha is not None else pixels[:, :, : channels - (channels in (2, 4))].mean(axis=2, dtype=np.float64)
    whole = np.issubdtype(pixels.dtype, np.integer)
    white = np.iinfo(pixels.dtype).max if whole and grey.max() > 1 else 1
    return np.asarray(grey >= white / 2)


def mask_beside(source: File | Folder | Zip, listing: Listing) -> str | None:
    """Return the name of the one picture called ``mask`` beside the photographs, or above them; None if there is none."""
    if isinstance(source, File):
        return None
    used = set(listing.files)
    found = [name for name in source.names if is_mask(name) and name not in used]
    folder = PurePosixPath(listing.files[0]).parent
    for place in (folder, *folder.parents):
        here = [name for name in found if PurePosixPath(name).parent == place]
        if here:
            return here[0] if len(here) == 1 else None
    return None


def photographs_size(source: File | Folder | Zip, listing: Listing, texels: tuple[int, int]) -> tuple[int, int]:
    """Return rows and columns of the photographs before anything is cropped."""
    if isinstance(source, File):
        return texels
    rows, columns = read_pixels(source, listing.files[0])[0].shape[:2]
    return rows, columns


def has_alpha(source: File | Folder | Zip, listing: Listing) -> bool:
    """Tell whether photographs have alpha, by the first of them."""
    return not isinstance(source, File) and read_pixels(source, listing.files[0])[0].shape[2] in (2, 4)


def given_mask(where: str, mask: Tensor | np.ndarray) -> np.ndarray:
    """Return a mask that is given as a tensor or array, bool or 0/1, as bool [H, W]."""
    found = np.asarray(mask.detach().numpy() if isinstance(mask, Tensor) else mask)
    found = found[0] if found.ndim == 3 and len(found) == 1 else found
    if found.ndim != 2 or found.dtype.kind not in "buif" or bool(((found != 0) & (found != 1)).any()):
        fact = f"it is {list(found.shape)} of {found.dtype}"
        raise ShapeError(message(where, "mask", "be [H, W], boolean or 0/1", fact, "Compare it with a threshold first."))
    return found.astype(bool)


def chosen_mask(
    source: File | Folder | Zip, listing: Listing, btf: Btf, asked: Asked, crop: tuple[int, int, int, int] | None, downscale: int,
) -> Btf:
    """Return a Btf of the object that a mask shows: the one asked for, or else the one that comes with the photographs."""
    texels = (btf.height, btf.width)
    if isinstance(asked, Tensor | np.ndarray):
        given = Placed(texels).place("load_btf", given_mask("load_btf", asked), texels)
        return _masked(btf, given, "the one given", "load_btf")
    if asked == NONE:
        return btf
    if asked == BACKGROUND:
        mask, how = without_background(btf)
        return _masked(btf, mask, "the background", btf.source.path).noted(how)
    beside = mask_beside(source, listing) if asked is None else None
    if beside is None and asked in (None, ALPHA):
        return _by_alpha(source, listing, btf, asked is not None)
    where = str(asked) if beside is None else f"{source.path}: {beside}"
    found = _read(source, beside, where)
    placed = Placed(photographs_size(source, listing, texels), crop, downscale)
    return _masked(btf, placed.place(where, found, texels), where if beside is None else beside, where)


def _read(source: File | Folder | Zip, beside: str | None, where: str) -> np.ndarray:
    """Return the mask of a picture of the source, or of one that lies elsewhere."""
    if beside is not None and not isinstance(source, File):
        with source.file(beside) as path:
            return read_mask(path)
    if not os.path.isfile(where):
        step = f"Give the path of a picture, or one of {', '.join(MASK_WORDS)}."
        raise DataError(message(where, "the mask", "be a picture", "there is no such file", step))
    return read_mask(where)


def _masked(btf: Btf, mask: np.ndarray, source: str, where: str) -> Btf:
    """Return a Btf of the object alone, noting where its mask is from; raises DataError for a mask of nothing."""
    share = float(mask.mean())
    if share == 0:
        step = "White is the object: turn it round, or give another (--mask none takes all texels)."
        raise DataError(message(where, "the mask", "show the object", "it is black throughout", step))
    if share == 1:
        return btf.noted(f"the mask of {source} is white throughout: no texel is left out")
    said = f"object mask of {source}: {100 * share:.1f} % of the texels are the object, the others count nowhere"
    return btf.masked(torch.from_numpy(mask), source).noted(said)


def _by_alpha(source: File | Folder | Zip, listing: Listing, btf: Btf, asked: bool) -> Btf:
    """Return a Btf of what alpha covers in some photograph, with a suggestion where they have none that says anything."""
    seen = btf.seen_somewhere()
    left_out = bool(seen.any()) and not bool(seen.all())
    alpha = (asked or left_out) and has_alpha(source, listing)
    if asked and not alpha:
        step = "Leave the mask out, or give a picture of it."
        raise DataError(message(btf.source.path, "mask='alpha'", "have photographs with alpha", "they have none", step))
    if alpha:
        return _masked(btf, seen.numpy(), "the photographs' alpha", btf.source.path)
    hint = dark_border(btf)
    return btf if hint is None else btf.noted(hint)
