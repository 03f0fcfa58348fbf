"""The container of the RGL database: named arrays of any type in one file, as Mitsuba's `TensorFile` defines it."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from torchmat.errors import DataError, message

MAGIC = b"tensor_file\0"
_VERSION = (1, 0)
# Numbers 1 to 11 of Mitsuba's Struct::Type.
_TYPES = dict(enumerate(("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"), start=1))
_MOST_DIMENSIONS = 8
_LEAST_FIELD_BYTES = 13  # of a nameless field without dimensions: lengths, type and offset
_STEP = "Download the file again, or copy it as binary."


@dataclass(frozen=True)
class Field:
    """Where an array lies in the file: NumPy `dtype`, byte `offset` and `shape`."""

    dtype: str
    offset: int
    shape: tuple[int, ...]

    @property
    def end(self) -> int:
        """The first byte behind the array."""
        return self.offset + math.prod(self.shape) * np.dtype(self.dtype).itemsize


class TensorFile:
    """The fields of a tensor file; an array is mapped when asked for, so that nothing is read in vain.

    Raises DataError, which names the file, unless every field lies inside the file as its head promises.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            with open(self.path, "rb") as stream:
                self._size = stream.seek(0, 2)
                stream.seek(0)
                self.fields = self._read_fields(stream)
        except OSError as error:
            step = "Check the path and that the file may be read."
            raise DataError(message(str(path), "the file", "be readable", str(error), step)) from error

    def _wrong(self, name: str, requirement: str, fact: str) -> DataError:
        return DataError(message(str(self.path), name, requirement, fact, _STEP))

    def _take(self, stream: BinaryIO, layout: str) -> tuple:
        size = struct.calcsize(layout)
        found = stream.read(size)
        if len(found) < size:
            fact = f"the file of {self._size} bytes ends inside it"
            raise self._wrong("the head", "be complete", fact)
        return struct.unpack(layout, found)

    def _read_fields(self, stream: BinaryIO) -> dict[str, Field]:
        magic, *version, count = self._take(stream, "<12sBBI")
        if magic != MAGIC:
            raise self._wrong("the file", f"begin with {MAGIC!r}", f"it begins with {magic!r}")
        if tuple(version) != _VERSION:
            raise self._wrong("the version", f"be {_VERSION}", f"it is {tuple(version)}")
        if count * _LEAST_FIELD_BYTES > self._size:
            fact = f"it promises {count} fields and the file has {self._size} bytes"
            raise self._wrong("the head", "promise what the file can hold", fact)
        fields: dict[str, Field] = {}
        for _ in range(count):
            name, field = self._read_field(stream)
            if name in fields:
                raise self._wrong(f"field {name!r}", "occur once", "it occurs twice")
            fields[name] = field
        return fields

    def _read_field(self, stream: BinaryIO) -> tuple[str, Field]:
        (length,) = self._take(stream, "<H")
        (raw,) = self._take(stream, f"<{length}s")
        name = raw.decode("utf-8", "backslashreplace")
        dimensions, kind, offset = self._take(stream, "<HBQ")
        if kind not in _TYPES:
            raise self._wrong(f"field {name!r}", f"have a type from 1 to {len(_TYPES)}", f"it is {kind}")
        if dimensions > _MOST_DIMENSIONS:
            raise self._wrong(f"field {name!r}", f"have at most {_MOST_DIMENSIONS} dimensions", f"it has {dimensions}")
        shape = self._take(stream, f"<{dimensions}Q")
        field = Field(_TYPES[kind], offset, shape)
        if 0 in shape:
            raise self._wrong(f"field {name!r}", "hold at least one number", f"its shape is {shape}")
        if field.end > self._size:
            fact = f"with shape {shape} at byte {offset} it ends at {field.end} of {self._size} bytes"
            raise self._wrong(f"field {name!r}", "lie inside the file", fact)
        return name, field

    def array(self, name: str) -> np.ndarray:
        """Return the array of a field as a read-only map of the file. Raises DataError when there is none."""
        if name not in self.fields:
            raise self._wrong(f"field {name!r}", "be there", f"the fields are {', '.join(self.fields) or 'none'}")
        field = self.fields[name]
        try:
            return np.memmap(self.path, field.dtype, "r", field.offset, field.shape)
        except (OSError, ValueError) as error:
            raise self._wrong(f"field {name!r}", "be readable", str(error)) from error
