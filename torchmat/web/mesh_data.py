"""A mesh as a page holds it: 16 bits a number, as fine as a picture shows."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import RangeError, message
from torchmat.mesh_arrays import is_mesh

_TOP, _UNIT = 65535, 32767
MOST_TRIANGLES = 400_000  # 9 MB of a page


def packed_mesh(mesh: Any) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Return what `storedMesh` in `js/meshes.js` reads: an entry that is JSON, and buffers "mesh:position" ..., little endian.

    Positions are shares of the bounding box, directions octahedral (Meyer and others 2010), texture coordinates floats.
    Raises RangeError for what is no mesh, and for one of more than MOST_TRIANGLES.
    """
    if not is_mesh(mesh):
        step = "Give torchmat.rendering.load_mesh(path)."
        raise RangeError(message("export to html", "mesh", "be a shape's name or a mesh", f"it is {mesh!r:.60}", step))
    if len(mesh.faces) > MOST_TRIANGLES:
        fact, step = f"it has {len(mesh.faces)}", "Make it coarser in its editor."
        raise RangeError(message("export to html", "mesh", f"have at most {MOST_TRIANGLES} triangles", fact, step))
    position = mesh.position.double()
    low, high = position.amin(dim=0), position.amax(dim=0)
    width = torch.where(high > low, high - low, 1.0)
    codes = ((position - low) / width * _TOP).round().numpy().astype("<u2")
    count = len(position)
    buffers = {
        "position": codes, "normal": _octahedral(mesh.normal), "tangent": _octahedral(mesh.tangent),
        "handedness": np.where(mesh.handedness.numpy() < 0, -1, 1).astype("i1"), "uv": mesh.uv.numpy().astype("<f4"),
        "faces": mesh.faces.numpy().astype("<u2" if count <= _TOP + 1 else "<u4"),
    }
    name = str(getattr(mesh, "name", "mesh")) or "mesh"
    entry = {"name": name, "vertices": count, "triangles": len(mesh.faces), "low": low.tolist(), "high": high.tolist()}
    return entry, {f"mesh:{name}": one.tobytes() for name, one in buffers.items()}


def _octahedral(direction: Tensor) -> np.ndarray:
    """Return unit vectors [V, 3] as pairs of numbers in 16 bits."""
    given = direction.double()
    flat = given[:, :2] / given.abs().sum(dim=1, keepdim=True)
    folded = (1 - flat.abs().flip(1)) * torch.where(flat < 0, -1.0, 1.0)
    return (torch.where(given[:, 2:] < 0, folded, flat) * _UNIT).round().numpy().astype("<i2")
