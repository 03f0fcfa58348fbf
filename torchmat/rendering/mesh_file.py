"""Triangles out of files, through trimesh: OBJ, PLY, STL, GLB, glTF, OFF; nothing else in the package opens a mesh."""

from __future__ import annotations

import io
import json
import os
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from torchmat.errors import DataError, message
from torchmat.rendering.mesh_complete import CHECK_FILE, check_after, check_before

if TYPE_CHECKING:
    import trimesh

_COMPRESSED = frozenset({"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"})
_JSON_CHUNK = 0x4E4F534A  # "JSON", the type of a GLB's first chunk


@dataclass(frozen=True)
class Triangles:
    """What a file says: `position` [V, 3] and `faces` [F, 3], all parts together in the file's own frame.

    `normal` [V, 3] is 0 where the file has none; `uv` [V, 2] counts, v up, on the triangles that `textured` [F] marks.
    """

    position: np.ndarray
    faces: np.ndarray
    normal: np.ndarray
    uv: np.ndarray
    textured: np.ndarray


def read_triangles(path: Path) -> Triangles:
    """Return every triangle of a mesh file, where the nodes of its scene put them.

    Points and lines are left out. An OBJ in which only some faces of a material have texture coordinates counts as
    without. Raises DataError, which names the file, when it cannot be read, has no triangles, or a corner that is no
    vertex.
    """
    if not os.path.isfile(path):
        fact = "it is a folder" if os.path.isdir(path) else "there is none"
        raise DataError(message(str(path), "the mesh file", "exist", fact, "Check the path."))
    placed = _load(path)
    parts = []
    for geometry, transform in placed:
        if hasattr(geometry, "faces") and len(geometry.faces):
            _check_corners(geometry, str(path))
            with np.errstate(invalid="ignore", over="ignore"):  # of NaN and Inf, which are looked for afterwards
                parts.append(_moved(_of_part(geometry, own_normals=True), transform))
    if not parts:
        kinds = sorted({type(geometry).__name__ for geometry, _ in placed} - {"Trimesh"})
        fact = f"it holds no triangles but {' and '.join(kinds)}" if kinds else "it holds no triangles"
        raise DataError(message(str(path), "the mesh file", "hold triangles", fact, CHECK_FILE))
    return _together(parts)


def of_trimesh(mesh: trimesh.Trimesh, where: str) -> Triangles:
    """Return the triangles of trimesh's mesh with its texture coordinates.

    Its vertex normals are not taken: trimesh does not tell those of a file from those it has averaged over every edge.
    """
    _check_corners(mesh, where)
    return _of_part(mesh, own_normals=False)


def _kind(path: Path) -> str:
    """Return the suffix of a mesh file, in small letters and without its dot; raise DataError if it is of no mesh."""
    from trimesh.exchange.load import mesh_formats

    kind = path.suffix.lower().removeprefix(".")
    known = mesh_formats() - {"stl_ascii", "xyz"}
    if kind not in known:
        listed = ", ".join(sorted(f".{name}" for name in known))
        fact = f"its suffix is {path.suffix!r}" if path.suffix else "it has no suffix"
        step = "Save the mesh as OBJ, PLY or GLB."
        raise DataError(message(str(path), "the mesh file", f"be one of {listed}", fact, step))
    return kind


def _load(path: Path) -> list[tuple[Any, np.ndarray]]:
    """Return what the nodes of a file's scene show, as trimesh has it, each with its transform [4, 4]; two may show the same."""
    import trimesh
    from trimesh.resolvers import FilePathResolver

    kind = _kind(path)
    try:
        data = path.read_bytes()
        check_before(data, kind, str(path))
        if kind in ("glb", "gltf"):
            data = _with_materials(data, kind, str(path))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of NaN and Inf, which are looked for afterwards
            # NumPy only warns about a number it cannot read, and goes on with what came before.
            warnings.filterwarnings("error", message=".*could not be read to its end.*")
            # The pictures of the file's own materials are no use here; glTF has no UVs without them.
            settings: dict[str, Any] = {"skip_materials": True} if kind == "obj" else {}
            scene = trimesh.load_scene(
                io.BytesIO(data), file_type=kind, resolver=FilePathResolver(str(path)), process=False,
                **settings,
            )
            shown = [scene.graph[node] for node in scene.graph.nodes_geometry]
        check_after(data, kind, sum(len(getattr(part, "faces", ())) for part in scene.geometry.values()), str(path))
        return [(scene.geometry[name], np.asarray(transform)) for transform, name in shown]
    except DataError:
        raise
    except Exception as error:  # trimesh's readers raise whatever the first wrong byte leads to
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        fact = f"reading it ends in {type(error).__name__}: {reason[:200]}"
        raise DataError(message(str(path), "the mesh file", "be readable", fact, CHECK_FILE)) from error


def _with_materials(data: bytes, kind: str, where: str) -> bytes:
    """Return a glTF in which every primitive has a material: trimesh passes over the UVs of those that have none."""
    rest = b""
    if kind == "glb":
        length = struct.unpack_from("<I", data, 12)[0]
        tree, rest = json.loads(data[20:20 + length]), data[20 + length:]
    else:
        tree = json.loads(data)
    packed = _COMPRESSED & set(tree.get("extensionsRequired", ()))
    if packed:
        fact = f"it needs {', '.join(sorted(packed))}"
        raise DataError(message(where, "the mesh file", "be uncompressed", fact, "Export it without compression."))
    plain = len(tree.setdefault("materials", []))
    tree["materials"].append({})
    for mesh in tree.get("meshes", ()):
        for primitive in mesh["primitives"]:
            primitive.setdefault("material", plain)
    text = json.dumps(tree).encode()
    if kind == "gltf":
        return text
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), _JSON_CHUNK) + text + rest


def _check_corners(mesh: trimesh.Trimesh, where: str) -> None:
    faces, count = np.asarray(mesh.faces), len(mesh.vertices)
    if np.shape(mesh.vertices)[1:] != (3,):
        fact = f"they are {np.shape(mesh.vertices)[-1]}"
        raise DataError(message(where, "numbers of a vertex", "be three", fact, "Export the mesh with x, y and z."))
    if faces.size == 0:
        raise DataError(message(where, "the mesh", "have triangles", "it has none", "Point clouds cannot be shaded."))
    bad = ((faces < 0) | (faces >= count)).any(axis=1)
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        fact = f"{int(bad.sum())} of {len(faces)} are not, first number {first}: {faces[first].tolist()}"
        raise DataError(message(where, "corners of triangles", f"be vertices 0 to {count - 1}", fact, CHECK_FILE))


def _of_part(mesh: trimesh.Trimesh, own_normals: bool) -> Triangles:
    position, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
    uv = getattr(mesh.visual, "uv", None)
    has_uv = uv is not None and np.ndim(uv) == 2 and len(uv) == len(position) and np.shape(uv)[1] >= 2
    # trimesh keeps the normals of a file where it would cache its own; this mesh was asked for none
    has_normals = own_normals and "vertex_normals" in mesh._cache
    return Triangles(
        position, faces,
        np.array(mesh.vertex_normals, dtype=np.float64) if has_normals else np.zeros_like(position),
        np.array(uv, dtype=np.float64)[:, :2] if has_uv else np.zeros((len(position), 2)),
        np.full(len(faces), has_uv),
    )


def _moved(part: Triangles, transform: np.ndarray) -> Triangles:
    """Return a part where its node puts it: normals by the inverse transpose; a mirror turns the faces round."""
    linear = transform[:3, :3]
    if np.array_equal(transform, np.eye(4)):
        return part
    mirrors = np.linalg.det(linear) < 0
    # The matrix of cofactors is the inverse transpose times the determinant, and is there for flat scales too.
    cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]]) * (-1 if mirrors else 1)
    return Triangles(
        part.position @ linear.T + transform[:3, 3], part.faces[:, ::-1] if mirrors else part.faces,
        part.normal @ cofactors.T, part.uv, part.textured,
    )


def _together(parts: list[Triangles]) -> Triangles:
    offsets = np.cumsum([0] + [len(part.position) for part in parts[:-1]])
    return Triangles(
        np.concatenate([part.position for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.textured for part in parts]),
    )
