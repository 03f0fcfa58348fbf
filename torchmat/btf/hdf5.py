"""NeuralBTF's HDF5: far-field images with x and y of a light and a view each, read slice by slice from the file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat.btf.listing import Listing
from torchmat.btf.reader import DTYPES, Pixels, Reader
from torchmat.btf.source import File
from torchmat.errors import DataError, message

MAGIC = b"\x89HDF\r\n\x1a\n"
LIGHT, VIEW, COLOUR = "ground_light", "ground_camera_dir", "ground_color"
_NAMES = (LIGHT, VIEW, COLOUR)
_MOST_NAMES = 12  # of what a file holds instead are told
_MOST_SAMPLES = 1 << 24
_LARGEST_CHUNK = 1 << 30  # bytes that a slice of one texel may have to unpack


def _sniff(source: File) -> bool:
    return source.start(len(MAGIC)) == MAGIC


@contextmanager
def _opened(source: File) -> Iterator[Any]:
    """Open the file; raises DataError where h5py is not there or the file is damaged."""
    file = _open(source)
    try:
        yield file
    finally:
        file.close()


def _open(source: File) -> Any:
    try:
        import h5py
    except ImportError as error:
        fact, step = "h5py is not installed", "pip install 'torchmat[hdf5]'"
        raise DataError(message(str(source.path), "an HDF5 file", "have h5py to be read with", fact, step)) from error
    try:
        return h5py.File(source.content, "r")
    except OSError as error:
        step = "Check that the download or copy is complete."
        raise DataError(message(str(source.path), "the HDF5 file", "be readable", str(error), step)) from error


def _data(source: File, file: Any) -> dict[str, Any]:
    """Return the three data sets, of the shapes that they must have."""
    import h5py

    where = f"{source.path}: NeuralBTF (HDF5)"
    # A link may lead to another file, whose bytes this one must not show.
    found = {name: file.get(name, getlink=True) for name in _NAMES}
    own = [name for name, link in found.items() if isinstance(link, h5py.HardLink) and isinstance(file[name], h5py.Dataset)]
    missing = [name for name in _NAMES if name not in own]
    if missing:
        there = list(file)[:_MOST_NAMES]
        fact = f"{', '.join(missing)} is not there; it holds {', '.join(map(repr, there)) or 'nothing'}"
        step = "Write it so, or register a reader of its own (tm.register_reader)."
        raise DataError(message(where, "the file", f"hold data sets {', '.join(_NAMES)}", fact, step))
    data = {name: file[name] for name in _NAMES}
    _check_shapes(where, data)
    for name, one in data.items():
        # Bytes of an external file are none of this one's.
        if one.external or one.is_virtual:
            step = "Copy it into the file (h5repack)."
            raise DataError(message(where, name, "lie in the file itself", "it is elsewhere", step))
    return data


def _check_shapes(where: str, data: dict[str, Any]) -> None:
    colour = data[COLOUR]
    for name, what in ((LIGHT, "light"), (VIEW, "view")):
        one = data[name]
        if one.ndim == 4 and one.shape[-1] == 2:
            fact = f"{name} is {one.shape}, a {what} for each texel: a near-field capture"
            step = "Rectify it to one light and one view an image, or fit a region so small that one direction will do."
            raise DataError(message(where, f"each image's {what}", "be one direction, (N, 2)", fact, step))
        if one.ndim != 2 or one.shape[1] != 2 or not len(one) or one.dtype.kind != "f" or len(one) > _MOST_SAMPLES:
            step = "It is x and y of a unit vector for each image."
            fact = f"it is {one.shape} of {one.dtype}"
            raise DataError(message(where, name, "be (N, 2) floating-point numbers", fact, step))
    floating = colour.dtype.kind == "f" and np.dtype(colour.dtype).name in DTYPES
    if colour.ndim != 4 or colour.shape[-1] != 3 or 0 in colour.shape or not floating:
        fact = f"it is {colour.shape} of {colour.dtype}"
        raise DataError(message(where, COLOUR, "be (N, H, W, 3), linear floating-point numbers", fact))
    counts = {name: len(one) for name, one in data.items()}
    if len(set(counts.values())) > 1:
        fact = f"there are {', '.join(f'{count} of {name}' for name, count in counts.items())}"
        raise DataError(message(where, "the data sets", "be of as many images", fact, "Write one direction an image."))


def _upward(source: File, which: str, values: np.ndarray) -> Tensor:
    """Return unit vectors [n, 3] of their x and y [n, 2]; z points away from the surface."""
    plane = torch.from_numpy(values.astype(np.float64))
    across = plane.square().sum(dim=1)
    bad = ~(across <= 1 + 1e-3)
    if bool(bad.any()):
        first = int(bad.nonzero()[0, 0])
        x, y = plane[first].tolist()
        fact = f"{int(bad.sum())} of {len(bad)} are not, first that of image {first}: ({x:.4g}, {y:.4g})"
        step = "They are x and y of a unit vector, no angles and no positions."
        raise DataError(message(f"{source.path}: NeuralBTF (HDF5)", which, "lie within the unit circle", fact, step))
    found = torch.cat([plane, (1 - across).clamp(min=0).sqrt()[:, None]], dim=1)
    return found / found.norm(dim=1, keepdim=True)


def _listing(source: File) -> Listing:
    with _opened(source) as file:
        data = _data(source, file)
        light, view = (_upward(source, name, data[name][()]) for name in (LIGHT, VIEW))
    return Listing("neuralbtf", tuple(f"image {number}" for number in range(len(light))), light, view)


def _pixels(source: File, listing: Listing) -> Pixels:
    file = _open(source)
    try:
        stored = _data(source, file)[COLOUR]
        images, dtype = _sliceable(source, file, stored), np.dtype(stored.dtype).newbyteorder("=")
    except BaseException:
        file.close()
        raise

    def read(samples: range, rows: slice, columns: slice) -> np.ndarray:
        return np.asarray(images[samples.start : samples.stop, rows, columns], dtype)

    return Pixels(tuple(stored.shape[1:]), dtype, read, file.close)


def _sliceable(source: File, file: Any, stored: Any) -> Any:
    """Return what is sliced like an array: a memory map where the numbers lie in one piece, else the data set itself."""
    if stored.chunks is not None and math.prod(stored.chunks) * stored.dtype.itemsize > _LARGEST_CHUNK:
        fact, step = f"they are {stored.chunks} of {stored.dtype}", "Write it in smaller ones (h5repack -l)."
        where = f"{source.path}: NeuralBTF (HDF5)"
        raise DataError(message(where, f"the chunks of {COLOUR}", "be of at most 1 GiB", fact, step))
    start = stored.id.get_offset()
    scattered = start is None or stored.chunks is not None or file.userblock_size
    if scattered or start + stored.nbytes > source.content.stat().st_size:
        return stored
    return np.memmap(source.content, stored.dtype, "r", start, stored.shape)


NEURALBTF = Reader(
    "neuralbtf", "NeuralBTF's HDF5 of far-field images (needs torchmat[hdf5])", _sniff, _listing, _pixels, one_file=True,
)
