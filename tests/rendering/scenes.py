"""Small meshes and cameras whose pictures are known by hand."""

from __future__ import annotations

import numpy as np
import torch

from torchmat.brdf import AnalyticBrdf
from torchmat.rendering.camera import Camera
from torchmat.rendering.mesh import Mesh, of_arrays

UNIT_UV = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])


def flat_mesh(corners, uv=None, tangent=None, handedness: float = 1.0, name: str = "flat") -> Mesh:
    """Return triangles [F, 3, 3] that share no vertex, each with its own normal and a tangent across it."""
    corners = np.asarray(corners, dtype=np.float64)
    edge = corners[:, 1] - corners[:, 0]
    normal = np.cross(edge, corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 0, normal / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])
    length = np.linalg.norm(edge, axis=1, keepdims=True)
    edge = np.where(length > 0, edge / np.where(length > 0, length, 1), [1.0, 0.0, 0.0])
    along = edge if tangent is None else np.broadcast_to(tangent, edge.shape)
    count = len(corners)
    uv = np.zeros((count, 3, 2)) if uv is None else np.asarray(uv, dtype=np.float64)
    return of_arrays(
        corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), np.repeat(normal, 3, axis=0), uv.reshape(-1, 2),
        np.repeat(along, 3, axis=0), np.full(3 * count, handedness), name, "shape",
    )


def squares(*places: tuple[float, float, float, float]) -> Mesh:
    """Return squares that face +z, each (x, y, z, half its side); one texture covers each, upright."""
    corners, uv = [], []
    for x, y, z, half in places:
        four = np.array([[x + (2 * u - 1) * half, y + (2 * v - 1) * half, z] for u, v in UNIT_UV])
        corners += [four[[0, 1, 3]], four[[0, 3, 2]]]
        uv += [UNIT_UV[[0, 1, 3]], UNIT_UV[[0, 3, 2]]]
    return flat_mesh(corners, uv, (1.0, 0.0, 0.0))


def front(width: float, distance: float = 10.0) -> Camera:
    """Return an orthographic camera that looks along -z at `width` of the plane z = 0."""
    return Camera((0.0, 0.0, distance), width=width)


def white(dtype: torch.dtype = torch.float64) -> AnalyticBrdf:
    return AnalyticBrdf("lambert", diffuse=1.0, dtype=dtype)
