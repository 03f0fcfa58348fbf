"""What a mesh is, in words: for `torchmat info`, and for the commands that use one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from torchmat.rendering import vertices
from torchmat.rendering.edges import open_edges
from torchmat.rendering.mesh import CREASE_DEG, Mesh, build
from torchmat.rendering.mesh_file import read_triangles
from torchmat.rendering.triangles import Triangles
from torchmat.report.tables import number, text_table

_MAPPINGS = {"file": "the file's", "shape": "the shape's"}
_NAMED = 8  # materials; more are counted


def mesh_line(mesh: Mesh) -> str:
    """Return one line of a mesh that is used: triangles, how many were left out, where its texture lies, its size."""
    dropped = f", {mesh.dropped} without area left out" if mesh.dropped else ""
    return f"{mesh.name}: {len(mesh.faces)} triangles{dropped}; texture coordinates: {_mapping(mesh)}; size {_size(mesh)}"


def describe_mesh(path: str | Path) -> str:
    """Return a table of a mesh file: triangles, texture coordinates, normals, size, materials, whether it is closed.

    Raises DataError, which names the file, as `load_mesh` does.
    """
    triangles = read_triangles(Path(path))
    mesh = build(triangles, "auto", Path(path).stem, str(path))
    low, high = mesh.bounds.tolist()
    rows = [
        ["source", str(path)],
        ["triangles", str(len(mesh.faces))],
        ["dropped", f"{mesh.dropped} triangles without area" if mesh.dropped else "none"],
        ["vertices", f"{len(mesh.position)}, split where normal or texture differ; {len(triangles.position)} in the file"],
        ["texture coordinates", _mapping(mesh)],
        ["mirrored", f"{100 * float((mesh.handedness[mesh.faces[:, 0]] < 0).double().mean()):.4g} % of the triangles"],
        ["normals", _normals(triangles)],
        ["size", _size(mesh)],
        ["lowest corner", _numbers(low, mesh)],
        ["highest corner", _numbers(high, mesh)],
        ["materials", _materials(triangles.materials)],
        ["watertight", _watertight(mesh)],
    ]
    return text_table(["", ""], rows)


def _mapping(mesh: Mesh) -> str:
    if mesh.mapping in _MAPPINGS:
        return _MAPPINGS[mesh.mapping]
    projection = mesh.mapping.removeprefix("file and ")
    if projection != mesh.mapping:
        return f"the file's, and a {projection} projection where it has none"
    return f"a {projection} projection"


def _numbers(values: list[float], mesh: Mesh) -> str:
    digits = 9 if any(mesh.origin) else 6  # what float32 holds, but for what lies far away
    return ", ".join(f"{value:.{digits}g}" for value in values)


def _size(mesh: Mesh) -> str:
    extent = (mesh.bounds[1] - mesh.bounds[0]).tolist()
    return f"{' x '.join(number(value) for value in extent)} {mesh.unit or '(the file names no unit)'}"


def _normals(triangles: Triangles) -> str:
    given = np.asarray((triangles.normal_of >= 0).all(axis=1))
    if given.any():
        there = np.asarray(triangles.normal.any(axis=1))
        given[given] = there[triangles.normal_of[given]].all(axis=1)
    computed = f"computed, smooth but for edges above {CREASE_DEG:g} degrees"
    if given.all():
        return "the file's"
    return f"the file's; of {int((~given).sum())} triangles {computed}" if given.any() else computed


def _materials(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more if names else "none named"


def _watertight(mesh: Mesh) -> str:
    """Return whether every edge has two triangles, one each way round, positions told apart by their bits."""
    first, group = vertices.distinct(*vertices.bits(mesh.position.numpy()))
    count = open_edges(np.asarray(first[group])[mesh.faces.numpy()])
    return f"no: {count} sides of triangles are open, or meet more than one other" if count else "yes"
