"""The triangles of a mesh as Embree searches them: which one a ray meets first.

What is given to Embree has the bits that trimesh gives it, whose import takes half a second, most of it for what rays do not need.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from torchmat.rendering.mesh import Mesh

_SCALE = 100.0  # what the diagonal of the box about the mesh becomes: Embree rounds to numbers that are near 1
_NOTHING = 1e-12  # a diagonal that is none


class Embree:
    """Rays against a mesh, from its origin. Raises ImportError where embreex is not there."""

    def __init__(self, mesh: Mesh) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        position, faces = mesh.position.double().numpy(), mesh.faces.numpy()
        used = np.zeros(len(position), dtype=bool)
        used[faces] = True
        box = position[used]
        diagonal = float(((box.max(axis=0) - box.min(axis=0)) ** 2).sum() ** 0.5)
        self._origin = position.min(axis=0)
        self._scale = _SCALE if diagonal < _NOTHING else _SCALE / diagonal
        self._scene = EmbreeScene()
        TriangleMesh(scene=self._scene, vertices=self._placed(position), indices=faces.astype(np.int32))

    def _placed(self, points: np.ndarray) -> np.ndarray:
        return ((points.astype(np.float64) - self._origin) * self._scale).astype(np.float32)

    def first(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Return the triangle [P] that rays from `origin` along `direction` [P, 3] meet first; -1 for none."""
        origin, direction = origin.astype(np.float32), direction.astype(np.float32)
        length = np.sqrt(np.dot(direction * direction, [1.0, 1.0, 1.0]))
        return self._scene.run(self._placed(origin), (direction * (1 / length)[:, None]).astype(np.float32))
