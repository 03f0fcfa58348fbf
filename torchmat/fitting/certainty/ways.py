"""The ways in which the maps of a texel may differ: each number of a map, the tilts of a normal, the turn of a rotation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat import frames, safe
from torchmat.models import Material
from torchmat.models.relief_maps import HEIGHT
from torchmat.models.storage import MapSpec
from torchmat.models.unbounded import is_free

RGB = 3


@dataclass(frozen=True)
class Way:
    """One degree of freedom of every texel: map `name` moves along `tangent` [C, H, W], or [C, 1, 1] for all texels alike.

    `span` is its natural range: a difference as large as that says nothing of the texel. `single` is the colour that the
    map's meaning ties it to, where a texture of three channels holds it, else None.
    """

    name: str
    tangent: Tensor
    span: float
    single: int | None = None


def free_specs(material: Material) -> list[MapSpec]:
    """Return the maps of which each texel has numbers of its own that a fit finds; a height, and all that is shared, is known."""
    return [spec for spec in material.specs() if spec.per_texel and not spec.constant and is_free(spec) and spec != HEIGHT]


def ways_of(spec: MapSpec, value: Tensor) -> list[Way]:
    """Return the ways of a map [C, H, W]: as many as it has degrees of freedom at a texel."""
    if spec.kind == "normal":
        return [Way(spec.name, tangent, 1.0) for tangent in frames.tangent_frame(safe.normalise(value))]
    if spec.kind == "rotation":
        length = value.norm(dim=0, keepdim=True).clamp(min=1e-6)
        return [Way(spec.name, torch.cat((-value[1:], value[:1])) / length, math.pi)]
    if spec.kind == "weights":
        return [Way(spec.name, column[:, None, None], 1.0) for column in _sum_of_none(len(value), value.dtype)]
    units, span = torch.eye(len(value), dtype=value.dtype), span_of(spec, value)
    coloured = spec.layer_channels == RGB
    return [Way(spec.name, unit[:, None, None], span, number % RGB if coloured else None) for number, unit in enumerate(units)]


def span_of(spec: MapSpec, value: Tensor) -> float:
    """Return the natural range of a map: between its bounds, or without them as large as its largest number."""
    if spec.kind != "value":
        return math.pi if spec.kind == "rotation" else 1.0
    if spec.low is not None and spec.high is not None:
        return spec.high - spec.low
    return float(value.abs().max()) or 1.0


def _sum_of_none(count: int, dtype: torch.dtype) -> Tensor:
    """Return orthonormal directions [count - 1, count] whose entries sum to 0 (Helmert's)."""
    rows = torch.zeros(count - 1, count, dtype=dtype)
    for row in range(1, count):
        rows[row - 1, :row], rows[row - 1, row] = 1.0, -float(row)
        rows[row - 1] /= math.sqrt(row * (row + 1))
    return rows
