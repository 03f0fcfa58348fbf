"""The kinds of data that come with the package, registered; which of them a path is; and its samples, checked."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat.btf.brdf_file import BRDF
from torchmat.btf.foreign import told, told_of_all
from torchmat.btf.hdf5 import NEURALBTF
from torchmat.btf.light_table import parse_intensities
from torchmat.btf.listing import Listing, is_image
from torchmat.btf.lit import KIND
from torchmat.btf.lp import RTI
from torchmat.btf.manifest import MANIFEST
from torchmat.btf.names import UBO2003, UTIA
from torchmat.btf.packed import packed_file
from torchmat.btf.standing import Standing
from torchmat.btf.reader import DTYPES, READERS, Pixels, Reader, register_reader
from torchmat.btf.source import File, Folder, Zip
from torchmat.btf.stereo import STEREO
from torchmat.btf.ubo2014 import UBO2014
from torchmat.errors import DataError, message

_UNIT_TOLERANCE = 1e-3
_ROUNDED = 0.01  # what rounding to two decimals may do to a length
_VARYING = 1.05  # lengths that differ more are those of positions
_OF_SAMPLES = ("intensity", "light_position", "view_position")

for _reader in (MANIFEST, RTI, UBO2003, UTIA, STEREO, BRDF, UBO2014, NEURALBTF):
    register_reader(_reader)


def open_source(path: str | Path, kind: str | None = None) -> File | Folder | Zip:
    """Open a folder, a zip, or a file that a reader takes for everything; raises DataError, naming the path, for others.

    `kind` names a reader; None asks all those of single files.
    """
    path = Path(path)
    one_file = kind is not None and READERS[kind].one_file
    if os.path.isdir(path):  # pathlib raises where a name is too long
        if one_file:
            fact, step = "it is a folder", "Give the file itself, or leave `kind` out."
            raise DataError(message(str(path), "the path", f"be a file for kind {kind!r}", fact, step))
        return Folder(path)
    if not os.path.exists(path):
        raise DataError(message(str(path), "the path", "exist", "there is nothing", "Check the spelling."))
    if not os.path.isfile(path):
        step = "Give the folder or the zip itself."
        raise DataError(message(str(path), "the path", "be a folder or a zip", "it is a device or a pipe", step))
    asked = [reader for reader in READERS.values() if reader.one_file and kind in (None, reader.name)]
    if asked:
        file = File(path)
        inner = packed_file(path)
        if (one_file and inner is None) or any(_takes(reader, file) for reader in asked):
            return file
        if inner is not None and any(_takes(reader, inner) for reader in asked):
            return inner
        if one_file:
            return file
    if path.suffix.lower() == ".zip" or zipfile.is_zipfile(path):
        return Zip(path)
    if path.suffix.lower() in (".csv", ".lp", ".dome"):
        step = f"Give its folder instead: {path.parent}."
        raise DataError(message(str(path), "the path", "be a folder or a zip", "it is a file", step))
    foreign = told(path.name)
    if foreign is not None:
        raise DataError(message(str(path), "the path", "be photographs with their lights", f"it is {foreign[0]}", foreign[1]))
    wanted, step = "be a folder or a zip", "Give the folder or the zip that holds the images and their directions."
    if asked:
        wanted += f", or a file of kind {', '.join(reader.name for reader in asked)}"
    raise DataError(message(str(path), "the path", wanted, "it is neither", step))


def _takes(reader: Reader, source: File | Folder | Zip) -> bool:
    with reader.at_work(source):
        return bool(reader.sniff(source))


def find_reader(source: File | Folder | Zip) -> Reader:
    """Return the first reader that fits `source`; raises DataError when none does."""
    one_file = isinstance(source, File)
    for reader in READERS.values():
        if reader.one_file == one_file and _takes(reader, source):
            return reader
    names = [PurePosixPath(name).name.lower() for name in source.names]
    images = sum(map(is_image, source.names))
    fact = f"there are {len(names)} files, {images} of them images"
    columns = "file, light_polar_deg, light_azimuth_deg, view_polar_deg, view_azimuth_deg"
    step = f"Add a manifest.csv with the columns {columns}."
    foreign = told_of_all(source.names)
    if foreign is not None:
        fact, step = f"there are {images} images, and {foreign[0]}", foreign[1]
    elif images > 2:
        step += " For photographs under one view, give their lights: --lights TABLE, or --ball FOLDER --circle COLUMN ROW RADIUS."
    raise DataError(message(str(source.path), "the data", "tell its directions", fact, step))


def reading_key(source: File | Folder | Zip, kind: str | None) -> tuple[object, ...]:
    """Return what a cached store must agree in: the kind that is asked for, and versions of readers that may come up."""
    if kind is None and isinstance(source, File):
        kind = find_reader(source).name
    asked = [READERS[kind]] if kind else [reader for reader in READERS.values() if not reader.one_file]
    return (kind, *((reader.name, reader.version) for reader in asked if reader.version))


def read_listing(
    source: File | Folder | Zip, kind: str | None, duplicates: str, normalise: bool, skip_bad_lights: bool = False,
    lister: Callable[[Folder | Zip], Listing] | None = None, intensities: tuple[str, str] | None = None,
    standing: Standing = Standing(),
) -> Listing:
    """Return the samples of a source with unit directions, checked; errors name the file.

    `skip_bad_lights` leaves out, and counts in the notes, what would else be refused: lights below the surface or without
    a direction, and lines whose photograph is not there. `lister` reads photographs with a table that lies elsewhere, in
    place of the reader of `kind`; `intensities` are the name and the text of a file of the lights' intensities; `standing`
    says where near lights stand.
    """
    reader = READERS[KIND] if lister else READERS[kind] if kind else find_reader(source)
    with reader.at_work(source):
        listing = _by_lister(source, lister) if lister else reader.listing(source)
    listing = standing.of(str(source.path), _well_formed(source, reader, listing))
    if listing.faults and not skip_bad_lights:
        raise DataError(listing.faults[0])
    if intensities:
        intensity = parse_intensities(*intensities, len(listing.files)).expand(-1, 3)
        listing = replace(listing, intensity=intensity, notes=(*listing.notes, f"intensities are those of {intensities[0]}"))
    notes = [f"{len(listing.faults)} lines of the table are skipped, first: {listing.faults[0]}"] if listing.faults else []
    if skip_bad_lights:
        listing, skipped = _without_bad_lights(source, listing)
        notes += skipped
    light, light_notes = _unit(source, listing, "light", normalise)
    view, view_notes = _unit(source, listing, "view", normalise)
    listing = replace(listing, light=light, view=view, notes=(*listing.notes, *notes, *light_notes, *view_notes), faults=())
    _refuse_below(source, listing)
    if duplicates == "error":
        _refuse_duplicates(source, listing)
    return listing


def _by_lister(source: File | Folder | Zip, lister: Callable[[Folder | Zip], Listing]) -> Listing:
    if isinstance(source, File):
        fact, step = "it is one file of a kind of its own", "It has its lights already."
        raise DataError(message(str(source.path), "what lights are given for", "be a folder or zip of photographs", fact, step))
    return lister(source)


def keep_samples(listing: Listing, keep: Tensor) -> Listing:
    """Return a listing of the samples that `keep`, bool [n], marks."""
    files = tuple(file for file, kept in zip(listing.files, keep.tolist(), strict=True) if kept)
    some: dict[str, Any] = {name: None if (part := getattr(listing, name)) is None else part[keep] for name in _OF_SAMPLES}
    return replace(listing, files=files, light=listing.light[keep], view=listing.view[keep], **some)


def _without_bad_lights(source: File | Folder | Zip, listing: Listing) -> tuple[Listing, list[str]]:
    length = listing.light.norm(dim=1)
    bad = ~torch.isfinite(length) | (length == 0) | (listing.light[:, 2] < -1e-9 * length)
    if not bool(bad.any()):
        return listing, []
    if bool(bad.all()):
        fact, step = f"all {len(bad)} are not", "Check the sign of z: it points away from the surface."
        raise DataError(message(str(source.path), "lights", "lie above the surface", fact, step))
    first = listing.files[int(bad.nonzero()[0, 0])]
    note = f"{int(bad.sum())} of {len(bad)} photographs are skipped, whose lights are below the surface, first {first}"
    return keep_samples(listing, ~bad), [note]


def _well_formed(source: File | Folder | Zip, reader: Reader, listing: Listing) -> Listing:
    """Return what a reader listed, under its own name and in float64; raise DataError when it does not fit together."""
    where = f"{source.path}: the reader {reader.name!r}"
    if not isinstance(listing, Listing):
        raise DataError(message(where, "its listing", "be a Listing", f"it is {type(listing).__name__}"))
    count = len(listing.files)
    light, view = (torch.as_tensor(directions, dtype=torch.float64) for directions in (listing.light, listing.view))
    if not count or light.shape != (count, 3) or view.shape != (count, 3):
        fact = f"it has {count} names, light {tuple(light.shape)} and view {tuple(view.shape)}"
        raise DataError(message(where, "its listing", "hold a name, a light and a view [n, 3] for each sample", fact))
    intensity = None if listing.intensity is None else torch.as_tensor(listing.intensity, dtype=torch.float64)
    if intensity is not None and (intensity.shape != (count, 3) or not bool((torch.isfinite(intensity) & (intensity > 0)).all())):
        fact = f"they are {tuple(intensity.shape)}, the least {float(intensity.min()) if intensity.numel() else 0:g}"
        raise DataError(message(where, "its intensities", f"be [{count}, 3] and positive", fact))
    near: dict[str, Any] = {name: getattr(listing, name) for name in ("light_position", "view_position")}
    near = {name: None if one is None else torch.as_tensor(one, dtype=torch.float64) for name, one in near.items()}
    if any(one is not None and one.shape != (count, 3) for one in near.values()):
        raise DataError(message(where, "its positions", f"be [{count}, 3]", "they are not"))
    light, view = (given if one is None else one for given, one in zip((light, view), near.values(), strict=True))
    found = replace(listing, kind=reader.name, files=tuple(listing.files), light=light, view=view, intensity=intensity)
    return replace(found, **near)


@contextmanager
def open_pixels(source: File | Folder | Zip, listing: Listing) -> Iterator[Pixels]:
    """Open the images of what was listed; raises DataError where its reader does not say what images are like."""
    reader = READERS[listing.kind]
    with reader.at_work(source):
        opened = reader.pixels(source, listing)
    where = f"{source.path}: the reader {reader.name!r}"
    if not isinstance(opened, Pixels):
        raise DataError(message(where, "its pixels", "be Pixels", f"they are {type(opened).__name__}"))
    try:
        dtype = np.dtype(opened.dtype)
        if len(opened.shape) != 3 or 0 in opened.shape or dtype.name not in DTYPES or not dtype.isnative:
            fact = f"they are {tuple(opened.shape)} of {dtype}"
            requirement = f"be images (height, width, channels) of {', '.join(DTYPES)}"
            raise DataError(message(where, "its pixels", requirement, fact))
        yield replace(opened, read=_checked(where, reader, source, opened))
    finally:
        opened.close()


def _checked(where: str, reader: Reader, source: File | Folder | Zip, opened: Pixels):
    """Return `read` of opened pixels, which gives what it promised or raises DataError."""

    def read(samples: range, rows: slice, columns: slice) -> Iterator[np.ndarray]:
        wanted = (rows.stop - rows.start, columns.stop - columns.start, opened.shape[2])
        count = 0
        with reader.at_work(source):
            images = iter(opened.read(samples, rows, columns))
        while True:
            with reader.at_work(source):
                image = next(images, None)
            if image is None:
                break
            count += 1
            if count > len(samples) or getattr(image, "shape", None) != wanted or image.dtype != opened.dtype:
                fact = f"image {count} is {getattr(image, 'shape', None)} of {getattr(image, 'dtype', None)}"
                requirement = f"be {len(samples)} images {wanted} of {opened.dtype}"
                raise DataError(message(where, "what it reads", requirement, fact))
            yield image
        if count != len(samples):
            fact = f"{count} came"
            raise DataError(message(where, "what it reads", f"be {len(samples)} images {wanted}", fact))

    return read


def _unit(source: File | Folder | Zip, listing: Listing, which: str, normalise: bool) -> tuple[Tensor, list[str]]:
    """Return directions of length 1, and notes on those that were brought to it."""
    directions: Tensor = getattr(listing, which)
    near = getattr(listing, f"{which}_position") is not None
    largest = directions.abs().amax(dim=1, keepdim=True)  # or squares of positions far away would leave the range of numbers
    length = (directions / largest).nan_to_num(0.0, 0.0, 0.0).norm(dim=1, keepdim=True) * largest
    none = (largest == 0) | ~torch.isfinite(largest)
    bad = none if normalise or near else none | ((length - 1).abs() > _ROUNDED)
    if bool(bad.any()):
        first = int(bad[:, 0].nonzero()[0, 0])
        fact = f"{int(bad.sum())} of {len(bad)} are not, first of length {float(length[first, 0]):.6g}"
        step = "Divide each by its length, or pass normalise=True (--normalise) if they are positions of far lights"
        step += "; of near ones give the sample's width in their unit, near=WIDTH (--near WIDTH)." if which == "light" else "."
        if bool(none[first]):
            step = "It says nothing about a direction; correct or remove it."
            step += " skip_bad_lights=True (--skip-bad-lights) leaves it out." if which == "light" else ""
        where = f"{source.path}: {listing.files[first]}"
        raise DataError(message(where, f"the {which} direction", "be a unit vector", fact, step))
    notes = [] if near else _length_notes(which, length)
    usual = (length > 1e-150) & (length < 1e150)
    scaled = torch.where(usual, directions, directions / largest)
    return scaled / scaled.norm(dim=1, keepdim=True), notes


def _length_notes(which: str, length: Tensor) -> list[str]:
    """Return notes on vectors [n, 3] of `length` [n, 1] that are brought to length 1; none where they had it."""
    off = int(((length - 1).abs() > _UNIT_TOLERANCE).sum())
    if not off:
        return []
    least, most = float(length.min()), float(length.max())
    said = f"{off} of {len(length)} {which} directions were brought to length 1; they were {least:.4g} to {most:.4g} long"
    if which != "light" or bool(((length - 1).abs() <= _ROUNDED).all()):
        return [said]
    step = "If they are positions of near lights, give the sample's width in their unit: near=WIDTH (--near WIDTH)"
    if most <= _VARYING * least:
        return [f"warning: {said}. {step}"]
    return [said, "warning: the lights look like positions; they are taken for directions of far lights, which is wrong near the "
            f"edge of a surface that is not small beside its distance to them. {step}"]


def _refuse_below(source: File | Folder | Zip, listing: Listing) -> None:
    for which in ("light", "view"):
        directions: Tensor = getattr(listing, which)
        # A light exactly on the horizon is legal (its images are black); rounding may put cos(90 deg) at 6e-17.
        below = directions[:, 2] < -1e-9 if which == "light" else directions[:, 2] <= 1e-9
        if bool(below.any()):
            first = int(below.nonzero()[0, 0])
            x, y, z = directions[first].tolist()
            fact = f"{int(below.sum())} of {len(below)} do not, first is ({x:.4g}, {y:.4g}, {z:.4g})"
            where = f"{source.path}: {listing.files[first]}"
            step = "z points away from the surface; remove the image or correct the sign."
            step += " skip_bad_lights=True (--skip-bad-lights) leaves those out." if which == "light" else ""
            raise DataError(message(where, f"the {which} direction", "lie above the surface", fact, step))


def _refuse_duplicates(source: File | Folder | Zip, listing: Listing) -> None:
    seen: dict[tuple[float, ...], str] = {}
    known = [part for part in (listing.light, listing.view, listing.light_position, listing.view_position) if part is not None]
    keys = torch.round(torch.cat(known, dim=1), decimals=5) + 0.0
    for file, key in zip(listing.files, map(tuple, keys.tolist()), strict=True):
        if key in seen:
            where, fact = f"{source.path}: {file}", f"it has those of {seen[key]}"
            step = "Remove one of the two, or pass duplicates='keep' (--duplicates keep) if both were measured."
            raise DataError(message(where, "the directions", "differ from every other's", fact, step))
        seen[key] = file
