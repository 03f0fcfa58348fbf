"""Triangle meshes with what a texture needs at every vertex: normal, texture coordinate and tangent frame.

Scenes are right-handed: x right, y up, z toward the viewer. Faces run counter-clockwise seen from outside.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import DataError, check_option, message
from torchmat.rendering import vertices
from torchmat.rendering.mesh_file import Triangles, read_triangles
from torchmat.rendering.unwrap import PROJECTIONS, project

if TYPE_CHECKING:
    import trimesh

CREASE_DEG = 40.0  # edges sharper than this stay edges in a mesh that has no normals
_LARGEST = 1e15


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles whose vertices are split wherever normal, texture coordinate or handedness differ.

    `position` [V, 3], `normal` [V, 3] unit, `uv` [V, 2] (u right, v up; one texture spans 0..1), `tangent` [V, 3] unit,
    perpendicular to the normal, along +u; `handedness` [V], 1 or -1: ``handedness * cross(normal, tangent)`` runs along
    +v. All float32; `faces` [F, 3] int64. `mapping` tells where the texture coordinates come from: "file", "shape", or
    the projection that stood in for them. `dropped` counts triangles without area that were left out.
    """

    position: Tensor
    faces: Tensor
    normal: Tensor
    uv: Tensor
    tangent: Tensor
    handedness: Tensor
    name: str
    mapping: str
    dropped: int = 0

    @functools.cached_property
    def trimesh(self) -> trimesh.Trimesh:
        """The same triangles, in the same order, as trimesh takes them: its `ray` is Embree's."""
        import trimesh

        return trimesh.Trimesh(self.position.numpy(), self.faces.numpy(), process=False)

    @functools.cached_property
    def bounds(self) -> Tensor:
        """Lowest and highest corner of the bounding box, [2, 3]."""
        return torch.stack((self.position.amin(dim=0), self.position.amax(dim=0)))

    @functools.cached_property
    def centre(self) -> Tensor:
        """Centre [3] of the bounding box."""
        return self.bounds.mean(dim=0)

    @functools.cached_property
    def radius(self) -> float:
        """Radius of the sphere about `centre` that just holds the mesh."""
        return float((self.position - self.centre).norm(dim=1).max())


def of_arrays(
    position: np.ndarray, faces: np.ndarray, normal: np.ndarray, uv: np.ndarray, tangent: np.ndarray,
    handedness: np.ndarray, name: str, mapping: str, dropped: int = 0,
) -> Mesh:
    """Return a Mesh of finished arrays, stored as float32 and int64."""
    stored = [
        torch.from_numpy(np.array(part, dtype=np.float32)) for part in (position, normal, uv, tangent, handedness)
    ]
    position_, normal_, uv_, tangent_, handedness_ = stored
    corners = torch.from_numpy(np.array(faces, dtype=np.int64))
    return Mesh(position_, corners, normal_, uv_, tangent_, handedness_, name, mapping, dropped)


def load_mesh(path: str | Path, uv: str = "auto") -> Mesh:
    """Read a mesh from an OBJ, PLY, STL, GLB, glTF or OFF file; all its parts become one.

    Normals are the file's; where it has none they are smooth but for edges of more than CREASE_DEG degrees. `uv` is
    "auto" (the file's, and the "box" projection for parts without, or where no triangle has area in the texture), or
    the projection to take instead: one of `unwrap.PROJECTIONS`, described there. `Mesh.mapping` says what was done.
    Triangles without area are left out and counted. Raises DataError, which names the file, when it cannot be read,
    holds no triangles or none with area, or numbers that are not finite; RangeError for an unknown `uv`.
    """
    check_option("load_mesh", "uv", uv, ("auto", *PROJECTIONS))
    return build(read_triangles(Path(path)), uv, Path(path).stem, str(path))


def build(triangles: Triangles, uv: str, name: str, where: str) -> Mesh:
    """Return the Mesh of `triangles`, with normals, texture coordinates and tangents as `load_mesh` describes.

    Errors name `where`.
    """
    _check_numbers(triangles, uv, where)
    # Rounded first, so that what is equal in the mesh is what is joined.
    stored = triangles.position.astype(np.float32)
    _, same_place = vertices.distinct(*vertices.bits(stored))
    kept = vertices.has_area(stored.astype(np.float64)[triangles.faces])
    if not kept.any():
        fact = f"none of its {len(kept)} has any"
        step = "Check that its vertices do not all lie in one line."
        raise DataError(message(where, "triangles", "have area", fact, step))
    faces = triangles.faces[kept]
    points, corner = stored.astype(np.float64)[faces], same_place[faces]
    normal = _normals(triangles, faces, points, corner)
    coordinates, mapping = _coordinates(triangles, kept, points, corner, uv)
    first, joined, tangent, handedness = vertices.join(points, corner, normal, coordinates)
    return of_arrays(
        points.reshape(-1, 3)[first], joined, normal.reshape(-1, 3)[first], coordinates.reshape(-1, 2)[first], tangent,
        handedness, name, mapping, int((~kept).sum()),
    )


def _check_numbers(triangles: Triangles, uv: str, where: str) -> None:
    # Too large for the squares of lengths to fit in float32 is as bad as infinite.
    parts = {"vertices": triangles.position, "normals": triangles.normal}
    if uv == "auto":
        parts["texture coordinates"] = triangles.uv
    for what, values in parts.items():
        bad = ~(np.abs(values) < _LARGEST).all(axis=1)
        if bad.any():
            fact = f"{int(bad.sum())} of {len(bad)} hold NaN, Inf or more, first number {int(np.flatnonzero(bad)[0])}"
            step = {
                "texture coordinates": "Give uv='box' to do without them.",
                "normals": "Export the mesh without normals to have them computed.",
            }.get(what, "Repair the mesh, or export it again.")
            raise DataError(message(where, what, f"be finite and below {_LARGEST:g}", fact, step))


def _normals(triangles: Triangles, faces: np.ndarray, points: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Return unit normals [F, 3, xyz]: the file's, computed where it has none or a zero."""
    given = vertices.unit(triangles.normal)[faces]
    missing = ~given.any(axis=-1)
    if missing.any():
        given[missing] = vertices.smooth_normals(points, corner, np.deg2rad(CREASE_DEG))[missing]
    return given


def _coordinates(
    triangles: Triangles, kept: np.ndarray, points: np.ndarray, corner: np.ndarray, uv: str
) -> tuple[np.ndarray, str]:
    """Return uv [F, 3, 2] and where they come from."""
    coordinates, textured = triangles.uv[triangles.faces[kept]], triangles.textured[kept] & (uv == "auto")
    if not (textured & vertices.has_area(coordinates)).any():
        textured = np.zeros_like(textured)
    if textured.all():
        return coordinates, "file"
    projection = "box" if uv == "auto" else uv
    projected = project(projection, points, corner, vertices.face_normals(points))
    mapping = f"file and {projection}" if textured.any() else projection
    return np.where(textured[:, None, None], coordinates, projected), mapping
