"""Reader: how one kind of measured data is told, listed and decoded; and the table of them, which others may add to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from torchmat.btf.listing import Listing
from torchmat.btf.source import File, Folder, Zip
from torchmat.errors import DataError, RangeError, TorchmatError, check_option, message

_MISSING: Any = None  # of what must be given, which is checked with an error that says so
DTYPES = ("uint8", "uint16", "float16", "float32", "float64")


def _nothing() -> None:
    pass


@dataclass(frozen=True)
class Pixels:
    """The images of an opened source, decoded when they are asked for.

    `shape` is (height, width, channels) of each, 1 to 4 channels (a second or fourth is alpha), `dtype` one of DTYPES:
    whole numbers are codes, sRGB unless the user says otherwise, floating-point values are linear light.
    ``read(samples, rows, columns)`` takes a range of samples and two slices of texels without a step, and gives
    [n, h, w, C], as an array or one image after another. `close` is called at the end. `parallel` says that several
    threads may read at once. `xyz` says that the values are CIE XYZ under D65, which become linear RGB.
    """

    shape: tuple[int, int, int]
    dtype: np.dtype
    read: Callable[[range, slice, slice], Iterable[np.ndarray]]
    close: Callable[[], None] = _nothing
    parallel: bool = False
    xyz: bool = False

    @classmethod
    def of(cls, images: Any, close: Callable[[], None] = _nothing) -> Pixels:
        """Return the pixels of `images` [sample, H, W, C]: an array, or what is sliced like one (a memory map, HDF5)."""

        def read(samples: range, rows: slice, columns: slice) -> np.ndarray:
            return np.asarray(images[samples.start : samples.stop, rows, columns])

        return cls(tuple(images.shape[1:]), np.dtype(images.dtype), read, close)


@dataclass(frozen=True)
class Reader:
    """One kind of measured data.

    What its functions raise comes to the user as an error that names the file and the reader; to refuse a file that is of
    the kind but cannot be read as its maker meant it, raise DataError with `torchmat.errors.message`. Where several kinds
    fit, the one that was registered first is taken.

    Args:
        name: what `load_btf` takes as `kind`.
        description: one line on what it reads.
        sniff: ``sniff(source)`` tells, without decoding anything, whether a source is of this kind: a Folder or a Zip, or
            with `one_file` a File, whose ``path`` is a file that holds everything.
        listing: ``listing(source)`` gives the samples with their directions.
        pixels: ``pixels(source, listing)`` gives their images, in that order.
        one_file: whether a source is a file of its own kind instead of a folder or a zip.
        version: goes up when the same file is read in another way: cached images are then decoded anew (0 is for the kinds
            that change with the cache's own format).

    Raises RangeError when a function is missing.
    """

    name: str
    description: str
    sniff: Callable[[Any], bool] = _MISSING
    listing: Callable[[Any], Listing] = _MISSING
    pixels: Callable[[Any, Listing], Pixels] = _MISSING
    one_file: bool = False
    version: int = 1

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.isidentifier():
            fact, step = f"it is {self.name!r}", "Letters, digits and _ do."
            raise RangeError(message("Reader", "name", "be a word", fact, step))
        wanted = {
            "sniff": "sniff(source) -> bool", "listing": "listing(source) -> Listing",
            "pixels": "pixels(source, listing) -> Pixels, or images_of_files for image files",
        }
        for part, call in wanted.items():
            if not callable(getattr(self, part)):
                fact = f"it is {getattr(self, part)!r}"
                raise RangeError(message(f"Reader {self.name}", part, "be a function", fact, f"Give {call}."))

    @contextmanager
    def at_work(self, source: File | Folder | Zip) -> Iterator[None]:
        """Turn whatever the reader's functions raise on `source` into a DataError that names both."""
        try:
            yield
        except (TorchmatError, MemoryError):
            raise
        except Exception as error:
            fact = f"{type(error).__name__}: {error}".rstrip(".: ")
            step = "Check that the file is complete and of that kind."
            text = message(str(source.path), f"the data, as the reader {self.name!r} takes it,", "be readable", fact, step)
            raise DataError(text) from error


READERS: dict[str, Reader] = {}


def register_reader(reader: Reader) -> Reader:
    """Add a kind of data to those that `load_btf` and all commands read; return the reader.

    Args:
        reader: the kind. The built-in ones come the same way.

    Raises RangeError when the name is taken, or the reader is none.
    """
    if not isinstance(reader, Reader):
        step = "Give Reader(name, description, sniff, listing, pixels)."
        raise RangeError(message("register_reader", "reader", "be a Reader", f"it is {type(reader).__name__}", step))
    if reader.name in READERS:
        step = "Give it another name."
        raise RangeError(message("register_reader", "the reader's name", "be new", f"{reader.name!r} is taken", step))
    READERS[reader.name] = reader
    return reader


def unregister_reader(name: str) -> None:
    """Take a kind of data out again, the counterpart of `register_reader`."""
    check_option("unregister_reader", "name", name, READERS)
    del READERS[name]
