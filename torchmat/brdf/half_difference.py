"""Half and difference angles (Rusinkiewicz 1998), which tables of isotropic reflectance are sampled in."""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat import frames, safe


def to_half_difference(light: Tensor, view: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return (half polar, difference polar, difference azimuth) in radians, each [..., h, w], of planes [..., 3, h, w].

    The difference is the light as seen from the half vector; its azimuth lies in [0, 2 pi), and is 0, with gradient 0,
    where light and view are the same. Both polar angles are found from lengths, not from cosines, and so are exact
    near 0, where the highlight of a mirror lies.
    """
    half_polar, half_azimuth = frames.to_polar(frames.half_vector(light, view), dim=-3)
    apart, together = light - view, light + view
    difference_polar = torch.atan2(_length(apart), _length(together))
    x, y, z = apart.unbind(-3)
    cosine, sine = torch.cos(half_azimuth), torch.sin(half_azimuth)
    along = (x * cosine + y * sine) * torch.cos(half_polar) - z * torch.sin(half_polar)
    across = y * cosine - x * sine
    _, azimuth = frames.to_polar(torch.stack((along, across, torch.zeros_like(along))), dim=0)
    return half_polar, difference_polar, azimuth


def from_half_difference(half_polar: Tensor, difference_polar: Tensor, azimuth: Tensor) -> tuple[Tensor, Tensor]:
    """Return light and view, planes [..., 3, h, w], with the half vector in the plane y = 0: the way back.

    The angles, in radians, broadcast to [..., h, w].
    """
    half_polar, difference_polar, azimuth = torch.broadcast_tensors(half_polar, difference_polar, azimuth)
    difference = frames.from_polar(difference_polar, azimuth, dim=-3)
    x, y, z = difference.unbind(-3)
    cosine, sine = torch.cos(half_polar), torch.sin(half_polar)
    light = torch.stack((x * cosine + z * sine, y, z * cosine - x * sine), dim=-3)
    view = torch.stack((z * sine - x * cosine, -y, z * cosine + x * sine), dim=-3)
    return light, view


def _length(vector: Tensor) -> Tensor:
    return safe.sqrt((vector * vector).sum(dim=-3))
