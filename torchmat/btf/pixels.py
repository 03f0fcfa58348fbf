"""From image files to the codes and flags of a store: crop, shrink, flag what is clipped or missing, in threads."""

from __future__ import annotations

import os
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from torchmat.btf.decode import Decoder, resolve_encoding
from torchmat.btf.listing import Listing, is_image
from torchmat.btf.reader import Pixels
from torchmat.btf.source import File, Folder, Zip
from torchmat.btf.store import CLIPPED, INVALID, release
from torchmat.btf.unfinished import Journal, Row, runs_of
from torchmat.channels import rgb_of_xyz
from torchmat.errors import DataError, ShapeError, message
from torchmat.icc import read_profile
from torchmat.images import read_picture, read_tags
from torchmat.machine import give_back
from torchmat.progress import progress

CHUNK = 64  # images that one thread decodes in a go; smaller tasks spend their time in hand-over
_FILES_BYTES = 2**21  # of them, where each comes by itself: what takes long shows its progress picture by picture
_SMALL_BYTES = 1 << 16  # of an image: more threads than one would wait for each other, half as long again for thousands in a zip
_CHUNK_BYTES = 2**28  # of them, where a container may give all of a go at once


@dataclass(frozen=True)
class PixelOptions:
    """What changes the stored pixels, and so belongs to the name of a store.

    `crop` is (top, left, height, width) in texels; `downscale` a whole factor, averaged in linear light; `by_profile`
    whether colour profiles are followed; `invalid` says whether NaN or Inf is an "error" or gets weight 0 ("mask").
    """

    crop: tuple[int, int, int, int] | None = None
    downscale: int = 1
    invalid: str = "error"
    encoding: str = "auto"
    by_profile: bool = True


def split_channels(pixels: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Return colours [3, H, W], grey three times over, and alpha [H, W] or None, of pixels [H, W, C]."""
    channels = pixels.shape[2]
    if channels > 4:
        step = "Save grey or RGB, with alpha or without."
        raise ShapeError(message(where, "the image", "have 1 to 4 channels", f"it has {channels}", step))
    colours = channels - (channels in (2, 4))  # a second or fourth channel is alpha
    codes = pixels[..., :colours].transpose(2, 0, 1)
    codes = np.repeat(codes, 3, axis=0) if colours == 1 else codes
    return codes, pixels[..., colours] if colours < channels else None


def _planes(turned: np.ndarray, place: np.ndarray | None) -> np.ndarray:
    """Return colours [3, H, W] as planes that lie one behind the other, channel by channel: in an eighth of the time of one copy.

    They lie in `place` where it has their shape and type.
    """
    fits = place is not None and place.shape == turned.shape and place.dtype == turned.dtype
    planes = place if place is not None and fits else np.empty(turned.shape, turned.dtype)
    for plane, channel in zip(planes, turned, strict=True):
        plane[...] = channel
    return planes


class Normaliser:
    """Brings the `window` (rows, columns) of a decoded image to codes [3, H, W] and flags [H, W]; `xyz` to RGB."""

    def __init__(self, images: Pixels, options: PixelOptions, where: str) -> None:
        shape, dtype = images.shape, images.dtype
        self.options = options
        self.xyz = images.xyz or options.encoding == "xyz"
        encoding = "linear" if self.xyz else resolve_encoding(options.encoding, dtype)
        self.decoder = Decoder(dtype, encoding, 1.0)
        height, width, channels = shape
        nothing, _ = split_channels(np.empty((0, 0, channels), dtype), where)
        if self.xyz:
            rgb_of_xyz(where, nothing)  # refused before anything is read
        self.window = self._window(height, width, where)
        rows, columns = (axis.stop - axis.start for axis in self.window)
        factor = options.downscale
        if not 1 <= factor <= min(rows, columns):
            fact = f"it is {factor} for {rows} x {columns} texels"
            step = "Use a smaller factor, 1 for none."
            raise ShapeError(message(where, "downscale", "be a whole number that leaves a texel", fact, step))
        self.out_shape = (3, rows // factor, columns // factor)
        self.out_dtype = np.dtype(np.float32) if factor > 1 else dtype

    def _window(self, height: int, width: int, where: str) -> tuple[slice, slice]:
        if self.options.crop is None:
            return slice(0, height), slice(0, width)
        top, left, rows, columns = self.options.crop
        if top < 0 or left < 0 or rows < 1 or columns < 1 or top + rows > height or left + columns > width:
            fact = f"it is {self.options.crop} (top, left, height, width) for {height} x {width}"
            raise ShapeError(message(where, "crop", "lie inside the images", fact, "Move it or make it smaller."))
        return slice(top, top + rows), slice(left, left + columns)

    def __call__(self, pixels: np.ndarray, where: str, place: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return codes and flags of an image; the codes lie in `place`, contiguous, where it has their shape and type."""
        codes, alpha = split_channels(pixels, where)
        # As planes of their own before anything is asked: numpy goes through a turned view ten times as slowly.
        codes = _planes(codes, place)
        flags = np.zeros(codes.shape[1:], dtype=np.uint8)
        if self.decoder.full_code is not None:
            brightest = np.maximum(np.maximum(codes[0], codes[1]), codes[2])
            np.multiply(brightest == self.decoder.full_code, np.uint8(CLIPPED), out=flags)
        if alpha is not None:
            # Turned round, so that an alpha of NaN counts as none.
            flags[~(alpha >= (0.5 if self.decoder.full_code is None else self.decoder.full_code / 2))] = INVALID
        if self.decoder.full_code is None:
            codes = self._finite(rgb_of_xyz(where, codes) if self.xyz else codes, flags, where)
        return self._shrink(codes, flags) if self.options.downscale > 1 else (codes, flags)

    def _finite(self, codes: np.ndarray, flags: np.ndarray, where: str) -> np.ndarray:
        bad = ~np.isfinite(codes).all(axis=0)
        if not bad.any():
            return codes
        unmarked = bad & (flags != INVALID)  # what alpha already leaves out may hold anything
        if self.options.invalid == "error" and unmarked.any():
            row, column = np.argwhere(unmarked)[0] + [axis.start for axis in self.window]
            fact = f"{int(unmarked.sum())} texels are NaN or Inf, first at row {row}, column {column}"
            step = "Repair the image, or pass invalid='mask' (--invalid mask) to give those texels no weight."
            raise DataError(message(where, "the image", "be finite", fact, step))
        flags[bad] = INVALID
        return np.where(bad, np.zeros((), dtype=codes.dtype), codes)

    def _shrink(self, codes: np.ndarray, flags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        factor = self.options.downscale
        _, rows, columns = self.out_shape
        trimmed = np.ascontiguousarray(codes[:, : rows * factor, : columns * factor])
        linear = self.decoder.into(trimmed, torch.empty(trimmed.shape)).numpy()
        mean = linear.reshape(3, rows, factor, columns, factor).mean(axis=(2, 4))
        worst = flags[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor).max(axis=(1, 3))
        return mean, worst


def read_pixels(source: Folder | Zip, name: str) -> tuple[np.ndarray, bool]:
    """Return the pixels [H, W, C] of one file of `source`, and whether they are XYZ; an error names the file."""
    with source.file(name) as path:
        try:
            return read_picture(path, source.by_profile)
        except DataError as error:
            # A file from a zip is opened under a scratch name, which would mean nothing to the reader.
            raise DataError(str(error).replace(str(path), f"{source.path}: {name}")) from error


def has_profile(source: File | Folder | Zip) -> bool:
    """Tell whether the first picture of a source has a colour profile."""
    name = None if isinstance(source, File) else next(filter(is_image, source.names), None)
    if isinstance(source, File) or name is None:
        return False
    try:
        with source.file(name) as path:
            return bool(read_tags(path).profile)
    except DataError:
        return False  # said with more words when it is decoded


def tag_notes(source: File | Folder | Zip, listing: Listing) -> list[str]:
    """Return notes on what the first image says of its colours and its orientation, where that changes what is read."""
    name = listing.files[0]
    if isinstance(source, File) or name not in source.names:
        return []
    try:
        with source.file(name) as path:
            tags = read_tags(path)
        profile = read_profile(f"{source.path}: {name}", tags.profile) if tags.profile else None
    except DataError:
        return []  # said with more words when it is decoded
    notes = ["images are turned upright, as their EXIF orientation says"] if tags.orientation != 1 else []
    if profile and not profile.is_srgb:
        done = "converted to sRGB" if source.by_profile else "taken as they are, since an encoding is given"
        notes.append(f"images have the colour profile {profile.name!r}; their colours are {done}")
    return notes


def images_of_files(source: Folder | Zip, listing: Listing) -> Pixels:
    """Return the pixels of image files, which must have one size, channel count and depth."""
    first, first_xyz = read_pixels(source, listing.files[0])

    def read(samples: range, rows: slice, columns: slice) -> Iterator[np.ndarray]:
        for sample in samples:
            name = listing.files[sample]
            pixels, xyz = read_pixels(source, name)
            if xyz != first_xyz:
                fact = f"its channels are {'X, Y, Z' if xyz else 'none of X, Y, Z'} and the first image's are not"
                step = "Bring all images to one colour space."
                raise DataError(message(f"{source.path}: {name}", "the image", "match the others", fact, step))
            if pixels.shape != first.shape or pixels.dtype != first.dtype:
                fact = f"it is {pixels.shape} {pixels.dtype}, the first image is {first.shape} {first.dtype}"
                step = "Bring all images to one size, channel count and bit depth."
                raise ShapeError(message(f"{source.path}: {name}", "the image", "match the others", fact, step))
            yield pixels[rows, columns]

    return Pixels(first.shape, first.dtype, read, parallel=True, xyz=first_xyz)


def checksum(codes: np.ndarray, flags: np.ndarray) -> int:
    """Return the CRC-32 of an image's codes [3, H, W] and flags [H, W]."""
    return zlib.crc32(np.ascontiguousarray(flags).data, zlib.crc32(np.ascontiguousarray(codes).data))


def decode_samples(
    images: Pixels, names: list[str], normalise: Normaliser, pixels: np.ndarray, flags: np.ndarray, show: bool | None,
    journal: Journal | None = None,
) -> dict[str, np.ndarray]:
    """Decode all samples in threads into `pixels` [n, 3, H, W] and `flags` [n, H, W]; return the store's other fields.

    `names` [n] is what errors call each sample. What the `journal` says is finished, and is there as it was written, is not
    decoded again; what becomes finished is written down in it.
    """
    count = len(names)
    stored = normalise.out_dtype
    types: dict[str, Any] = {"clipped": np.int64, "invalid": np.int64, "low": stored, "high": stored, "checksum": np.uint32}
    table: dict[str, np.ndarray] = {name: np.zeros(count, dtype=dtype) for name, dtype in types.items()}
    rows, columns = normalise.window
    size = (rows.stop - rows.start) * (columns.stop - columns.start) * images.shape[2] * images.dtype.itemsize
    chunk = max(1, min(CHUNK, (_FILES_BYTES if images.parallel else _CHUNK_BYTES) // size))
    one_at_a_time = threading.Lock()

    def taken(samples: range) -> Iterable[np.ndarray]:
        if images.parallel:
            return images.read(samples, rows, columns)
        with one_at_a_time:
            return list(images.read(samples, rows, columns))

    def finished(sample: int) -> bool:
        known = None if journal is None else journal.finished(sample)
        if known is None or known["checksum"] != checksum(pixels[sample], flags[sample]):
            return False
        for name in types:
            table[name][sample] = known[name]
        return True

    def decode(samples: range) -> None:
        for sample, image in zip(samples, taken(samples), strict=True):
            place = np.asarray(pixels[sample])
            codes, marks = normalise(image, names[sample], place)
            if codes is not place:
                pixels[sample] = codes
            marked = bool(marks.any())
            if marked or (journal is not None and journal.begun):  # untouched rows of the flag file stay holes that take no space
                flags[sample] = marks
            if marked:
                table["clipped"][sample], table["invalid"][sample] = (np.count_nonzero(marks == kind) for kind in (CLIPPED, INVALID))
            table["low"][sample], table["high"][sample] = codes.min(), codes.max()
            table["checksum"][sample] = checksum(codes, marks)
        if journal is not None:
            journal.add([_row_of(table, sample) for sample in samples])

    def work(first: int) -> None:
        samples = range(first, min(first + chunk, count))
        for run in runs_of([sample for sample in samples if not finished(sample)]):
            decode(run)
        release(pixels, samples)  # or a store that is larger than the memory would fill it as it is written
        release(flags, samples)

    _in_threads(work, range(0, count, chunk), show, 1 if size < _SMALL_BYTES else max(2, os.cpu_count() or 1))
    if chunk == 1:
        give_back()  # each thread's allocator keeps what large images took
    return table


def _row_of(table: dict[str, np.ndarray], sample: int) -> Row:
    return {"row": sample, **{name: column[sample].item() for name, column in table.items()}}


def _in_threads(work: Callable[[int], None], starts: range, show: bool | None, threads: int) -> None:
    """Run `work` for all `starts`; the first error in their order ends it, once what has begun is done."""
    with ThreadPoolExecutor(threads) as pool:
        try:
            for _ in progress(pool.map(work, starts), "decoding", total=len(starts), show=show):
                pass
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
