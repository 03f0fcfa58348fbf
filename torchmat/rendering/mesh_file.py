"""Triangles out of files: OBJ, glTF, PLY and OFF by readers of this package, STL through trimesh.

Nothing else in the package opens a mesh. trimesh fans the polygons of every format and reads more of the others wrong
than right (`mesh_obj`, `mesh_gltf`); an STL has neither polygons nor indices, and its rays are Embree's.
"""

from __future__ import annotations

import io
import os
import struct
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torchmat.errors import DataError, message
from torchmat.rendering.mesh_gltf import read_gltf
from torchmat.rendering.mesh_obj import read_obj
from torchmat.rendering.mesh_off import read_off
from torchmat.rendering.mesh_ply import read_ply
from torchmat.rendering.triangles import CHECK_FILE, Triangles, check_corners, of_vertices, short_file, together

if TYPE_CHECKING:
    import trimesh

KINDS = ("glb", "gltf", "obj", "off", "ply", "stl")


def is_mesh(path: str | Path) -> bool:
    """Return whether a path is called like a mesh file, whatever it holds, and is there."""
    return Path(path).suffix.lower().removeprefix(".") in KINDS and os.path.isfile(path)


def read_triangles(path: Path) -> Triangles:
    """Return every triangle of a mesh file, where the nodes of its scene put them.

    Points and lines are left out. Raises DataError, which names the file, when it cannot be read, has no triangles, or
    a corner that is no vertex.
    """
    if not os.path.isfile(path):
        fact = "it is a folder" if os.path.isdir(path) else "there is none"
        raise DataError(message(str(path), "the mesh file", "exist", fact, "Check the path."))
    kind = _kind(path)
    try:
        data = path.read_bytes()
        found, others = _read(data, kind, path)
    except DataError:
        raise
    except Exception as error:  # trimesh's readers raise whatever the first wrong byte leads to
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        fact = f"reading it ends in {type(error).__name__}: {reason[:200]}"
        raise DataError(message(str(path), "the mesh file", "be readable", fact, CHECK_FILE)) from error
    if found is None or not len(found.faces):
        fact = f"it holds no triangles but {' and '.join(sorted(others))}" if others else "it holds no triangles"
        raise DataError(message(str(path), "the mesh file", "hold triangles", fact, CHECK_FILE))
    return found


def _read(data: bytes, kind: str, path: Path) -> tuple[Triangles | None, set[str]]:
    """Return the triangles of a file's bytes, or None, and what else it holds."""
    if kind in ("glb", "gltf"):
        return read_gltf(data, path, kind == "glb")
    if kind == "stl":
        return _stl(data, str(path))
    found = {"obj": read_obj, "ply": read_ply, "off": read_off}[kind](data, str(path))
    return found, set() if found is not None else {"points and lines"}


def of_trimesh(mesh: trimesh.Trimesh, where: str) -> Triangles:
    """Return the triangles of trimesh's mesh with its texture coordinates.

    Its vertex normals are not taken: trimesh does not tell those of a file from those it has averaged over every edge.
    """
    return _of_part(mesh, where)


def _kind(path: Path) -> str:
    """Return the suffix of a mesh file, in small letters and without its dot; raise DataError if it is of no mesh."""
    kind = path.suffix.lower().removeprefix(".")
    if kind not in KINDS:
        listed = ", ".join(f".{name}" for name in KINDS)
        fact = f"its suffix is {path.suffix!r}" if path.suffix else "it has no suffix"
        step = "Save the mesh as OBJ, PLY or GLB."
        raise DataError(message(str(path), "the mesh file", f"be one of {listed}", fact, step))
    return kind


_STL_HEAD, _STL_TRIANGLE = 84, 50  # bytes


def _stl(data: bytes, where: str) -> tuple[Triangles | None, set[str]]:
    """Return the triangles of an STL's bytes, and the kinds of what else trimesh finds in it."""
    import trimesh

    if len(data) >= _STL_HEAD and b"\0" in data[:_STL_HEAD]:
        expected = _STL_HEAD + _STL_TRIANGLE * struct.unpack_from("<I", data, 80)[0]
        if len(data) < expected:
            raise short_file(where, f"{len(data)} of the {expected} bytes")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of NaN and Inf, which are looked for afterwards
        # NumPy only warns about a number it cannot read, and goes on with what came before.
        warnings.filterwarnings("error", message=".*could not be read to its end.*")
        scene = trimesh.load_scene(io.BytesIO(data), file_type="stl", process=False)
    parts = [_of_part(part, where) for part in scene.geometry.values() if len(getattr(part, "faces", ()))]
    return together(parts) if parts else None, {type(part).__name__ for part in scene.geometry.values()} - {"Trimesh"}


def _of_part(mesh: trimesh.Trimesh, where: str) -> Triangles:
    position, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
    if position.shape[1:] != (3,):
        fact = f"they are {position.shape[-1]}"
        raise DataError(message(where, "numbers of a vertex", "be three", fact, "Export the mesh with x, y and z."))
    if faces.size == 0:
        raise DataError(message(where, "the mesh", "have triangles", "it has none", "Point clouds cannot be shaded."))
    check_corners(faces, len(position), where)
    uv = getattr(mesh.visual, "uv", None)
    has_uv = uv is not None and np.ndim(uv) == 2 and len(uv) == len(position) and np.shape(uv)[1] >= 2
    return of_vertices(position, faces, uv=np.array(uv, dtype=np.float64)[:, :2] if has_uv else None)
