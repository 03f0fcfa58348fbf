"""What exports need of a mesh, so that they need not know how one is read and drawn."""

from __future__ import annotations

from typing import Any, Protocol

from torch import Tensor


class MeshArrays(Protocol):
    """What is needed of a mesh: a `torchmat.rendering.Mesh` is one."""

    position: Tensor
    faces: Tensor
    normal: Tensor
    uv: Tensor
    tangent: Tensor
    handedness: Tensor


def is_mesh(value: Any) -> bool:
    """Return whether a value has the arrays of a mesh."""
    return all(hasattr(value, part) for part in MeshArrays.__annotations__)
