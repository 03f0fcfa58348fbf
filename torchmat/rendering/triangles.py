"""What a mesh file says, before normals and tangents are made of it: tables, and which row of each a corner takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchmat.errors import DataError, message

CHECK_FILE = "Check that the file is complete and that its suffix tells its format."
NONE = -1  # the row of a corner that has no normal or no texture coordinate


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles of all parts of a file together, in the file's own frame.

    `position` [V, 3], `normal` [N, 3] and `uv` [T, 2] (v up) are float64. `faces`, `normal_of` and `uv_of` [F, 3] are
    the rows that a triangle's corners take of them, NONE where a corner has none. `materials` are the names that the
    file gives, `unit` is the length of 1 where the format or the file says so ("m"), else "".
    """

    position: np.ndarray
    faces: np.ndarray
    normal: np.ndarray
    normal_of: np.ndarray
    uv: np.ndarray
    uv_of: np.ndarray
    materials: tuple[str, ...] = ()
    unit: str = ""

    @property
    def textured(self) -> np.ndarray:
        """Which triangles, bool [F], have texture coordinates at all three corners."""
        return np.asarray((self.uv_of != NONE).all(axis=1))

    def chosen(self, which: np.ndarray) -> Triangles:
        """Return the triangles that `which`, bool [F], marks, with the same tables."""
        rows = {name: getattr(self, name)[which] for name in ("faces", "normal_of", "uv_of")}
        return replace(self, **rows)


def of_vertices(
    position: np.ndarray, faces: np.ndarray, normal: np.ndarray | None = None, uv: np.ndarray | None = None,
    materials: tuple[str, ...] = (),
) -> Triangles:
    """Return Triangles whose corners take position, normal and texture coordinate by one and the same number."""
    nothing = np.broadcast_to(np.int64(NONE), faces.shape)
    return Triangles(
        position, faces,
        np.zeros((0, 3)) if normal is None else normal, nothing if normal is None else faces,
        np.zeros((0, 2)) if uv is None else uv, nothing if uv is None else faces, materials,
    )


def moved(part: Triangles, transform: np.ndarray) -> Triangles:
    """Return a part where a node [4, 4] puts it: normals by the inverse transpose; a mirror turns the faces round."""
    if np.array_equal(transform, np.eye(4)):
        return part
    linear = transform[:3, :3]
    mirrors = np.linalg.det(linear) < 0
    # The matrix of cofactors is the inverse transpose times the determinant, and is there for flat scales too.
    cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]]) * (-1 if mirrors else 1)
    faces, normal_of, uv_of = (
        rows[:, ::-1] if mirrors else rows for rows in (part.faces, part.normal_of, part.uv_of)
    )
    return Triangles(
        part.position @ linear.T + transform[:3, 3], faces, part.normal @ cofactors.T, normal_of, part.uv, uv_of,
        part.materials, part.unit,
    )


def together(parts: Sequence[Triangles]) -> Triangles:
    """Return all parts as one."""
    if len(parts) == 1:
        return parts[0]
    found = {}
    for table, rows in (("position", "faces"), ("normal", "normal_of"), ("uv", "uv_of")):
        tables = [getattr(part, table) for part in parts]
        offsets = np.cumsum([0, *map(len, tables[:-1])])
        found[table] = np.concatenate(tables)
        found[rows] = np.concatenate([
            np.where(of == NONE, NONE, of + offset)
            for of, offset in zip((getattr(part, rows) for part in parts), offsets, strict=True)
        ])
    names = dict.fromkeys(name for part in parts for name in part.materials)
    return Triangles(**found, materials=tuple(names), unit=parts[0].unit)


def check_corners(faces: np.ndarray, count: int, where: str) -> None:
    """Raise DataError when a corner of a triangle [F, 3] is none of `count` vertices."""
    if not faces.size or (faces.min() >= 0 and faces.max() < count):
        return
    bad = ((faces < 0) | (faces >= count)).any(axis=1)
    first = int(np.flatnonzero(bad)[0])
    fact = f"{int(bad.sum())} of {len(faces)} are not, first number {first}: {faces[first].tolist()}"
    raise DataError(message(where, "corners of triangles", f"be vertices 0 to {count - 1}", fact, CHECK_FILE))


def short_file(where: str, part: str) -> DataError:
    """Return the error of a file that has only `part` ("3 of the 4 bytes") of what its head tells."""
    fact = f"it has {part} that its head tells"
    return DataError(message(where, "the mesh file", "be complete", fact, "Copy or export it again."))
