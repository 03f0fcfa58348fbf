"""load_btf: the one door for measured data."""

from __future__ import annotations

import dataclasses
import operator
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchmat.btf.btf import CLIPPED_WEIGHT, Btf, Source, unique_directions
from torchmat.btf.cache import open_store
from torchmat.btf.decode import ENCODINGS, Decoder, resolve_encoding
from torchmat.btf.listing import Listing
from torchmat.btf.pixels import PixelOptions
from torchmat.btf.reader import READERS
from torchmat.btf.readers import open_source, read_listing, reading_key
from torchmat.btf.store import PixelStore
from torchmat.errors import RangeError, check_option, check_positive, message

INVALID_WAYS, DUPLICATE_WAYS = ("error", "mask"), ("error", "keep")
_KIND_OF_TABLE = {".csv": "manifest", ".lp": "rti"}


def load_btf(
    path: str | Path,
    kind: str | None = None,
    *,
    encoding: str = "auto",
    exposure: float = 1.0,
    crop: Sequence[int] | None = None,
    downscale: int = 1,
    lights: Sequence[int] | None = None,
    views: Sequence[int] | None = None,
    invalid: str = "error",
    duplicates: str = "error",
    normalise: bool = False,
    clipped_weight: float = CLIPPED_WEIGHT,
    cache: bool | str | Path = True,
    progress: bool | None = None,
) -> Btf:
    """Load a measured BTF or RTI capture; values come out linear.

    Samples at the largest 8- or 16-bit code are clipped. Where images have alpha, what it covers less than half has
    weight 0.

    Args:
        path: a folder, a zip, or a file that a registered reader takes; the ``manifest.csv`` or ``.lp`` file itself means its folder.
        kind: "ubo2003", "utia", "manifest", "rti" or the name of another reader (`register_reader`); None finds it from the
            content.
        encoding: "srgb" or "linear"; "auto" reads integer files as sRGB and floating-point files as linear.
        exposure: factor that the images were exposed with, above 0; values are divided by it.
        crop: (top, left, height, width) in texels; None is all.
        downscale: whole factor, at least 1, averaged in linear light; rows and columns left over are dropped.
        lights, views: numbers, in the order of ``btf.lights`` and ``btf.views``, of the directions to keep; None is all.
        invalid: what to do with NaN and Inf: "error", or "mask" for weight 0.
        duplicates: what to do with repeated directions: "error" or "keep".
        normalise: whether directions that are not unit are made so; else they are an error.
        clipped_weight: what a clipped sample counts in a fit, 0 to 1.
        cache: folder for decoded images; True is the user's cache folder, or $TORCHMAT_CACHE, and False is none.
        progress: whether to show a bar; None shows it on a terminal.

    Raises DataError, ShapeError or RangeError, each naming the file.
    """
    start = time.perf_counter()
    check_option("load_btf", "encoding", encoding, ENCODINGS)
    check_option("load_btf", "invalid", invalid, INVALID_WAYS)
    check_option("load_btf", "duplicates", duplicates, DUPLICATE_WAYS)
    check_positive("load_btf", "exposure", exposure, "It divides all values; 1 leaves them.")
    path = Path(path)
    table = _KIND_OF_TABLE.get(path.suffix.lower())
    if table is not None and os.path.isfile(path):
        path, kind = path.parent, kind or table
    options = PixelOptions(
        crop=_crop(crop),
        downscale=_whole("downscale", downscale),
        invalid=invalid,
        encoding=encoding if downscale > 1 else "auto",  # without averaging the codes are stored as they are
    )
    if kind is not None:
        check_option("load_btf", "kind", kind, READERS)
    source = open_source(path, kind)
    try:
        opened = open_store(
            source, lambda: read_listing(source, kind, duplicates, normalise),
            (*reading_key(source, kind), duplicates, normalise), options, cache, progress,
        )
    finally:
        source.close()
    listing, store = _select(opened.listing, opened.store, lights, views, str(path))
    stored = store.pixels.dtype
    decoder = Decoder(stored, "linear" if opened.linear else resolve_encoding(encoding, stored), float(exposure))
    seconds = time.perf_counter() - start
    origin = Source(listing.kind, str(path), listing.files, seconds, opened.from_cache)
    return Btf(store, listing.light.float(), listing.view.float(), decoder, origin, clipped_weight)


def _whole(name: str, value: Any) -> int:
    try:
        if not isinstance(value, bool):
            return operator.index(value)
    except TypeError:
        pass
    raise RangeError(message("load_btf", name, "be a whole number", f"it is {value!r}", "Give an integer."))


def _crop(crop: Sequence[int] | None) -> tuple[int, int, int, int] | None:
    if crop is None:
        return None
    top_left_height_width = tuple(_whole("crop", number) for number in crop)
    if len(top_left_height_width) != 4:
        fact = f"it has {len(top_left_height_width)} numbers"
        raise RangeError(message("load_btf", "crop", "be (top, left, height, width)", fact, "Give four numbers."))
    return top_left_height_width


def _chosen(name: str, wanted: Sequence[int], count: int, where: str) -> list[int]:
    """Return direction numbers as a list, each from 0 to `count` - 1; at least one."""
    if not hasattr(wanted, "__len__"):
        raise RangeError(message(where, name, "be a list of numbers", f"it is {wanted!r}", "Put it in brackets."))
    numbers = [_whole(name, number) for number in wanted]
    outside = [number for number in numbers if not 0 <= number < count]
    if outside or not numbers:
        fact = f"{outside[0]} is not" if outside else "none is given"
        step = "Leave the option out to keep all."
        raise RangeError(message(where, name, f"be numbers from 0 to {count - 1}", fact, step))
    return numbers


def _select(
    listing: Listing, store: PixelStore, lights: Sequence[int] | None, views: Sequence[int] | None, where: str
) -> tuple[Listing, PixelStore]:
    keep = torch.ones(len(listing.files), dtype=torch.bool)
    for name, directions, wanted in (("lights", listing.light, lights), ("views", listing.view, views)):
        if wanted is not None:
            distinct, index = unique_directions(directions.float())  # as Btf does, or the numbers might differ
            keep &= torch.isin(index, torch.tensor(_chosen(name, wanted, len(distinct), where)))
    if bool(keep.all()):
        return listing, store
    if not bool(keep.any()):
        step = "Choose pairs that were measured."
        raise RangeError(message(where, "lights and views", "leave at least one image", "they leave none", step))
    rows = keep.nonzero()[:, 0].numpy()
    files = tuple(listing.files[row] for row in rows)
    listing = Listing(listing.kind, files, listing.light[keep], listing.view[keep])
    return listing, _take(store, rows)


def _take(store: PixelStore, rows: np.ndarray) -> PixelStore:
    """Pick rows of a store. The codes are copied into memory: a chosen part of a BTF is what one works on at hand."""
    fields: dict[str, Any] = {field.name: getattr(store, field.name) for field in dataclasses.fields(store)}
    fields = {name: None if value is None else value[rows] for name, value in fields.items()}
    return PixelStore(**fields)
