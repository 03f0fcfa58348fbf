"""Directions and frames of the tangent space.

x points to the right of the texture, y up the texture (row 0 is the top row), z along the mean surface normal.
`light`, `view`, `half` and `normal` are unit vectors that point away from the surface. Planes keep vectors on
dimension -3, lists of directions on the last; each function takes `dim`.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchmat import safe

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))  # by which directions turn from one to the next, so that none repeat


def from_polar(polar: Tensor, azimuth: Tensor, dim: int = -1) -> Tensor:
    """Return unit directions from angles in radians.

    `polar` is measured from the normal, `azimuth` from +x toward +y; both have the same shape `[...]`, the
    result gains a dimension of 3 at `dim`.
    """
    sine = torch.sin(polar)
    return torch.stack((sine * torch.cos(azimuth), sine * torch.sin(azimuth), torch.cos(polar)), dim=dim)


def spiral(count: int, lowest: float = 0.0, turn: float = 0.0) -> Tensor:
    """Return `count` unit directions [count, 3], float64, that fill the sphere above z = `lowest` evenly: a Fibonacci spiral.

    `turn` is added to all azimuths.
    """
    place = torch.arange(count, dtype=torch.float64)
    polar = torch.arccos(1 - (1 - lowest) * (place + 0.5) / count)
    return from_polar(polar, place * GOLDEN_ANGLE + turn)


def to_polar(direction: Tensor, dim: int = -1) -> tuple[Tensor, Tensor]:
    """Return (polar, azimuth) in radians of unit directions; azimuth in [0, 2 pi), 0 at the pole."""
    x, y, z = direction.unbind(dim)
    # Brought to size 1 first: squares underflow near the pole, and the derivative of atan2 divides by x^2 + y^2.
    size = torch.maximum(x.abs(), y.abs()).detach()
    at_pole = size < torch.finfo(size.dtype).tiny
    unit_x, unit_y = safe.divide(x, size), safe.divide(y, size)
    polar = torch.atan2(size * safe.sqrt(unit_x * unit_x + unit_y * unit_y), z)
    azimuth = torch.atan2(unit_y, torch.where(at_pole, torch.ones_like(x), unit_x))
    azimuth = torch.where(at_pole, torch.zeros_like(azimuth), azimuth)
    full_turn = 2 * torch.pi
    azimuth = torch.where(azimuth < 0, azimuth + full_turn, azimuth)
    # -1e-9 + 2 pi rounds to 2 pi in float32, which is azimuth 0 again, with the same gradient.
    return polar, torch.where(azimuth >= full_turn, azimuth - azimuth.detach(), azimuth)


def half_vector(light: Tensor, view: Tensor, dim: int = -3) -> Tensor:
    """Return the unit half vector; zero, with gradient 0, where light and view are opposite."""
    return safe.normalise(light + view, dim=dim)


def tangent_frame(normal: Tensor, dim: int = -3) -> tuple[Tensor, Tensor]:
    """Return the tangent and bitangent that the shortest rotation from +z to `normal` makes of +x and +y.

    Defined and continuous for every normal with z > -1, so in particular over the whole upper hemisphere;
    frames that pick an axis by comparing components flip somewhere on it.
    """
    x, y, z = normal.unbind(dim)
    shared = safe.divide(torch.ones_like(z), 1 + z)
    tangent = torch.stack((1 - x * x * shared, -x * y * shared, -x), dim=dim)
    bitangent = torch.stack((-x * y * shared, 1 - y * y * shared, -y), dim=dim)
    return tangent, bitangent
