"""The store that a BTF is decoded into once: a folder with raw codes, mapped into memory afterwards.

It lies in a cache folder of its own, never beside the user's files, and is remade when they change. A pass over all
images then reads one file in order, and a BTF larger than the memory is no special case.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from torchmat import atomic
from torchmat.btf.btf import CLIPPED, INVALID, PixelStore
from torchmat.btf.decode import Decoder, resolve_encoding
from torchmat.btf.readers import Listing
from torchmat.btf.source import Folder, Zip
from torchmat.errors import DataError, ShapeError, message
from torchmat.images import read_image
from torchmat.progress import progress

_FORMAT = 1
_HEADER, _TABLE, _PIXELS, _FLAGS = "header.json", "table.npz", "pixels.raw", "flags.raw"
_CHUNK = 64  # images that one thread decodes in a go; smaller tasks spend their time in hand-over
DEFAULT_LIMIT_GB = 20.0


@dataclass(frozen=True)
class PixelOptions:
    """What changes the stored pixels, and so belongs to the name of a store.

    `crop` is (top, left, height, width) in texels; `downscale` a whole factor, averaged in linear light; `invalid`
    says whether NaN or Inf is an "error" or gets weight 0 ("mask").
    """

    crop: tuple[int, int, int, int] | None = None
    downscale: int = 1
    invalid: str = "error"
    encoding: str = "auto"


def cache_folder(cache: bool | str | Path) -> Path | None:
    """Return the folder for stores: the given one, $TORCHMAT_CACHE, or the user's cache folder; None for False."""
    if cache is False:
        return None
    if cache is not True:
        return Path(cache)
    if "TORCHMAT_CACHE" in os.environ:
        return Path(os.environ["TORCHMAT_CACHE"])
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "torchmat"


def store_name(path: Path, options: object) -> str:
    """Return the folder name of the store for a source and the options that shape its pixels."""
    key = f"{_FORMAT}\0{path.resolve()}\0{options!r}"
    return hashlib.sha256(key.encode("utf-8", "surrogateescape")).hexdigest()[:24]


class _Normaliser:
    """Brings one decoded file to codes [3, H, W] and flags [H, W], and refuses what does not fit the others."""

    def __init__(self, first: np.ndarray, options: PixelOptions, where: str) -> None:
        self.shape, self.dtype = first.shape, first.dtype
        self.options = options
        self.decoder = Decoder(first.dtype, resolve_encoding(options.encoding, first.dtype), 1.0)
        height, width = first.shape[:2]
        self.window = self._window(height, width, where)
        rows, columns = (axis.stop - axis.start for axis in self.window)
        factor = options.downscale
        if not 1 <= factor <= min(rows, columns):
            fact = f"it is {factor} for {rows} x {columns} texels"
            raise ShapeError(message(where, "downscale", "be a whole number that leaves a texel", fact))
        self.out_shape = (3, rows // factor, columns // factor)
        self.out_dtype = np.dtype(np.float32) if factor > 1 else first.dtype

    def _window(self, height: int, width: int, where: str) -> tuple[slice, slice]:
        if self.options.crop is None:
            return slice(0, height), slice(0, width)
        top, left, rows, columns = self.options.crop
        if top < 0 or left < 0 or rows < 1 or columns < 1 or top + rows > height or left + columns > width:
            fact = f"it is {self.options.crop} (top, left, height, width) for {height} x {width}"
            raise ShapeError(message(where, "crop", "lie inside the images", fact))
        return slice(top, top + rows), slice(left, left + columns)

    def __call__(self, pixels: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray]:
        if pixels.shape != self.shape or pixels.dtype != self.dtype:
            fact = f"it is {pixels.shape} {pixels.dtype}, the first image is {self.shape} {self.dtype}"
            step = "Bring all images to one size, channel count and bit depth."
            raise ShapeError(message(where, "the image", "match the others", fact, step))
        pixels = pixels[self.window]
        colours = pixels.shape[2] - (pixels.shape[2] in (2, 4))  # a second or fourth channel is alpha
        codes = pixels[..., :colours].transpose(2, 0, 1)
        codes = np.repeat(codes, 3, axis=0) if colours == 1 else codes[:3]
        flags = np.zeros(codes.shape[1:], dtype=np.uint8)
        if self.decoder.full_code is not None:
            flags[(codes == self.decoder.full_code).any(axis=0)] = CLIPPED
        else:
            codes = self._finite(codes, flags, where)
        if colours < pixels.shape[2]:
            alpha = pixels[..., colours]
            flags[alpha < (0.5 if self.decoder.full_code is None else self.decoder.full_code / 2)] = INVALID
        return self._shrink(codes, flags) if self.options.downscale > 1 else (codes, flags)

    def _finite(self, codes: np.ndarray, flags: np.ndarray, where: str) -> np.ndarray:
        bad = ~np.isfinite(codes).all(axis=0)
        if not bad.any():
            return codes
        if self.options.invalid == "error":
            row, column = np.argwhere(bad)[0]
            fact = f"{int(bad.sum())} texels are NaN or Inf, first at row {row}, column {column}"
            step = "Repair the image, or pass invalid='mask' to give those texels no weight."
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


def _decode(source: Folder | Zip, listing: Listing, folder: Path, options: PixelOptions, show: bool | None) -> None:
    """Decode every file of `listing` into raw files below `folder`, in parallel threads."""

    def read(name: str) -> np.ndarray:
        with source.file(name) as path:
            try:
                return read_image(path)
            except DataError as error:
                # A file from a zip is opened under a scratch name, which would mean nothing to the reader.
                raise DataError(str(error).replace(str(path), f"{source.path}: {name}")) from error

    normalise = _Normaliser(read(listing.files[0]), options, f"{source.path}: {listing.files[0]}")
    count = len(listing.files)
    size = count * int(np.prod(normalise.out_shape)) * normalise.out_dtype.itemsize
    _require_space(folder, size)
    pixels = np.memmap(folder / _PIXELS, normalise.out_dtype, "w+", shape=(count, *normalise.out_shape))
    flags = np.memmap(folder / _FLAGS, np.uint8, "w+", shape=(count, *normalise.out_shape[1:]))
    table = {name: np.zeros(count, dtype=np.int64) for name in ("clipped", "invalid")}
    table |= {name: np.zeros(count, dtype=normalise.out_dtype) for name in ("low", "high")}

    def work(first: int) -> int:
        names = listing.files[first : first + _CHUNK]
        for row, name in enumerate(names, first):
            codes, marks = normalise(read(name), f"{source.path}: {name}")
            pixels[row] = codes
            if marks.any():  # untouched rows of the flag file stay holes that take no space
                flags[row] = marks
            table["clipped"][row], table["invalid"][row] = (marks == CLIPPED).sum(), (marks == INVALID).sum()
            table["low"][row], table["high"][row] = codes.min(), codes.max()
        return len(names)

    with ThreadPoolExecutor(max(2, os.cpu_count() or 1)) as pool:
        starts = range(0, count, _CHUNK)
        try:
            for _ in progress(pool.map(work, starts), "decoding", total=len(starts), show=show):
                pass
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    files = np.array(listing.files)
    np.savez(folder / _TABLE, light=listing.light.numpy(), view=listing.view.numpy(), files=files, **table)
    header = {
        "format": _FORMAT, "fingerprint": source.fingerprint, "kind": listing.kind, "source": str(source.path),
        "shape": [count, *normalise.out_shape], "dtype": normalise.out_dtype.name,
        "linear": options.downscale > 1, "flagged": bool(table["clipped"].any() or table["invalid"].any()),
    }
    (folder / _HEADER).write_text(json.dumps(header))


def _require_space(folder: Path, size: int) -> None:
    free = shutil.disk_usage(folder).free
    # Writing through a map onto a full disk ends the process with a signal, so the room is asked for first.
    if size * 4 // 3 > free:
        fact = f"{size / 1e9:.2f} GB are needed and {free / 1e9:.2f} GB are free"
        step = "Free some space, move the cache (--cache DIR, TORCHMAT_CACHE), or use crop or downscale."
        raise DataError(message(str(folder.parent), "the cache folder", "have room for the decoded BTF", fact, step))


@dataclass(frozen=True)
class OpenStore:
    """A store that is ready for use, with what the listing said about it."""

    store: PixelStore
    listing: Listing
    linear: bool
    from_cache: bool


def _open(folder: Path) -> OpenStore:
    header = json.loads((folder / _HEADER).read_text())
    shape, dtype = tuple(header["shape"]), np.dtype(header["dtype"])
    with np.load(folder / _TABLE, allow_pickle=False) as table:
        arrays = {name: table[name] for name in table.files}
    # Copy-on-write rather than read-only: torch refuses to wrap memory that it may not write to.
    pixels = np.memmap(folder / _PIXELS, dtype, "c", shape=shape)
    flags = np.memmap(folder / _FLAGS, np.uint8, "c", shape=(shape[0], *shape[2:])) if header["flagged"] else None
    store = PixelStore(pixels, flags, arrays["clipped"], arrays["invalid"], arrays["low"], arrays["high"])
    light, view = torch.from_numpy(arrays["light"]), torch.from_numpy(arrays["view"])
    return OpenStore(store, Listing(header["kind"], tuple(arrays["files"].tolist()), light, view), header["linear"], True)


def _usable(folder: Path, fingerprint: str) -> OpenStore | None:
    """Open the store in `folder` if it is whole and of this source; a damaged one counts as absent."""
    try:
        header = json.loads((folder / _HEADER).read_text())
        if header["format"] != _FORMAT or header["fingerprint"] != fingerprint:
            return None
        expected = int(np.prod(header["shape"])) * np.dtype(header["dtype"]).itemsize
        if (folder / _PIXELS).stat().st_size != expected:
            return None
        opened = _open(folder)
        os.utime(folder)
        return opened
    except (OSError, ValueError, KeyError, TypeError, EOFError):
        return None


def _prune(root: Path, keep: Path) -> None:
    """Remove the stores used longest ago until the rest is below the limit ($TORCHMAT_CACHE_GB, 20 GB)."""
    limit = float(os.environ.get("TORCHMAT_CACHE_GB", DEFAULT_LIMIT_GB)) * 1e9
    stores = [path for path in root.iterdir() if (path / _HEADER).is_file()]
    sizes = {path: sum(f.stat().st_blocks * 512 for f in path.iterdir()) for path in stores}
    total = sum(sizes.values())
    for path in sorted(stores, key=lambda p: p.stat().st_mtime):
        if total > limit and path != keep:
            shutil.rmtree(path, ignore_errors=True)
            total -= sizes[path]


def open_store(
    source: Folder | Zip, list_files: Callable[[], Listing], key: object, options: PixelOptions,
    cache: bool | str | Path, show: bool | None,
) -> OpenStore:
    """Return the decoded store of `source`, from the cache when it holds one that is up to date.

    `list_files` is called only when the store has to be made; `key` is whatever else, beside `options`, decides
    what it holds. Without a cache the store is an unnamed temporary file that ends with the process.
    """
    root = cache_folder(cache)
    if root is None:
        folder = Path(tempfile.mkdtemp(prefix="torchmat-store-"))
        try:
            _decode(source, list_files(), folder, options, show)
            opened = _open(folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)  # the maps stay valid until they are let go
        return OpenStore(opened.store, opened.listing, opened.linear, False)
    target = root / store_name(source.path, (key, options))
    found = _usable(target, source.fingerprint)
    if found is not None:
        return found
    listing = list_files()
    with atomic.building(target, durable=False) as folder:
        _decode(source, listing, folder, options, show)
    _prune(root, target)
    opened = _open(target)
    return OpenStore(opened.store, opened.listing, opened.linear, False)
