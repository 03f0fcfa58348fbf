"""The container of glTF 2.0: a tree in JSON and one buffer, as the bytes of a GLB, and back within bounds."""

from __future__ import annotations

import json
import os
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from torchmat.errors import DataError, message
from torchmat.text_file import MOST_BYTES

SUFFIX = ".glb"
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_MOST = 2**32 - 1  # bytes that a GLB's head can count
_RESTORE = "Restore the file from the original."
_KINDS = {"float32": 5126, "uint16": 5123, "uint32": 5125}
_SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


@dataclass
class Buffer:
    """The one buffer of a GLB that is being made, with its views and accessors."""

    data: bytearray = field(default_factory=bytearray)
    views: list[dict[str, Any]] = field(default_factory=list)
    accessors: list[dict[str, Any]] = field(default_factory=list)

    def add_bytes(self, data: bytes, target: int | None = None) -> int:
        """Add bytes at a multiple of 4; return the number of their view."""
        self.data += b"\0" * (-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        self.views.append(view if target is None else {**view, "target": target})
        self.data += data
        return len(self.views) - 1

    def add_array(self, values: np.ndarray, target: int, bounds: bool = False) -> int:
        """Add an array [n] or [n, 2 to 4]; return the number of its accessor."""
        rows = values.reshape(len(values), -1)
        accessor = {
            "bufferView": self.add_bytes(np.ascontiguousarray(rows).tobytes(), target), "componentType": _KINDS[values.dtype.name],
            "count": len(rows), "type": _SHAPES[rows.shape[1]],
        }
        if bounds:
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def write_glb(path: Path, tree: dict[str, Any], buffer: Buffer) -> None:
    """Write a tree and its buffer as the GLB `path`; raises DataError where it would be larger than the format can be."""
    whole = {**tree, "bufferViews": buffer.views, "buffers": [{"byteLength": len(buffer.data)}]}
    if buffer.accessors:
        whole["accessors"] = buffer.accessors
    text = json.dumps(whole, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    data = bytes(buffer.data) + b"\0" * (-len(buffer.data) % 4)
    length = 12 + 8 + len(text) + 8 + len(data)
    if length > _MOST:
        step = "Export a part of it, or smaller maps, or depth=8."
        raise DataError(message(str(path), "the file", f"be at most {_MOST} bytes", f"it would be {length}", step))
    with open(path, "wb") as stream:
        stream.write(struct.pack("<4sII", b"glTF", 2, length))
        stream.write(struct.pack("<II", len(text), _JSON) + text)
        stream.write(struct.pack("<II", len(data), _BINARY) + data)


@dataclass(frozen=True)
class Glb:
    """A GLB that was read: the path, its tree, and its buffer."""

    path: Path
    tree: dict[str, Any]
    buffer: bytes

    def error(self, name: str, requirement: str, fact: str, step: str = _RESTORE) -> DataError:
        """Return an error about a part of the file."""
        return DataError(message(str(self.path), name, requirement, fact, step))

    def items(self, key: str) -> list[dict[str, Any]]:
        """Return a list of tables of the tree; none where it is absent."""
        found = self.tree.get(key, [])
        if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
            raise self.error(key, "be a list of objects", f"it is a {type(found).__name__}")
        return found

    def item(self, key: str, number: Any) -> dict[str, Any]:
        """Return one table of a list by its number."""
        found = self.items(key)
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(found):
            raise self.error(f"{key} {number!r:.40}", f"be one of {len(found)}", "it is not there")
        return found[number]

    def view_bytes(self, number: Any) -> bytes:
        """Return the bytes of a buffer view."""
        view = self.item("bufferViews", number)
        start, length = view.get("byteOffset", 0), view.get("byteLength")
        whole = all(isinstance(value, int) and not isinstance(value, bool) and value >= 0 for value in (start, length, view.get("buffer")))
        if not whole or view["buffer"] != 0 or start + length > len(self.buffer):
            raise self.error(f"bufferViews {number}", f"lie within the buffer of {len(self.buffer)} bytes", "it does not")
        return self.buffer[start : start + length]


def read_glb(path: str | Path) -> Glb:
    """Return the tree and the buffer of a GLB; no more is read than its head says.

    Raises DataError, which names the file, when it is none or is cut short.
    """
    path = Path(path)
    try:
        with open(path, "rb") as stream:
            text, buffer = _chunks(path, stream, os.fstat(stream.fileno()).st_size)
    except (OSError, ValueError, MemoryError) as error:
        if isinstance(error, DataError):
            raise
        fact = "it does not fit into memory" if isinstance(error, MemoryError) else str(error)
        raise DataError(message(str(path), "the GLB", "be readable", fact, "Check the path.")) from error
    return Glb(path, _tree(path, text), buffer)


def _chunks(path: Path, stream: BinaryIO, size: int) -> tuple[bytes, bytes]:
    """Return the bytes of the tree and of the buffer."""
    head = stream.read(12)
    if len(head) < 12 or head[:4] != b"glTF":
        raise DataError(message(str(path), "the GLB", "start as one does", "it does not", "Export it as glTF binary (.glb)."))
    version, length = struct.unpack_from("<II", head, 4)
    if version != 2 or length > size:
        fact = f"it is of version {version}" if version != 2 else f"it has {size} of {length} bytes"
        raise DataError(message(str(path), "the GLB", "be a whole glTF 2.0", fact, "Export it again as glTF 2.0."))
    place, found = 12, {}
    for kind, most in ((_JSON, MOST_BYTES), (_BINARY, _MOST)):
        start = stream.read(8) if place + 8 <= length else b""
        count, said = struct.unpack("<II", start) if len(start) == 8 else (0, 0)
        if kind == _JSON and (said != _JSON or count > most):
            raise DataError(message(str(path), "the first chunk of the GLB", "be JSON", "it is not", _RESTORE))
        if place + 8 + count > length and len(start) == 8:
            fact = f"the one at byte {place} is longer"
            raise DataError(message(str(path), "chunks of the GLB", "lie inside of it", fact, _RESTORE))
        found[kind] = stream.read(count) if said == kind else b""
        place += 8 + count
    return found[_JSON], found[_BINARY]


def _tree(path: Path, text: bytes) -> dict[str, Any]:
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError) as error:
        fact = f"{type(error).__name__}: {error}"
        raise DataError(message(str(path), "the GLB", "hold glTF's JSON", fact, _RESTORE)) from error
    if not isinstance(tree, dict):
        raise DataError(message(str(path), "the GLB", "hold glTF's JSON", f"it holds a {type(tree).__name__}", _RESTORE))
    return tree
