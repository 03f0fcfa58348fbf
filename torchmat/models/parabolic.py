"""Parabolic maps of the half vector: where a direction lies on one, evenly, or with more texels at the centre.

``H.xy / (1 + H.z)`` puts the mirror direction at the centre and grazing on the rim. A sharp highlight then lies within a texel
or two, while most texels hold what hardly changes. Where texels are "dense" the distance from the centre is, but for a spot
there, its square root: a texel at the centre of a map of 48 is a fifth of a degree wide instead of five, one at the rim twice as wide.
"""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat import safe

EVEN, DENSE = SPACINGS = ("even", "dense")
# Within this distance of the centre, half a degree, places go straight with the distance: a root's slope is infinite there.
SPOT = 1 / 256


def places(direction: Tensor, spacing: str = EVEN) -> Tensor:
    """Return where directions [..., 3, h, w] lie on a map, [..., 2, h, w]: right and up, -1 to 1 from rim to rim."""
    place = direction[..., :2, :, :] / (1 + direction[..., 2:, :, :].clamp(min=0))
    return place if spacing == EVEN else _denser(place)


def _denser(place: Tensor) -> Tensor:
    """Return the places [..., 2, h, w] on a dense map of those on an even one."""
    squared = (place * place).sum(dim=-3, keepdim=True)
    return place * torch.rsqrt(torch.sqrt(squared + SPOT * SPOT))


def evenly(place: Tensor, spacing: str) -> Tensor:
    """Return the places [2, ...] on an even map of those on one of `spacing`."""
    if spacing == EVEN:
        return place
    squared = (place * place).sum(dim=0)
    fourth = squared * squared
    # q^4 = r^4 / (r^2 + s^2), solved for r^2.
    radius = ((fourth + torch.sqrt(fourth * fourth + 4 * fourth * SPOT**2)) / 2).sqrt()
    return place * safe.divide(radius, squared.sqrt())


def texel_places(size: int, dtype: torch.dtype = torch.float64) -> Tensor:
    """Return where the texels of a map [size, size] lie on it, [2, size, size]: right and up."""
    axis = (torch.arange(size, dtype=dtype) + 0.5) / size * 2 - 1
    up, right = torch.meshgrid(-axis, axis, indexing="ij")
    return torch.stack((right, up))


def respaced(table: Tensor, before: str, after: str) -> Tensor:
    """Return a map [C, S, S] of one spacing as one of another, looked up between its texels."""
    if before == after:
        return table
    even = evenly(texel_places(table.shape[-1], table.dtype), after)
    place = _denser(even) if before == DENSE else even
    grid = torch.stack((place[0], -place[1]), dim=-1)[None]
    return functional.grid_sample(table[None], grid, mode="bilinear", padding_mode="border", align_corners=False)[0]
