"""OBJ files: positions, texture coordinates, normals and polygons, by whole blocks of lines at once.

trimesh counts negative indices from the end of the file, knows the blank and no tab, and fans concave polygons; it
also makes vertices of corners, which are taken apart here as the file has them. So this is a reader of its own.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, field

import numpy as np

from torchmat.errors import DataError, message
from torchmat.rendering.polygons import triangulate
from torchmat.rendering.triangles import NONE, Triangles

BLOCK = 1 << 23  # bytes whose lines are read at once
_BLANKS = bytes.maketrans(b"\t\v\f\0", b"    ")
_MATERIAL = re.compile(rb"^[ \t]*usemtl[ \t]([^\n]*)", re.MULTILINE)
_TABLES = {b"v": ("vertex", 3), b"vt": ("texture coordinate", 2), b"vn": ("normal", 3)}
_EXPORT = "Export the mesh again."


@dataclass
class _Read:
    """What was read so far."""

    where: str
    lines: int = 0
    rows: dict[bytes, int] = field(default_factory=lambda: dict.fromkeys(_TABLES, 0))
    tables: dict[bytes, list[np.ndarray]] = field(default_factory=lambda: {key: [] for key in _TABLES})
    corners: list[np.ndarray] = field(default_factory=list)
    sizes: list[np.ndarray] = field(default_factory=list)
    face_lines: list[np.ndarray] = field(default_factory=list)


def read_obj(data: bytes, where: str) -> Triangles | None:
    """Return the triangles of an OBJ's bytes; None when it has no faces.

    Groups and materials become one mesh, colours and weights of vertices are passed over, and so are points, lines and
    free-form curves. Raises DataError, which names the line, for numbers that cannot be read, corners that are not
    there, and faces of fewer than three corners or of corners told in different ways.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        data = data.decode("utf-16", "replace").encode("utf-8", "replace")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    named = _MATERIAL.findall(data) if b"usemtl" in data else []
    materials = tuple(dict.fromkeys(name.strip().decode("utf-8", "replace") for name in named))
    read = _Read(where)
    start = 0
    while start < len(data):
        end = _block_end(data, start)
        _read_block(data[start:end].translate(_BLANKS), read)
        start = end
    if not read.sizes or not sum(map(len, read.sizes)):
        return None
    return _triangles(read, materials)


def _block_end(data: bytes, start: int) -> int:
    """Return where the line ends in which a block is full; a line that is continued is not at its end."""
    end = start + BLOCK
    while end < len(data):
        end = data.find(b"\n", end)
        if end < 0:
            break
        end += 1
        if not data[max(start, end - 80):end - 1].rstrip(b" \t").endswith(b"\\"):
            return end
    return len(data)


def _read_block(block: bytes, read: _Read) -> None:
    lines = block.count(b"\n")
    if b"#" in block:
        block = re.sub(rb"#[^\n]*", b"", block)
    if b"\\" in block:
        # The line ends are put behind the line that they were in, so that lines are counted right.
        block = _joined(block)
    text = np.frombuffer(block + b"\n\n\n", dtype=np.uint8)
    word = text > 32
    begins = np.flatnonzero(word[1:] & ~word[:-1]) + 1
    if len(text) and word[0]:
        begins = np.concatenate(([0], begins))
    ends = np.flatnonzero(text == 10)
    first = np.searchsorted(begins, np.concatenate(([0], ends[:-1])))
    words = np.diff(np.append(first, len(begins)))
    line = np.flatnonzero(words)  # those that are not empty
    first, words = first[line], words[line]
    key = begins[first]
    letters = [text[np.minimum(key + k, len(text) - 1)] for k in range(3)]
    blank = [letter <= 32 for letter in letters]
    kinds = {
        b"v": (letters[0] == 118) & blank[1], b"vt": (letters[0] == 118) & (letters[1] == 116) & blank[2],
        b"vn": (letters[0] == 118) & (letters[1] == 110) & blank[2], b"f": (letters[0] == 102) & blank[1],
    }
    stop = ends[line]
    for kind in _TABLES:
        chosen = kinds[kind]
        if chosen.any():
            content = _content(text, key[chosen] + len(kind), stop[chosen])
            rows = _rows(content, words[chosen] - 1, read.lines + line[chosen], kind, read.where)
            read.tables[kind].append(rows)
    if kinds[b"f"].any():
        chosen = kinds[b"f"]
        content = _content(text, key[chosen] + 1, stop[chosen])
        before = np.stack([read.rows[kind] + np.cumsum(kinds[kind])[chosen] for kind in _TABLES], axis=1)
        _read_faces(content, words[chosen] - 1, read.lines + line[chosen], before, read)
    for kind in _TABLES:
        read.rows[kind] += int(kinds[kind].sum())
    read.lines += lines


def _joined(block: bytes) -> bytes:
    """Return a block in which lines that end in a backslash go on, with the line ends they lose behind them."""
    pieces, lost = [], 0
    for line in block.split(b"\n"):
        content = line.rstrip(b" ")
        if content.endswith(b"\\"):
            pieces.append(content[:-1] + b" ")
            lost += 1
            continue
        pieces.append(line + b"\n" * (lost + 1))
        lost = 0
    return b"".join((*pieces, b"\n" * lost))[:-1]


def _content(text: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the bytes of stretches of a text, each with the line end behind it."""
    edges = np.zeros(len(text) + 1, dtype=np.int8)
    edges[begin] += 1
    edges[end + 1] -= 1
    return text[np.cumsum(edges[:-1], dtype=np.int8) > 0]


def _numbers(content: np.ndarray, kind: type, count: int) -> np.ndarray | None:
    """Return the `count` numbers that a text holds; None when it does not."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # of what is no number; NumPy would stop there
        try:
            found: np.ndarray = np.fromstring(content.tobytes(), dtype=kind, sep=" ")
        except (DeprecationWarning, ValueError):
            return None
    return found if len(found) == count else None


def _refuse(where: str, what: str, requirement: str, line: int, fact: str) -> DataError:
    return DataError(message(where, what, requirement, f"line {line + 1} {fact}", _EXPORT))


def _unreadable(content: np.ndarray, lines: np.ndarray, kind: type, where: str, what: str) -> DataError:
    """Return the error of the first of some lines that holds something else than numbers."""
    for line, text in zip(lines.tolist(), content.tobytes().split(b"\n"), strict=False):
        row = np.frombuffer(text.replace(b"/", b" ") if kind is np.int64 else text, dtype=np.uint8)
        if _numbers(row, kind, len(row.tobytes().split())) is None:
            fact = f"has {text.decode('utf-8', 'replace').strip()[:60]!r}"
            return _refuse(where, what, "be whole numbers" if kind is np.int64 else "be numbers", line, fact)
    return _refuse(where, what, "be numbers", int(lines[0]), "or one after it has something else")


def _rows(content: np.ndarray, counts: np.ndarray, lines: np.ndarray, kind: bytes, where: str) -> np.ndarray:
    """Return the numbers that count [rows, 3 or 2] of lines with `counts` numbers each."""
    what, wanted = _TABLES[kind]
    least = 1 if kind == b"vt" else wanted
    short = counts < least
    if short.any():
        one = int(np.flatnonzero(short)[0])
        need = {1: "one at least", 3: "three"}[least]
        fact = f"they are {int(counts[one])} in line {int(lines[one]) + 1}"
        raise DataError(message(where, f"numbers of a {what}", f"be {need}", fact, "Export the mesh with x, y and z."))
    flat = _numbers(content, np.float64, int(counts.sum()))
    if flat is None:
        raise _unreadable(content, lines, np.float64, where, f"what follows {kind.decode()}")
    if (counts == wanted).all():
        return flat.reshape(-1, wanted)
    begin = np.cumsum(counts) - counts
    rows = flat[np.minimum(begin[:, None] + np.arange(wanted), len(flat) - 1)]
    rows[np.arange(wanted) >= counts[:, None]] = 0  # a texture of one dimension
    return rows


def _read_faces(content: np.ndarray, counts: np.ndarray, lines: np.ndarray, before: np.ndarray, read: _Read) -> None:
    """Add the corners [n, (v, vt, vn)] of faces, as rows from 0 or NONE; `before` [faces, 3] rows stand before each."""
    where = read.where
    few = np.flatnonzero(counts < 3)
    if len(few):
        fact = f"has {int(counts[few[0]])}"
        raise _refuse(where, "faces", "have at least three corners", int(lines[few[0]]), fact)
    slash, word = content == 47, content > 32
    shifted = np.concatenate(([False], word[:-1]))
    opens = word & ~shifted
    after_slash = np.concatenate(([False], slash[:-1]))
    number = word & ~slash & (~shifted | after_slash)
    face = np.repeat(np.arange(len(counts)), counts)
    corner = np.cumsum(opens)[number] - 1
    slashes = np.cumsum(slash)
    column = slashes[number] - (slashes - slash)[opens][corner]
    parsed = _numbers(np.where(slash, 32, content).astype(np.uint8), np.int64, len(corner))
    if parsed is None:
        raise _unreadable(content, lines, np.int64, where, "corners of faces")
    at = lines[face]
    if len(column) and int(column.max()) > 2:
        first = int(at[corner[int((column > 2).argmax())]])
        raise _refuse(where, "corners of faces", "be vertex/texture/normal", first, "has a fourth number")
    if not parsed.all():
        first = int(at[corner[int((parsed == 0).argmax())]])
        raise _refuse(where, "indices of an OBJ", "count from 1", first, "has a 0")
    table = np.zeros((len(face), 3), dtype=np.int64)
    table[corner, column] = parsed
    if (parsed < 0).any():
        relative = table + before[face] + 1
        table = np.where(table < 0, np.where(relative > 0, relative, np.iinfo(np.int64).min), table)
    given = table != 0
    alike = given == given[np.cumsum(counts) - counts][face]
    if not (alike.all() and given[:, 0].all()):
        first = int(at[int((~alike.all(axis=1) | ~given[:, 0]).argmax())])
        raise _refuse(where, "corners of a face", "have a vertex each and be told alike", first, "has others")
    read.corners.append(np.where(given, table - 1, NONE))
    read.sizes.append(counts)
    read.face_lines.append(lines)


def _triangles(read: _Read, materials: tuple[str, ...]) -> Triangles:
    corners, sizes = np.concatenate(read.corners), np.concatenate(read.sizes)
    tables = {}
    for column, (kind, (what, width)) in enumerate(_TABLES.items()):
        tables[kind] = np.concatenate(read.tables[kind]) if read.tables[kind] else np.zeros((0, width))
        # What was relative and reached before the first row is far below NONE.
        bad = (corners[:, column] >= len(tables[kind])) | (corners[:, column] < NONE)
        if bad.any():
            face = int(np.searchsorted(np.cumsum(sizes), int(bad.argmax()), side="right"))
            fact = f"has one out of bounds: there are {len(tables[kind])}"
            line = int(np.concatenate(read.face_lines)[face])
            plural = "vertices" if kind == b"v" else f"{what}s"
            raise _refuse(read.where, f"corners of faces, their {plural},", "be in the file", line, fact)
    rows = triangulate(tables[b"v"], corners[:, 0], sizes)
    faces, uv_of, normal_of = (np.ascontiguousarray(corners[:, k])[rows] for k in range(3))
    return Triangles(tables[b"v"], faces, tables[b"vn"], normal_of, tables[b"vt"], uv_of, materials)
