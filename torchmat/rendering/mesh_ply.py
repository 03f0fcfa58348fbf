"""PLY files, of text or bytes of either order: vertices with what they hold, and polygons cut into triangles."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from torchmat.errors import DataError, message
from torchmat.rendering.polygons import triangulate
from torchmat.rendering.triangles import CHECK_FILE, NONE, Triangles, check_corners, short_file

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_UV = (("texture_u", "texture_v"), ("s", "t"), ("u", "v"), ("texture_s", "texture_t"))
_CORNERS = ("vertex_indices", "vertex_index")
_MOST_CORNERS = 1 << 20  # of one polygon


@dataclass
class _Element:
    """A part of the head: how many rows of which properties, (name, type, type of a list's length or "")."""

    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)

    @property
    def lists(self) -> list[str]:
        """The names of properties that are lists."""
        return [name for name, _, length in self.properties if length]


def read_ply(data: bytes, where: str) -> Triangles | None:
    """Return the triangles of a PLY's bytes; None when it has no faces.

    Texture coordinates may be the vertices' (s and t, u and v, texture_u and texture_v) or the corners' (a face's
    texcoord). Raises DataError for what is cut short or broken.
    """
    order, elements, start = _head(data, where)
    body = _Text(data[start:], where) if not order else _Bytes(data, start, order, where)
    rows: dict[str, dict[str, np.ndarray]] = {}
    for element in elements:
        found = body.read(element)
        if element.name in ("vertex", "face"):
            rows[element.name] = found
    vertex, face = rows.get("vertex", {}), rows.get("face", {})
    missing = [name for name in "xyz" if name not in vertex]
    if missing:
        fact = f"{', '.join(missing)} of them are not there"
        raise DataError(message(where, "numbers of a vertex", "be x, y and z", fact, "Export the mesh again."))
    key = next((name for name in _CORNERS if name in face), None)
    if key is None or not len(face[f"{key} sizes"]):
        return None
    return _triangles(vertex, face, key, where)


def _head(data: bytes, where: str) -> tuple[str, list[_Element], int]:
    """Return the order of bytes ("" for text), the elements, and where the head ends."""
    end = data.find(b"end_header")
    line_end = data.find(b"\n", end)
    if data[:3] != b"ply" or end < 0:
        raise DataError(message(where, "the mesh file", "start with a PLY's whole head", "it does not", CHECK_FILE))
    if line_end < 0:
        line_end = len(data)
    order, elements = None, []
    for line in data[:end].decode("latin-1").replace("\r", "\n").split("\n")[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        try:
            if words[0] == "format":
                order = _ORDERS[words[1]]
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2])))
            elif words[0] == "property" and words[1] == "list":
                elements[-1].properties.append((words[4], _TYPES[words[3]], _TYPES[words[2]]))
            elif words[0] == "property":
                elements[-1].properties.append((words[2], _TYPES[words[1]], ""))
            else:
                raise ValueError
        except (KeyError, IndexError, ValueError) as error:
            fact = f"one is {line.strip()[:80]!r}"
            raise DataError(message(where, "lines of a PLY's head", "follow its format", fact, CHECK_FILE)) from error
    if order is None or any(element.count < 0 for element in elements):
        fact = "it tells no format, or a negative count"
        raise DataError(message(where, "the head of a PLY", "be whole", fact, CHECK_FILE))
    for element in elements:
        names = [name for name, _, _ in element.properties]
        if len(set(names)) < len(names):
            fact = f"two of {element.name} are called alike"
            raise DataError(message(where, "properties in the head of a PLY", "have names of their own", fact, CHECK_FILE))
    return order, elements, line_end + 1


class _Bytes:
    """The rows of a binary PLY, one element after the other."""

    def __init__(self, data: bytes, start: int, order: str, where: str) -> None:
        self._data, self._at, self._order, self._where = data, start, order, where

    def read(self, element: _Element) -> dict[str, np.ndarray]:
        """Return the columns of an element; of a list all its numbers, and as "NAME sizes" how many are each row's."""
        if not element.lists:
            kind = np.dtype([(name, self._order + code) for name, code, _ in element.properties])
            rows = self._table(kind, element)
            return {name: rows[name] for name, _, _ in element.properties}
        return self._alike(element) or self._one_by_one(element)

    def _table(self, kind: np.dtype, element: _Element) -> np.ndarray:
        if kind.itemsize * element.count > len(self._data) - self._at:
            raise self._short(element, (len(self._data) - self._at) // kind.itemsize)
        rows = np.frombuffer(self._data, kind, element.count, self._at) if element.count else np.zeros(0, kind)
        self._at += kind.itemsize * element.count
        return rows

    def _short(self, element: _Element, whole: int) -> DataError:
        return short_file(self._where, f"{max(0, whole)} of the {element.count} rows of {element.name}")

    def _alike(self, element: _Element) -> dict[str, np.ndarray] | None:
        """Return the columns when all rows' lists are as long as the first's, else None."""
        fields, at = [], self._at
        for name, code, length in element.properties:
            code = self._order + code
            if length:
                counter = np.dtype(self._order + length)
                if not element.count or at + counter.itemsize > len(self._data):
                    return None
                size = int(np.frombuffer(self._data, counter, 1, at)[0])
                if not 0 <= size <= _MOST_CORNERS:
                    return None
                fields += [(f"{name} sizes", counter), (name, code, (size,))]
                at += counter.itemsize + size * np.dtype(code).itemsize
            else:
                fields.append((name, code))
                at += np.dtype(code).itemsize
        kind, before = np.dtype(fields), self._at
        if kind.itemsize * element.count > len(self._data) - self._at:
            return None
        rows = self._table(kind, element)
        if any((rows[f"{name} sizes"] != rows[f"{name} sizes"][0]).any() for name in element.lists):
            self._at = before
            return None
        return {name: rows[name].reshape(-1) for name in kind.names or ()}

    def _one_by_one(self, element: _Element) -> dict[str, np.ndarray]:
        """Return the columns of rows of any length; only lists, for nothing else of a face is needed."""
        found: dict[str, list] = {name: [] for name in element.lists}
        kinds = [
            (name, np.dtype(self._order + code), np.dtype(self._order + length) if length else None)
            for name, code, length in element.properties
        ]
        data, at = self._data, self._at
        for row in range(element.count):
            for name, kind, counter in kinds:
                size = 1
                if counter is not None:
                    if at + counter.itemsize > len(data):
                        raise self._short(element, row)
                    size = int(np.frombuffer(data, counter, 1, at)[0])
                    at += counter.itemsize
                if size < 0 or at + size * kind.itemsize > len(data):
                    raise self._short(element, row)
                if counter is not None:
                    found[name].append(np.frombuffer(data, kind, size, at))
                at += size * kind.itemsize
        self._at = at
        return _of_lists(found)


def _of_lists(found: dict[str, list]) -> dict[str, np.ndarray]:
    columns = {}
    for name, lists in found.items():
        columns[name] = np.concatenate(lists) if lists else np.zeros(0)
        columns[f"{name} sizes"] = np.array([len(part) for part in lists], dtype=np.int64)
    return columns


class _Text:
    """The rows of a text PLY, one a line."""

    def __init__(self, data: bytes, where: str) -> None:
        self._lines = [line for line in data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n") if line.strip()]
        self._at, self._where, self._rows = 0, where, 0

    def read(self, element: _Element) -> dict[str, np.ndarray]:
        """Return the columns of an element, as `_Bytes.read` does."""
        lines = self._lines[self._at:self._at + element.count]
        self._at += element.count
        self._rows += element.count
        if len(lines) < element.count:
            raise short_file(self._where, f"{len(self._lines)} of the {self._rows} rows")
        table = []
        for line in lines:
            try:
                table.append([float(word) for word in line.split()])
            except ValueError as error:
                raise self._broken(element, line) from error
        width = len(element.properties)
        if not element.lists:
            short = next((line for line, row in zip(lines, table, strict=True) if len(row) < width), None)
            if short is not None:
                raise self._broken(element, short)
            columns = np.array([row[:width] for row in table], dtype=np.float64).reshape(-1, width).T
            return {name: column for (name, _, _), column in zip(element.properties, columns, strict=True)}
        found: dict[str, list] = {name: [] for name in element.lists}
        for line, row in zip(lines, table, strict=True):
            at = 0
            for name, _, length in element.properties:
                size = 1
                if length:
                    size = int(row[at]) if at < len(row) and row[at].is_integer() else -1
                    at += 1
                if size < 0 or at + size > len(row):
                    raise self._broken(element, line)
                if length:
                    found[name].append(row[at:at + size])
                at += size
        return _of_lists(found)

    def _broken(self, element: _Element, line: bytes) -> DataError:
        fact = f"one of {element.name} is {line[:60].decode('utf-8', 'replace').strip()!r}"
        return DataError(message(self._where, "rows of the mesh file", "be as its head tells", fact, CHECK_FILE))


def _triangles(vertex: dict[str, np.ndarray], face: dict[str, np.ndarray], key: str, where: str) -> Triangles:
    def columns(names: tuple[str, ...]) -> np.ndarray:
        return np.stack([np.asarray(vertex[name], np.float64) for name in names], axis=1)

    def found(*choices: tuple[str, ...]) -> np.ndarray | None:
        return next((columns(names) for names in choices if all(name in vertex for name in names)), None)

    position, sizes = columns(("x", "y", "z")), np.asarray(face[f"{key} sizes"], dtype=np.int64)
    if sizes.min() < 3:
        fact = f"number {int(sizes.argmin())} has {int(sizes.min())}"
        raise DataError(message(where, "faces", "have at least three corners", fact, CHECK_FILE))
    corners = np.asarray(face[key])
    if corners.dtype.kind == "f" and not (np.isfinite(corners) & (np.abs(corners) < 2**53) & (corners % 1 == 0)).all():
        fact = "some are not"
        raise DataError(message(where, "corners of faces", "be whole numbers", fact, CHECK_FILE))
    corners = corners.astype(np.int64)
    if corners.min() < 0 or corners.max() >= len(position):
        alike = (sizes == sizes[0]).all()
        check_corners(corners.reshape(-1, sizes[0]) if alike else corners[:, None], len(position), where)
    rows = triangulate(position, corners, sizes)
    faces = corners[rows]
    nothing = np.broadcast_to(np.int64(NONE), faces.shape)
    normal, uv = found(("nx", "ny", "nz")), found(*_UV)
    uv_of = nothing if uv is None else faces
    wedges = face.get("texcoord")
    if wedges is not None and np.array_equal(face["texcoord sizes"], 2 * sizes):
        uv, uv_of = np.asarray(wedges, np.float64).reshape(-1, 2), rows
    return Triangles(
        position, faces, np.zeros((0, 3)) if normal is None else normal, nothing if normal is None else faces,
        np.zeros((0, 2)) if uv is None else uv, uv_of,
    )
