"""Triangle meshes with what a texture needs at every vertex: normal, texture coordinate and tangent frame.

Scenes are right-handed: x right, y up, z toward the viewer. Faces run counter-clockwise seen from outside.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from torchmat import safe
from torchmat.errors import DataError, check_option, message
from torchmat.rendering import vertices
from torchmat.rendering.embree import Embree
from torchmat.rendering.mesh_file import read_triangles
from torchmat.rendering.triangles import NONE, Triangles
from torchmat.rendering.unwrap import PROJECTIONS, project

if TYPE_CHECKING:
    import trimesh

CREASE_DEG = 40.0  # edges sharper than this stay edges in a mesh that has no normals
_LARGEST = 1e15
_FAR = 16.0  # sizes of a mesh: from there on float32 loses more than four of its 24 bits
_COARSE = 1e-4  # of a mesh's size: a file that rounds to more has lost its shape
_MOST_VANISHED = 1 / 3  # a grid of quads with both poles loses a quarter at 8 x 4


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles whose vertices are split wherever normal, texture coordinate or handedness differ.

    `position` [V, 3], `normal` [V, 3] unit, `uv` [V, 2] (u right, v up; one texture spans 0..1), `tangent` [V, 3] unit,
    perpendicular to the normal, along +u; `handedness` [V], 1 or -1: ``handedness * cross(normal, tangent)`` runs along
    +v. All float32; `faces` [F, 3] int64. `mapping` tells where the texture coordinates come from: "file", "shape", or
    the projection that stood in for them. `dropped` counts triangles without area that were left out.

    `position` counts from `origin`, a place of the scene's frame, in which cameras, lights, `bounds` and `centre` are
    given: it is 0 but for a mesh that lies so far off that float32 would round its shape away. `unit` is what 1 is long
    where the file says so ("m"), else "".
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
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: str = ""

    @functools.cached_property
    def trimesh(self) -> trimesh.Trimesh:
        """The same triangles, in the same order and from `origin`, as trimesh takes them: its `ray` is Embree's."""
        import trimesh

        return trimesh.Trimesh(self.position.numpy(), self.faces.numpy(), process=False)

    @functools.cached_property
    def first_met(self) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        """What tells the triangle [P] that rays from points [P, 3], from `origin`, along directions [P, 3] meet first; -1 is none."""
        try:
            return Embree(self).first
        except ImportError:  # trimesh's own search is slow, and needs nothing else
            return self.trimesh.ray.intersects_first

    @functools.cached_property
    def bounds(self) -> Tensor:
        """Lowest and highest corner of the bounding box in the scene's frame, [2, 3] float64."""
        return torch.stack((self.position.amin(dim=0), self.position.amax(dim=0))).double() + self.offset

    @functools.cached_property
    def centre(self) -> Tensor:
        """Centre [3] of the bounding box in the scene's frame, float64."""
        return self._middle.double() + self.offset

    @functools.cached_property
    def radius(self) -> float:
        """Radius of the sphere about `centre` that just holds the mesh."""
        return float((self.position - self._middle).norm(dim=1).max())

    def textures_per_length(self, triangle: Tensor) -> Tensor:
        """Return how many textures lie along one unit of length on some triangles [P], from their areas, float64."""
        return self._textures_per_length[triangle] if len(self.faces) <= len(triangle) else self._measured(self.faces[triangle])

    @functools.cached_property
    def _textures_per_length(self) -> Tensor:
        return self._measured(self.faces)

    def _measured(self, faces: Tensor) -> Tensor:
        corner, uv = self.position[faces].double(), self.uv[faces].double()
        area = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).norm(dim=1)
        first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        across = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).abs()
        return safe.sqrt(safe.divide(across, area))

    @property
    def offset(self) -> Tensor:
        """`origin` as a tensor [3], float64."""
        return torch.tensor(self.origin, dtype=torch.float64)

    @functools.cached_property
    def _middle(self) -> Tensor:
        return torch.stack((self.position.amin(dim=0), self.position.amax(dim=0))).mean(dim=0)


def of_arrays(
    position: np.ndarray, faces: np.ndarray, normal: np.ndarray, uv: np.ndarray, tangent: np.ndarray,
    handedness: np.ndarray, name: str, mapping: str, dropped: int = 0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0), unit: str = "",
) -> Mesh:
    """Return a Mesh of finished arrays, stored as float32 and int64."""
    stored = [
        torch.from_numpy(np.array(part, dtype=np.float32)) for part in (position, normal, uv, tangent, handedness)
    ]
    position_, normal_, uv_, tangent_, handedness_ = stored
    corners = torch.from_numpy(np.array(faces, dtype=np.int64))
    return Mesh(position_, corners, normal_, uv_, tangent_, handedness_, name, mapping, dropped, origin, unit)


def load_mesh(path: str | Path, uv: str = "auto") -> Mesh:
    """Read a mesh from an OBJ, PLY, STL, GLB, glTF or OFF file; all its parts become one.

    Normals are the file's; where it has none they are smooth but for edges of more than CREASE_DEG degrees. `uv` is
    "auto" (the file's, and the "box" projection for parts without, or where no triangle has area in the texture), or
    the projection to take instead: one of `unwrap.PROJECTIONS`, described there. `Mesh.mapping` says what was done.
    Triangles without area are left out and counted. Raises DataError, which names the file, when it cannot be read,
    holds no triangles or none with area, more than a third of them vanish, or numbers are not finite; RangeError for an
    unknown `uv`.
    """
    check_option("load_mesh", "uv", uv, ("auto", *PROJECTIONS))
    return build(read_triangles(Path(path)), uv, Path(path).stem, str(path))


def build(triangles: Triangles, uv: str, name: str, where: str) -> Mesh:
    """Return the Mesh of `triangles`, with normals, texture coordinates and tangents as `load_mesh` describes.

    Errors name `where`.
    """
    _check_numbers(triangles, uv, where)
    origin = _origin(triangles)
    # Rounded first, so that what is equal in the mesh is what is joined.
    stored = (triangles.position - np.array(origin)).astype(np.float32)
    first, group = vertices.distinct(*vertices.bits(stored))
    place, position = first[group], stored.astype(np.float64)
    kept = vertices.triangles_with_area(position, triangles.faces)
    _check_kept(triangles, kept, where)
    if not kept.all():
        triangles = triangles.chosen(kept)
    faces = triangles.faces
    corner = place[faces]
    normal, normal_of = _normals(triangles, position, corner)
    coordinates, uv_of, mapping = _coordinates(triangles, position, corner, uv)
    first, joined, tangent, handedness = vertices.join(
        position, faces, corner, normal, normal_of, coordinates, uv_of
    )
    return of_arrays(
        position[faces.reshape(-1)[first]], joined, normal[normal_of.reshape(-1)[first]],
        coordinates[uv_of.reshape(-1)[first]], tangent, handedness, name, mapping, int((~kept).sum()), origin,
        triangles.unit,
    )


def _origin(triangles: Triangles) -> tuple[float, float, float]:
    """Return 0, or the centre of the box about a mesh that lies more than _FAR times its size away from 0."""
    used = np.zeros(len(triangles.position), dtype=bool)
    used[triangles.faces] = True
    points = triangles.position[used]
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    if np.abs(centre).max() <= _FAR * (high - low).max():
        return (0.0, 0.0, 0.0)
    return tuple(centre.tolist())


def _check_kept(triangles: Triangles, kept: np.ndarray, where: str) -> None:
    """Raise DataError when no triangle has area, or when many have none though they name three vertices."""
    if not kept.any():
        fact = f"none of its {len(kept)} has any"
        step = "Check that its vertices do not all lie in one line."
        raise DataError(message(where, "triangles", "have area", fact, step))
    if kept.all():
        return
    # A triangle that names a vertex twice was meant to be none: the end of a strip, the pole of a grid.
    a, b, c = triangles.faces[~kept].T
    vanished = int(((a != b) & (b != c) & (c != a)).sum())
    if vanished > _MOST_VANISHED * (int(kept.sum()) + vanished):
        points = triangles.position[triangles.faces]
        furthest = float(np.abs(points).max())
        fact = f"{vanished} of {int(kept.sum()) + vanished} have none"
        step = "Check the mesh in its editor: its vertices lie in lines, or on each other."
        coarse = float(np.spacing(np.float32(furthest)))
        if np.array_equal(points, points.astype(np.float32)) and coarse > _COARSE * np.ptp(points, axis=(0, 1)).max():
            step = (f"The file stores numbers such as {furthest:.6g} to about {coarse:.1g}: "
                    "move the mesh to the origin in its editor and export it again.")
        raise DataError(message(where, "triangles", "have area", fact, step))


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


def _normals(triangles: Triangles, position: np.ndarray, corner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit normals [N, 3] and the row [F, 3] of each corner: the file's, computed where it has none or a zero."""
    given, rows = vertices.unit(triangles.normal), triangles.normal_of
    nothing = np.asarray(~given.any(axis=1))
    missing = (rows == NONE) | nothing[rows] if len(given) else np.ones(rows.shape, dtype=bool)
    if not missing.any():
        return given, rows
    computed, smooth = vertices.smooth_normals(position, triangles.faces, corner, np.deg2rad(CREASE_DEG))
    if missing.all():
        return computed, smooth
    return np.concatenate((given, computed)), np.where(missing, len(given) + smooth, rows)


def _coordinates(
    triangles: Triangles, position: np.ndarray, corner: np.ndarray, uv: str
) -> tuple[np.ndarray, np.ndarray, str]:
    """Return uv [T, 2], the row [F, 3] of each corner, and where they come from."""
    textured = triangles.textured if uv == "auto" else np.zeros(len(triangles.faces), dtype=bool)
    if textured.any() and not vertices.triangles_with_area(triangles.uv, triangles.uv_of[textured]).any():
        textured = np.zeros_like(textured)
    if textured.all():
        return triangles.uv, triangles.uv_of, "file"
    projection = "box" if uv == "auto" else uv
    faces = triangles.faces
    projected = project(projection, position, faces, corner, vertices.flat_normals(position, faces)).reshape(-1, 2)
    rows = np.arange(len(projected)).reshape(-1, 3)
    if not textured.any():
        return projected, rows, projection
    both = np.concatenate((triangles.uv, projected))
    return both, np.where(textured[:, None], triangles.uv_of, len(triangles.uv) + rows), f"file and {projection}"
