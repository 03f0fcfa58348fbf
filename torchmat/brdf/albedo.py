"""How much light a BRDF throws back in all: a rule of directions that a highlight does not slip through."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchmat import frames
from torchmat.brdf.base import Brdf


def half_vector_rule(view: Tensor, steps: int = 256) -> tuple[Tensor, Tensor]:
    """Return lights [3, steps, 2 steps] and weights [1, steps, 2 steps] whose sums stand for integrals over the lights.

    `view` [3] is a unit vector above the horizon. The lights mirror it at half vectors that lie densest about the
    normal (polar angle growing with the square, midpoints), as the highlight does; a solid angle of lights is
    4 (H.V) times that of half vectors. Lights below the horizon have weight 0.
    """
    share = (torch.arange(steps, dtype=view.dtype) + 0.5) / steps
    polar = (share**2 * (math.pi / 2))[:, None].expand(-1, 2 * steps)
    azimuth = ((torch.arange(2 * steps, dtype=view.dtype) + 0.5) * (math.pi / steps))[None].expand(steps, -1)
    half = frames.from_polar(polar, azimuth, dim=-3)
    cosine = (half * view[:, None, None]).sum(dim=0, keepdim=True)
    light = 2 * cosine * half - view[:, None, None]
    patch = torch.sin(polar) * (share * math.pi / steps)[:, None] * (math.pi / steps)
    weight = 4 * cosine * patch
    return light, torch.where((cosine > 0) & (light[2:3] > 0), weight, torch.zeros_like(weight))


def values_over_lights(brdf: Brdf, polar: float, azimuth: float = 0.0, steps: int = 256) -> tuple[Tensor, Tensor]:
    """Return values [3, steps, 2 steps] toward a view at these angles in radians, and their weights [1, steps, 2 steps]."""
    angles = torch.tensor([polar, azimuth], dtype=brdf.dtype)
    view = frames.from_polar(angles[0], angles[1])
    light, weight = half_vector_rule(view, steps)
    return brdf.shade(light, view[:, None, None]), weight


def albedo_of(values: Tensor, weight: Tensor) -> Tensor:
    """Return the albedo [3] that values over the lights add up to."""
    return (values * weight).double().sum(dim=(1, 2)).to(values.dtype) / math.pi


def directional_albedo(brdf: Brdf, polar: float, azimuth: float = 0.0, steps: int = 256) -> Tensor:
    """Return the share [3] of even white light from all sides that leaves toward a view at these angles in radians.

    For a reciprocal BRDF that is also the share of light from there that is reflected to all sides. With 256 steps
    Lambert's is off by 3e-5, from the edge that the horizon cuts into the rule.
    """
    return albedo_of(*values_over_lights(brdf, polar, azimuth, steps))
