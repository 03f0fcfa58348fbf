"""Angles as hues, which a paint program shows and paints: +x is red, and the hue turns as the angle does (Liao 2011)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchmat.parts_of import part_of

_GREY = 1e-3  # a saturation below it has no hue but rounding


def hue_of(directions: Tensor) -> Tensor:
    """Return directions [2, H, W] of any length as sRGB values [3, H, W] of full saturation and value."""
    angle = torch.atan2(directions[1], directions[0]) % (2 * math.pi)
    full = torch.ones_like(angle)
    return part_of("kornia.color", "hsv_to_rgb")(torch.stack((angle, full, full))).clamp(0, 1)


def directions_of(picture: Tensor) -> Tensor:
    """Return the unit vectors [2, H, W] that the hues of sRGB values [3, H, W] stand for; +x where there is none."""
    hue = torch.where(is_grey(picture), torch.zeros((), dtype=picture.dtype), part_of("kornia.color", "rgb_to_hsv")(picture)[0])
    return torch.stack((torch.cos(hue), torch.sin(hue)))


def is_grey(picture: Tensor) -> Tensor:
    """Return where [H, W] sRGB values [3, H, W] have no hue; how saturated or bright the others are does not matter."""
    most = picture.amax(dim=0)
    return most - picture.amin(dim=0) <= _GREY * most
