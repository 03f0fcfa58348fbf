"""A Mesh from whatever names one: a shape, a file, trimesh's mesh, or a Mesh itself."""

from __future__ import annotations

import functools
import os
from pathlib import Path
from typing import TYPE_CHECKING

from torchmat.errors import RangeError, check_option, message
from torchmat.rendering.mesh import Mesh, build, load_mesh
from torchmat.rendering.mesh_file import of_trimesh
from torchmat.rendering.shapes import SHAPES, make_mesh

if TYPE_CHECKING:
    import trimesh


def as_mesh(mesh: str | Path | Mesh | trimesh.Trimesh) -> Mesh:
    """Return a Mesh: of a shape's name ("teapot"), of a file, of trimesh's mesh, or itself.

    Of trimesh's, texture coordinates are taken and normals are computed as for a file without. Raises RangeError for
    a word that is neither a shape nor a file, DataError as `load_mesh` does, and RangeError for anything else.
    """
    if isinstance(mesh, Mesh):
        return mesh
    if isinstance(mesh, str) and mesh in SHAPES:
        return _shape(mesh)
    if isinstance(mesh, (str, Path)):
        if isinstance(mesh, str) and not Path(mesh).suffix and not os.path.exists(mesh):
            check_option("as_mesh", "mesh", mesh, (*SHAPES, "the path of a mesh file"))
        return load_mesh(mesh)
    if hasattr(mesh, "faces") and hasattr(mesh, "vertices"):
        return build(of_trimesh(mesh, "as_mesh"), "auto", "mesh", "as_mesh")
    fact = f"it is a {type(mesh).__name__}"
    raise RangeError(message("as_mesh", "mesh", "be a shape's name, a file, a Mesh or a trimesh.Trimesh", fact))


@functools.cache
def _shape(name: str) -> Mesh:
    """Return a shape, made once: what takes long is Embree's search tree, which a mesh keeps."""
    return make_mesh(name)
