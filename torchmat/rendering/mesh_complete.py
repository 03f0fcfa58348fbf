"""Mesh files that are cut short or broken where trimesh would go on with what it can read."""

from __future__ import annotations

import re
import struct

from torchmat.errors import DataError, message

CHECK_FILE = "Check that the file is complete and that its suffix tells its format."
_STL_HEAD, _STL_TRIANGLE = 84, 50  # bytes


def check_before(data: bytes, kind: str, where: str) -> None:
    """Raise DataError when the bytes of a file of `kind` (its suffix) contradict what their head or lines say."""
    if kind == "stl" and len(data) >= _STL_HEAD and b"\0" in data[:_STL_HEAD]:
        _check_length(data, _STL_HEAD + _STL_TRIANGLE * struct.unpack_from("<I", data, 80)[0], where)
    elif kind == "glb":
        if data[:4] != b"glTF" or len(data) < 20:
            raise DataError(message(where, "the mesh file", "start as a GLB does", "it does not", CHECK_FILE))
        _check_length(data, struct.unpack_from("<I", data, 8)[0], where)
    elif kind == "obj":
        # Indices count from 1; trimesh would take 0 for 1.
        zero = re.search(rb"^f[ \t][^\n]*(?<![^ \t/])0(?![^ \t/\r\n])", data, re.MULTILINE)
        if zero:
            line = data[: zero.start()].count(b"\n") + 1
            fact = f"line {line} has a 0"
            raise DataError(message(where, "indices of an OBJ", "count from 1", fact, "Export the mesh again."))
    elif kind == "ply":
        _check_ply_lines(data, where)


def check_after(data: bytes, kind: str, read: int, where: str) -> None:
    """Raise DataError when fewer triangles were `read` than the file has polygons."""
    said = 0
    if kind == "obj":
        said = len(re.findall(rb"^f[ \t]", data, re.MULTILINE))
    elif kind == "ply":
        said = _ply_counts(data).get("face", 0)
    if read < said:
        fact = f"{said - read} of {said} could not be read"
        raise DataError(message(where, "faces", "have at least three corners, all told alike", fact, CHECK_FILE))


def _check_length(data: bytes, expected: int, where: str) -> None:
    if len(data) < expected:
        fact = f"it has {len(data)} of the {expected} bytes that its head tells"
        raise DataError(message(where, "the mesh file", "be complete", fact, "Copy or export it again."))


def _ply_head(data: bytes) -> bytes:
    return data[: max(0, data.find(b"end_header"))]


def _ply_counts(data: bytes) -> dict[str, int]:
    found = re.findall(rb"^element[ \t]+(\w+)[ \t]+(\d+)", _ply_head(data), re.MULTILINE)
    return {name.decode(): int(count) for name, count in found}


def _check_ply_lines(data: bytes, where: str) -> None:
    head = _ply_head(data)
    if not re.search(rb"^format[ \t]+ascii", head, re.MULTILINE):
        return
    said = sum(_ply_counts(data).values())
    rows = len([line for line in data[len(head):].splitlines()[1:] if line.strip()])
    if rows < said:
        fact = f"it has {rows} of the {said} rows that its head tells"
        raise DataError(message(where, "the mesh file", "be complete", fact, "Copy or export it again."))
