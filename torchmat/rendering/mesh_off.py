"""OFF files of text: vertices, and polygons cut into triangles."""

from __future__ import annotations

import numpy as np

from torchmat.errors import DataError, message
from torchmat.rendering.polygons import triangulate
from torchmat.rendering.triangles import CHECK_FILE, Triangles, check_corners, of_vertices, short_file

# Colours stand behind the position and are passed over; normals and texture coordinates would need their own order.
_HEADS = ("OFF", "COFF")


def read_off(data: bytes, where: str) -> Triangles | None:
    """Return the triangles of an OFF's bytes; None when it has no faces. Raises DataError for what is cut or broken."""
    text = data.decode("utf-8", "replace").removeprefix("\ufeff")
    lines = [line for line in (line.split("#", 1)[0].split() for line in text.splitlines()) if line]
    if not lines or lines[0][0] not in _HEADS:
        fact = f"it starts with {lines[0][0][:20]!r}" if lines else "it is empty"
        raise DataError(message(where, "the mesh file", "start with OFF or COFF", fact, CHECK_FILE))
    lines[0] = lines[0][1:]
    lines = lines if lines[0] else lines[1:]
    counts = _whole(lines[0][:2] if lines else [], where, "the counts of an OFF")
    if len(counts) < 2 or min(counts) < 0:
        fact = "it does not"
        raise DataError(message(where, "the mesh file", "tell how many vertices and faces it has", fact, CHECK_FILE))
    vertices, faces = counts
    rows = lines[1:]
    if len(rows) < vertices + faces:
        raise short_file(where, f"{len(rows)} of the {vertices + faces} rows")
    if not faces:
        return None
    position = [_numbers(row[:3], where) for row in rows[:vertices]]
    corners, sizes = [], []
    for row in rows[vertices:vertices + faces]:
        size = _whole(row[:1], where, "the number of a face's corners")[0]
        found = _whole(row[1:1 + max(0, size)], where, "corners of faces")
        if size < 3 or len(found) < size:
            fact = f"one is {' '.join(row)[:60]!r}"
            raise DataError(message(where, "faces", "have at least three corners, as many as they tell", fact, CHECK_FILE))
        corners += found
        sizes.append(size)
    table, flat = np.array(position, dtype=np.float64).reshape(-1, 3), np.array(corners, dtype=np.float64).astype(np.int64)
    alike = len(set(sizes)) == 1
    check_corners(flat.reshape(-1, sizes[0]) if alike else flat[:, None], len(table), where)
    return of_vertices(table, flat[triangulate(table, flat, np.array(sizes))])


def _whole(words: list[str], where: str, what: str) -> list[int]:
    try:
        found = [int(word) for word in words]
    except ValueError as error:
        fact = f"they are {' '.join(words)[:60]!r}"
        raise DataError(message(where, what, "be whole numbers", fact, CHECK_FILE)) from error
    if any(abs(number) > 2**40 for number in found):
        raise DataError(message(where, what, "be fewer", f"they are {' '.join(words)[:60]!r}", CHECK_FILE))
    return found


def _numbers(words: list[str], where: str) -> list[float]:
    try:
        found = [float(word) for word in words]
    except ValueError as error:
        fact = f"they are {' '.join(words)[:60]!r}"
        raise DataError(message(where, "numbers of a vertex", "be numbers", fact, CHECK_FILE)) from error
    if len(found) < 3:
        raise DataError(message(where, "numbers of a vertex", "be three", f"they are {len(found)}", CHECK_FILE))
    return found
