"""Pictures of a material on simple shapes: the flat patch and a sphere, seen from far away."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.errors import RangeError, ShapeError, check_option, message
from torchmat.models import Material

SHAPES = ("patch", "sphere")
_SUPERSAMPLING = 2
DEFAULT_LIGHT = (-0.4, 0.5, 0.768)


def _unit(name: str, direction: Sequence[float] | Tensor, dtype: torch.dtype) -> Tensor:
    vector = torch.as_tensor(direction, dtype=dtype)
    if vector.shape != (3,):
        raise ShapeError(message("render", name, "be x, y, z", f"its shape is {tuple(vector.shape)}"))
    if not bool(torch.isfinite(vector).all()) or float(vector.norm()) == 0:
        raise RangeError(message("render", name, "be a finite direction", f"it is {vector.tolist()}"))
    return vector / vector.norm()


def render(
    material: Material, mesh: str = "sphere", lights: Sequence[Sequence[float]] = (DEFAULT_LIGHT,),
    view: Sequence[float] = (0.0, 0.0, 1.0), size: int = 512, repeat: float = 1.0,
) -> Tensor:
    """Return a linear picture of the material on a shape, lit by distant `lights`, seen along `view`.

    It is [3, size, size]; of a patch that is not square [3, rows, size], with texels as high as wide.
    `mesh` is "patch" (the flat sample filling the picture, light and view in its tangent frame) or "sphere" (lights in
    the picture's frame: x right, y up, z toward the viewer; `view` must then be that z). `repeat` is how often the
    texture fits across the patch, or around a quarter of the equator. Lights add up; their length does not matter.
    """
    check_option("render", "mesh", mesh, SHAPES)
    if size < 1 or not 0 < repeat < math.inf:
        raise RangeError(message("render", "size and repeat", "be positive", f"they are {size} and {repeat}"))
    dtype = material.dtype
    directions = [_unit("light", light, dtype) for light in lights]
    with torch.no_grad():
        if mesh == "patch":
            return _patch(material, directions, _unit("view", view, dtype), size, repeat)
        if _unit("view", view, dtype)[2] < 1 - 1e-6:
            raise RangeError(message("render", "view", "be 0, 0, 1 for the sphere", f"it is {tuple(view)}"))
        return _sphere(material, directions, size, repeat, dtype)


def _patch(material: Material, lights: list[Tensor], view: Tensor, size: int, repeat: float) -> Tensor:
    height, width = material.size
    rows = max(1, round(size * height / width))
    u = (torch.arange(size, dtype=view.dtype) + 0.5) / size * repeat
    v = (1 - (torch.arange(rows, dtype=view.dtype) + 0.5) / rows) * repeat
    uv = torch.stack(torch.meshgrid(v, u, indexing="ij")[::-1])
    picture = torch.zeros(3, rows, size, dtype=view.dtype)
    for light in lights:
        picture += material.shade_at(uv, light[:, None, None], view[:, None, None])
    return picture


def _sphere(material: Material, lights: list[Tensor], size: int, repeat: float, dtype: torch.dtype) -> Tensor:
    fine = size * _SUPERSAMPLING
    axis = ((torch.arange(fine, dtype=dtype) + 0.5) / fine * 2 - 1) * 1.02
    y, x = torch.meshgrid(-axis, axis, indexing="ij")
    inside = x * x + y * y < 1
    z = torch.sqrt((1 - x * x - y * y).clamp(min=0))
    normal = torch.stack((x, y, z))
    # Longitude and latitude: tangents run along the parallels, so that they are continuous but for the two poles.
    longitude, latitude = torch.atan2(x, z), torch.asin(y.clamp(-1, 1))
    uv = torch.stack((longitude, latitude)) * (repeat * 2 / math.pi)
    tangent = torch.stack((torch.cos(longitude), torch.zeros_like(x), -torch.sin(longitude)))
    bitangent = torch.linalg.cross(normal, tangent, dim=0)
    frame = torch.stack((tangent, bitangent, normal))  # [row of the frame, xyz, H, W]
    picture = torch.zeros(3, fine, fine, dtype=dtype)
    # Only what is seen is shaded: a row of visible pixels is a picture of height 1.
    seen = uv[:, inside][:, None]
    view = frame[:, 2][:, inside][:, None]
    for light in lights:
        local = torch.einsum("ij...,j->i...", frame, light)[:, inside][:, None]
        picture[:, inside] += material.shade_at(seen, local, view)[:, 0]
    return functional.avg_pool2d(picture[None], _SUPERSAMPLING)[0]
