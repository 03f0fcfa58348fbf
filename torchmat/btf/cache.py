"""The store that a BTF is decoded into once: a folder with raw codes, mapped into memory afterwards.

It lies in a cache folder of its own, never beside the user's files, and is remade when they change. A pass over all
images then reads one file in order, and a BTF larger than the memory is no special case.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import math
import os
import re
import shutil
import tempfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchmat import atomic
from torchmat.btf.listing import Listing
from torchmat.btf.pixels import Normaliser, PixelOptions, checksum, decode_samples, images_of_files
from torchmat.btf.reader import READERS
from torchmat.btf.readers import open_pixels
from torchmat.btf.source import File, Folder, Zip
from torchmat.btf.store import PixelStore
from torchmat.btf.unfinished import Journal, at_work, bytes_there, is_unfinished, mapped, remove_abandoned, scratch, sweep, unfinished_name
from torchmat.cache_place import cache_place
from torchmat.errors import DataError, RangeError, message, notice
from torchmat.text_file import read_text

_FORMAT = 6
_HEADER, _TABLE, _PIXELS, _FLAGS = "header.json", "table.npz", "pixels.raw", "flags.raw"
_STORE_NAME = re.compile("[0-9a-f]{24}")
_SPOT_BYTES = 8_000_000  # of a cached store are held against its table; more would be felt on each load
_ATTEMPTS = 3
DEFAULT_LIMIT_GB = 20.0


def cache_folder(cache: bool | str | Path) -> Path | None:
    """Return the folder for stores: the given one, $TORCHMAT_CACHE, or the user's cache folder; None for False."""
    if cache is False:
        return None
    if cache is not True:
        return Path(cache)
    return cache_place()


def _limit_bytes() -> float:
    text = os.environ.get("TORCHMAT_CACHE_GB") or str(DEFAULT_LIMIT_GB)
    try:
        limit = float(text)
    except ValueError:
        limit = math.nan
    if not limit >= 0:
        step = "Set it to the number of gigabytes that decoded BTFs may take."
        raise RangeError(message("the environment", "TORCHMAT_CACHE_GB", "be a number >= 0", f"it is {text!r}", step))
    return limit * 1e9


def store_name(path: Path, options: object) -> str:
    """Return the folder name of the store for a source and the options that shape its pixels."""
    key = f"{_FORMAT}\0{path.resolve()}\0{options!r}"
    return hashlib.sha256(key.encode("utf-8", "surrogateescape")).hexdigest()[:24]


def _write(
    source: File | Folder | Zip, listing: Listing, folder: Path, options: PixelOptions, show: bool | None, making: Path | None = None
) -> None:
    """Decode every sample of `listing` into a store in `folder`; `making` is where codes are written, and go on from what is there."""
    names = [f"{source.path}: {name}" for name in listing.files]
    with open_pixels(source, listing) as images:
        normalise = Normaliser(images, options, names[0])
        shape, dtype = (len(names), *normalise.out_shape), normalise.out_dtype
        journal = None
        if making is not None:
            about = [listing.kind, listing.files, shape, dtype.name, images.shape, images.dtype.name, normalise.xyz]
            journal = Journal(making, about, _marks_of(source, listing))
        begun, place = journal is not None and journal.begun, folder if making is None else making
        there = bytes_there(place / _PIXELS) if begun else 0
        _require_space(folder, max(0, math.prod(shape) * dtype.itemsize - there))
        pixels = mapped(place / _PIXELS, dtype, shape, begun)
        flags = mapped(place / _FLAGS, np.dtype(np.uint8), (shape[0], *shape[2:]), begun)
        table = decode_samples(images, names, normalise, pixels, flags, show, journal)
    columns: dict[str, Any] = {"light": listing.light.numpy(), "view": listing.view.numpy(), **table}
    if listing.intensity is not None:
        columns["intensity"] = listing.intensity.numpy()
    positions = {"light_position": listing.light_position, "view_position": listing.view_position}
    columns |= {name: one.numpy() for name, one in positions.items() if one is not None}
    np.savez(folder / _TABLE, files=np.array(listing.files), **columns)
    header = {
        "format": _FORMAT, "fingerprint": source.fingerprint, "kind": listing.kind, "source": str(source.path),
        "shape": shape, "dtype": normalise.out_dtype.name, "table": zlib.crc32((folder / _TABLE).read_bytes()),
        "linear": options.downscale > 1 or normalise.xyz, "xyz": normalise.xyz,
        "flagged": bool(table["clipped"].any() or table["invalid"].any()), "notes": listing.notes,
        "picture": images.shape[:2], "falloff": listing.falloff,
    }
    (folder / _HEADER).write_text(json.dumps({**header, "checksum": _checksum_of(header)}))
    if making is not None:
        for name in (_PIXELS, _FLAGS):
            os.replace(making / name, folder / name)


def _marks_of(source: File | Folder | Zip, listing: Listing) -> list[str]:
    """Return what changes with the file of each sample, and with anything where a reader takes a sample from who knows what."""
    if isinstance(source, File) or READERS[listing.kind].pixels is not images_of_files:
        return [source.fingerprint] * len(listing.files)
    return [source.mark(name) for name in listing.files]


def _checksum_of(header: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(header).encode())


def _require_space(folder: Path, size: int) -> None:
    free = shutil.disk_usage(folder).free
    # Writing through a map onto a full disk ends the process with a signal, so the room is asked for first.
    if size * 4 // 3 > free:
        fact = f"{size / 1e9:.2f} GB are needed and {free / 1e9:.2f} GB are free"
        step = "Free some space, move the cache (--cache DIR, TORCHMAT_CACHE), or use crop or downscale."
        raise atomic.Unwritable(message(str(folder.parent), "the cache folder", "have room for the decoded BTF", fact, step))


@dataclass(frozen=True)
class OpenStore:
    """A store that is ready for use, with what the listing said about it; `picture` is the images' size before crop and shrinking."""

    store: PixelStore
    listing: Listing
    linear: bool
    xyz: bool
    from_cache: bool
    picture: tuple[int, int]


def _open(folder: Path, fingerprint: str) -> OpenStore | None:
    """Map the store in `folder`; return None when it is of another source, of another format or not whole."""
    header = json.loads(read_text(folder / _HEADER))
    if header.pop("checksum") != _checksum_of(header):
        return None
    if header["format"] != _FORMAT or header["fingerprint"] != fingerprint:
        return None
    shape, dtype = tuple(header["shape"]), np.dtype(header["dtype"])
    if (folder / _PIXELS).stat().st_size != math.prod(shape) * dtype.itemsize:
        return None
    if not (folder / _TABLE).is_file():  # a device has no end
        return None
    data = (folder / _TABLE).read_bytes()
    if zlib.crc32(data) != header["table"]:
        return None
    with np.load(io.BytesIO(data), allow_pickle=False) as table:
        arrays = {name: table[name] for name in table.files}
    # Copy-on-write rather than read-only: torch refuses to wrap memory that it may not write to.
    pixels = np.memmap(folder / _PIXELS, dtype, "c", shape=shape)
    flags = np.memmap(folder / _FLAGS, np.uint8, "c", shape=(shape[0], *shape[2:])) if header["flagged"] else None
    found = {name: arrays[name] for name in ("clipped", "invalid", "low", "high")}
    store = PixelStore(pixels, flags, **found, checksums=arrays["checksum"])
    if any(len(array) != shape[0] for array in arrays.values()) or not _matches_table(store, arrays["checksum"]):
        return None
    light, view = torch.from_numpy(arrays["light"]), torch.from_numpy(arrays["view"])
    intensity = torch.from_numpy(arrays["intensity"]) if "intensity" in arrays else None
    light_at, view_at = (
        torch.from_numpy(arrays[name]) if name in arrays else None for name in ("light_position", "view_position")
    )
    listing = Listing(
        header["kind"], tuple(arrays["files"].tolist()), light, view, intensity, tuple(header["notes"]),
        light_position=light_at, view_position=view_at, falloff=header["falloff"],
    )
    return OpenStore(store, listing, header["linear"], header["xyz"], True, (header["picture"][0], header["picture"][1]))


def _matches_table(store: PixelStore, checksums: np.ndarray) -> bool:
    """Compare a few images with the table: pages that a power cut lost read as zeros."""
    count = max(1, min(16, len(store.pixels), _SPOT_BYTES // store.pixels[0].nbytes))
    rows = np.linspace(len(store.pixels) - 1, 0, count).astype(int)
    clear = np.zeros(store.pixels.shape[2:], np.uint8)
    flags = [clear if store.flags is None else store.flags[row] for row in rows]
    return all(checksum(store.pixels[row], marks) == checksums[row] for row, marks in zip(rows, flags, strict=True))


def _usable(folder: Path, fingerprint: str) -> OpenStore | None:
    """Open the store in `folder` if it is whole and of this source; a damaged one counts as absent."""
    try:
        opened = _open(folder, fingerprint)
    except Exception:  # whatever the damage, the store can be made again; a real trouble shows up then
        return None
    with suppress(OSError):  # a cache that may only be read is a cache all the same
        os.utime(folder)
    return opened


def _size_on_disk(folder: Path) -> int:
    return sum(map(bytes_there, folder.iterdir()))


def _prune(root: Path, keep: Path, limit: float) -> None:
    """Remove the stores used longest ago until the rest is below `limit` bytes. Only what is a store, or began as one, is touched."""
    stores = []
    for path in root.iterdir():
        with suppress(OSError):  # another process may be pruning too
            if is_unfinished(path) or (_STORE_NAME.fullmatch(path.name) and (path / _HEADER).is_file()):
                stores.append((path.stat().st_mtime_ns, path, _size_on_disk(path)))
    total = sum(size for _, _, size in stores)
    for _, path, size in sorted(stores):
        if total > limit and path != keep:
            remove_abandoned(path) if is_unfinished(path) else shutil.rmtree(path, ignore_errors=True)
            total -= size


def _make_uncached(
    source: File | Folder | Zip, listing: Listing, options: PixelOptions, show: bool | None
) -> OpenStore | None:
    place = tempfile.gettempdir()
    try:
        with scratch(Path(place), "torchmat-store-") as folder:
            try:
                _write(source, listing, folder, options, show)
                return _open(folder, source.fingerprint)  # the maps stay valid until they are let go
            except OSError as error:
                step = "Free some space there or set TMPDIR to another folder."
                raise DataError(message(str(folder), "the temporary store", "be written whole", str(error), step)) from error
    except OSError as error:
        step = "Set TMPDIR to a folder that can be written to."
        raise DataError(message(place, "the folder", "be writable", str(error), step)) from error


def _make(
    source: File | Folder | Zip, listing: Listing, target: Path, options: PixelOptions, show: bool | None
) -> OpenStore | None:
    """Make the store `target` and open it; return None when something removed it in between."""
    limit, unfinished = _limit_bytes(), unfinished_name(target)
    try:
        with atomic.building(target, durable=False) as folder, at_work(unfinished) as making:
            sweep(target.parent, unfinished, limit)
            _write(source, listing, folder, options, show, making)
    except DataError:
        # Two may make one store at a time; whoever comes second then finds a whole one in its place.
        found = _usable(target, source.fingerprint)
        if found is None:
            raise
        return found
    with suppress(OSError):
        _prune(target.parent, target, limit)
    return _usable(target, source.fingerprint)


def _reason(error: Exception) -> str:
    return str(error.__cause__ or error).rstrip(".")


def open_store(
    source: File | Folder | Zip, list_files: Callable[[], Listing], key: object, options: PixelOptions,
    cache: bool | str | Path, show: bool | None,
) -> OpenStore:
    """Return the decoded store of `source`, from the cache when it holds one that is up to date.

    `list_files` is called only when the store has to be made; `key` is whatever else, beside `options`, decides
    what it holds. Without a cache the store is an unnamed temporary file that ends with the process: so too, with a
    `Notice`, where the cache cannot be written.
    """
    root = cache_folder(cache)
    target = None if root is None else root / store_name(source.path, (key, options))
    found = None if target is None else _usable(target, source.fingerprint)
    if found is not None:
        return found
    listing = list_files()
    for _ in range(_ATTEMPTS):
        if target is None:
            made = _make_uncached(source, listing, options, show)
        else:
            try:
                made = _make(source, listing, target, options, show)
            except atomic.Unwritable as error:
                notice(str(root), f"decoded images are not kept, since the cache cannot be written ({_reason(error)})")
                target = made = None
        if made is not None:
            return dataclasses.replace(made, from_cache=False)
    step = "Raise TORCHMAT_CACHE_GB if it makes processes remove each other's stores, or choose another folder."
    raise DataError(message(str(target), "the store", "stay until it is opened", "it was gone or damaged", step))
