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
from torch import Tensor

from torchmat.btf.btf import CLIPPED_WEIGHT, Btf, Source, unique_directions
from torchmat.btf.cache import open_store
from torchmat.btf.decode import ENCODINGS, Decoder, resolve_encoding
from torchmat.btf.lambert import with_estimated_intensities
from torchmat.btf.lighting import Lighting, by_ball, by_table, home_of
from torchmat.btf.listing import Listing
from torchmat.btf.object_mask import chosen_mask
from torchmat.btf.pixels import PixelOptions, has_profile, tag_notes
from torchmat.btf.reader import READERS
from torchmat.btf.readers import keep_samples, open_source, read_listing, reading_key
from torchmat.btf.source import File, Folder, Zip
from torchmat.btf.standing import Standing, near_of
from torchmat.btf.stereo import DIRECTIONS
from torchmat.btf.store import PixelStore
from torchmat.errors import RangeError, TorchmatError, check_option, check_positive, message
from torchmat.text_file import read_text

INVALID_WAYS, DUPLICATE_WAYS = ("error", "mask"), ("error", "keep")
ESTIMATE = "estimate"


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
    light_table: str | Path | None = None,
    ball: str | Path | None = None,
    circle: Sequence[float] | None = None,
    intensities: str | Path | None = None,
    skip_bad_lights: bool = False,
    near: float | None = None,
    distance: float | None = None,
    falloff: bool | None = None,
    clipped_weight: float = CLIPPED_WEIGHT,
    mask: str | Path | Tensor | np.ndarray | None = None,
    cache: bool | str | Path = True,
    progress: bool | None = None,
) -> Btf:
    """Load a measured BTF or RTI capture; values come out linear.

    Samples at the largest 8- or 16-bit code are clipped. Where images have alpha, what it covers less than half has
    weight 0.

    Args:
        path: a folder, a zip, or a file that a registered reader takes; the ``manifest.csv`` or ``light_directions.txt`` itself
            means its folder, an ``.lp`` or ``.dome`` file this one table, with photographs in its folder or else in the one above.
        kind: "ubo2003", "utia", "manifest", "rti", "stereo", "brdf", "ubo2014", "neuralbtf" or the name of another reader
            (`register_reader`); None finds it from the content.
        encoding: "srgb", "linear" or "xyz"; "auto" reads integer files as sRGB, floating-point files as linear, and EXR
            files with the channels X, Y, Z as CIE XYZ under D65. XYZ becomes linear Rec. 709 RGB.
        exposure: factor that the images were exposed with, above 0; values are divided by it.
        crop: (top, left, height, width) in texels; None is all.
        downscale: whole factor, at least 1, averaged in linear light; rows and columns left over are dropped.
        lights, views: numbers, in the order of ``btf.lights`` and ``btf.views``, of the directions to keep; None is all.
        invalid: what to do with NaN and Inf: "error", or "mask" for weight 0.
        duplicates: what to do with repeated directions: "error" or "keep".
        normalise: whether directions that are not unit are made so; else they are an error, unless rounding explains it.
        light_table: file of the lights of photographs under one view (`parse_lights` says in what forms), which then need no
            table of their own, or a dome of RelightLab (``.dome``, `parse_dome`); without names in it, photographs count in natural order (img2 before img10), or in that of a
            ``filenames.txt`` beside them. Its vectors may have any length.
        ball: folder of photographs of a chrome ball under the same lights, called alike or in the same order.
        circle: the ball's centre (column, row) and radius in pixels.
        intensities: file with the intensity of each light, one number or red, green and blue, by which values are divided;
            or "estimate", what makes a matte surface fit best (`estimate_intensities`). None takes those of the table.
        skip_bad_lights: whether to leave out lights below the surface or without a direction, and lines whose photograph is
            not there; else they are an error. How many is in ``btf.source.notes``.
        near: width of the pictured sample, in the unit of the vectors that the table of lights holds: they are then positions of
            near lights from the sample's centre (of the whole picture, whatever the crop), and each texel has a direction of
            its own. None takes lights for far, unless a manifest (`sample_width`) or a dome (`imageWidth`) says otherwise.
        distance: how far all lights are from the sample's centre, in the unit of `near`, where a table holds directions: the
            radius of a dome.
        falloff: whether the images darken with the distance to near lights, which is taken out; False of images that were
            normalised already. None is as a manifest says, else True.
        clipped_weight: what a clipped sample counts in a fit, 0 to 1.
        mask: which texels show the object; the others count nowhere. The path of a picture in the photographs' size (white is
            the object), bool [H, W] of the texels, "alpha" of the photographs, "background" for what is not dark in all of
            them from the border on, a guess, or "none". None is a ``mask.png`` beside the photographs or above them, else
            their alpha, where it leaves texels out of all of them.
        cache: folder for decoded images; True is the user's cache folder, or $TORCHMAT_CACHE, and False is none.
        progress: whether to show a bar; None shows it on a terminal.

    Raises DataError, ShapeError or RangeError, each naming the file.
    """
    start = time.perf_counter()
    check_option("load_btf", "encoding", encoding, ENCODINGS)
    check_option("load_btf", "invalid", invalid, INVALID_WAYS)
    check_option("load_btf", "duplicates", duplicates, DUPLICATE_WAYS)
    check_positive("load_btf", "exposure", exposure, "It divides all values; 1 leaves them.")
    path, kind, lighting = _lighting(Path(path), kind, light_table, ball, circle)
    estimate = intensities == ESTIMATE
    given = None if intensities is None or estimate else read_text(intensities, "the intensities")
    normalise = normalise or light_table is not None or distance is not None
    standing = Standing(near, distance, falloff)
    standing.check()
    options = PixelOptions(
        crop=_crop(crop),
        downscale=_whole("downscale", downscale),
        invalid=invalid,
        # Without averaging the codes are stored as they are, but for XYZ, whose channels belong together.
        encoding=encoding if downscale > 1 or encoding == "xyz" else "auto",
    )
    if kind is not None:
        check_option("load_btf", "kind", kind, READERS)
    source = open_source(path, kind)
    source.by_profile = encoding == "auto" or not has_profile(source)
    options = dataclasses.replace(options, by_profile=source.by_profile)
    try:
        opened = open_store(
            source,
            lambda: _listed(
                source, kind, duplicates, normalise, skip_bad_lights, lighting, None if given is None else (str(intensities), given),
                standing,
            ),
            (*reading_key(source, kind), duplicates, normalise, skip_bad_lights, lighting and lighting.key, given, *standing.key), options,
            cache, progress,
        )
        listing, store = _select(opened.listing, opened.store, lights, views, str(path))
        stored = store.pixels.dtype
        decoder = Decoder(stored, "linear" if opened.linear else resolve_encoding(encoding, stored), float(exposure))
        seconds = time.perf_counter() - start
        origin = Source(listing.kind, str(path), listing.files, seconds, opened.from_cache, listing.notes, opened.xyz)
        intensity = None if listing.intensity is None else listing.intensity.float()
        placed = near_of(listing, opened.picture, options.crop, options.downscale)
        btf = Btf(store, listing.light.float(), listing.view.float(), decoder, origin, clipped_weight, intensity, near=placed)
        btf = chosen_mask(source, listing, btf, mask, options.crop, options.downscale)
    except TorchmatError as error:
        told = source.told(error) if isinstance(source, File) else error
        if told is error:
            raise
        raise told from error.__cause__
    finally:
        source.close()
    return with_estimated_intensities(btf) if estimate else btf


def _lighting(
    path: Path, kind: str | None, light_table: str | Path | None, ball: str | Path | None, circle: Sequence[float] | None
) -> tuple[Path, str | None, Lighting | None]:
    """Return the photographs' folder, their kind, and the lighting that is given beside them; None leaves it to a reader."""
    if ball is not None and light_table is not None:
        step = "Give the one that is right."
        raise RangeError(message(str(path), "the lights", "come from a table or from a ball", "both are given", step))
    if os.path.isfile(path):
        if path.name.lower() == "manifest.csv" or (path.suffix.lower() == ".csv" and light_table is None):
            path, kind = path.parent, kind or "manifest"
        elif path.name.lower() == DIRECTIONS:
            path, kind = path.parent, kind or "stereo"
        elif path.suffix.lower() in (".lp", ".dome"):
            home = home_of(path)
            if light_table is None and ball is None:
                return home, None, by_table(path, home)
            path = home
    if light_table is not None:
        return path, None, by_table(light_table)
    return path, kind, None if ball is None else by_ball(ball, circle)


def _listed(
    source: File | Folder | Zip, kind: str | None, duplicates: str, normalise: bool, skip_bad_lights: bool,
    lighting: Lighting | None, intensities: tuple[str, str] | None, standing: Standing,
) -> Listing:
    """Return the samples of a source, with the lighting and the (file, text) of intensities that are given beside it."""
    lister = None if lighting is None else lighting.lister
    listing = read_listing(source, kind, duplicates, normalise, skip_bad_lights, lister, intensities, standing)
    return dataclasses.replace(listing, notes=(*listing.notes, *tag_notes(source, listing)))


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
    return keep_samples(listing, keep), _take(store, rows)


def _take(store: PixelStore, rows: np.ndarray) -> PixelStore:
    """Pick rows of a store. The codes are copied into memory: a chosen part of a BTF is what one works on at hand."""
    fields: dict[str, Any] = {field.name: getattr(store, field.name) for field in dataclasses.fields(store)}
    fields = {name: None if value is None else value[rows] for name, value in fields.items()}
    return PixelStore(**fields)
