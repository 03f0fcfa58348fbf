"""Maps in another size: filtered for good, or stored small and brought back.

A texture that is stored small is what a renderer filters bilinearly; at the texels of the full size that is a linear
map U of its texels. The small texture is the least-squares one, ``(U^T U)^-1 U^T``: no other of its size comes closer,
and storing what was brought back gives the same small texture again.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat import safe
from torchmat.errors import check_option
from torchmat.models.storage import MapSpec
from torchmat.repeatable import one_thread

FILTERS = ("bilinear", "nearest", "area")
VECTORS = ("normal", "rotation")  # maps of directions: what is between two of them is a direction too
ANY_SIZE = ("specular",)  # shared tables whose side is a matter of choice
_LEAST_LENGTH = 1e-3  # a shorter sum of unit vectors says nothing of the direction in between


def resample(value: Tensor, size: tuple[int, int], filter: str = "bilinear", tiles: bool = True) -> Tensor:
    """Return a map [C, h, w] as [C, H, W]; the same bits if it has that size.

    "bilinear" widens its triangle when it shrinks, so that nothing aliases; "area" is the mean of the texels that the
    new one touches; "nearest" invents no value. A map that tiles goes on around the corner, another with its border.
    """
    check_option("resample", "filter", filter, FILTERS)
    if value.shape[-2:] == size:
        return value
    if filter == "nearest":
        return functional.interpolate(value[None], size, mode="nearest-exact")[0]
    if filter == "area":
        found = functional.interpolate(value[None], size, mode="area")[0]
    else:
        found = _along(_along(value, size[0], -2, tiles), size[1], -1, tiles)
    # A mean lies between what it is of; weights that sum to 1.0000001 would put a map out of its range.
    return found.clamp(value.min(), value.max())


def _along(value: Tensor, length: int, dim: int, tiles: bool) -> Tensor:
    """Filter one dimension; what tiles is laid down three times and the middle is taken."""
    # Always along the last dimension: torch 2.13 copies one sample where it filters the rows of a map one texel wide.
    lines = value.movedim(dim, -1)
    wide = torch.cat([lines] * 3, dim=-1) if tiles else lines
    size = (lines.shape[-2], 3 * length if tiles else length)
    found = functional.interpolate(wide[None].contiguous(), size, mode="bilinear", antialias=True, align_corners=False)[0]
    return (found[..., length : 2 * length] if tiles else found).movedim(-1, dim).contiguous()


def resample_map(
    spec: MapSpec, value: Tensor, size: tuple[int, int], filter: str = "bilinear", tiles: bool = True
) -> Tensor:
    """Return a map in another size, as what it is: directions stay unit vectors, whole numbers take the nearest."""
    found = resample(value, size, "nearest" if spec.index else filter, tiles)
    if spec.name not in VECTORS or found is value:
        return found
    return _unit(found, resample(value, size, "nearest", tiles))


def _unit(vectors: Tensor, instead: Tensor) -> Tensor:
    short = vectors.norm(dim=0, keepdim=True) < _LEAST_LENGTH
    return safe.normalise(torch.where(short, instead, vectors))


def shrunk(spec: MapSpec, value: Tensor, size: tuple[int, int], tiles: bool = True) -> Tensor:
    """Return the texture [C, h, w], h and w no larger than the map's, that brought back comes nearest to the map.

    `restored` brings it back, and what it gives shrinks to the same texture again: to rounding, and of directions to
    second order in the angles between neighbours. Where details overshoot, it ends at the declared range of the map.
    """
    if value.shape[-2:] == size:
        return value
    nearest = functional.interpolate(value[None], size, mode="nearest-exact")[0]
    if spec.index:
        return nearest
    found = value.double()
    for dim, length in ((-2, size[0]), (-1, size[1])):
        if found.shape[dim] != length:
            weights = _shrinking(found.shape[dim], length, tiles)
            with one_thread():
                found = (found.movedim(dim, -1) @ weights).movedim(-1, dim)
    found = found.clamp(spec.low, spec.high) if (spec.low, spec.high) != (None, None) else found
    found = found.to(value.dtype).contiguous()
    return _unit(found, nearest) if spec.name in VECTORS else found


@lru_cache(maxsize=32)
def _shrinking(length: int, short: int, tiles: bool) -> Tensor:
    """Return the weights [length, short] of the least-squares texture, one dimension of it."""
    up = _along(torch.eye(short, dtype=torch.float64)[None], length, -1, tiles)[0]  # a row for each small texel
    with one_thread():
        return torch.linalg.solve(up @ up.T, up).T.contiguous()


def restored(spec: MapSpec, textures: Sequence[Tensor], size: tuple[int, int], tiles: bool = True) -> Tensor:
    """Return the map [C, H, W] of the textures that hold it, each brought to the full size if it is smaller."""
    way = "nearest" if spec.index else "bilinear"
    found = torch.cat([resample(texture, size, way, tiles) for texture in textures])
    if spec.name not in VECTORS or all(texture.shape[-2:] == size for texture in textures):
        return found
    return _unit(found, torch.cat([resample(texture, size, "nearest", tiles) for texture in textures]))
