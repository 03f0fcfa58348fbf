"""Microfacet materials for the tests of exporters: with ranges that every form holds, and with those that some do not."""

from __future__ import annotations

import math

import torch

from torchmat.geometry import normals_from_slopes
from torchmat.models import Microfacet
from torchmat.models.renderers import from_metalness

SIZE = (8, 12)


def rand(channels: int, seed: int, low: float = 0.0, high: float = 1.0, size: tuple[int, int] = SIZE) -> torch.Tensor:
    """Return smooth random values [channels, H, W] in [low, high]."""
    generator = torch.Generator().manual_seed(seed)
    return low + (high - low) * torch.rand(channels, *size, generator=generator)


def microfacet(*parts: str, size: tuple[int, int] = SIZE, **maps: torch.Tensor) -> Microfacet:
    """Return a material of these parts, whose colours are at most 0.8 and whose F0 are those of plastics and metals."""
    angle = 2 * math.pi * rand(1, 5, size=size)
    found = {
        "diffuse": rand(3, 1, 0.05, 0.8, size), "specular_f0": rand(3, 2, 0.03, 0.6, size), "roughness": rand(1, 3, 0.3, 0.9, size),
    }
    every = {
        "normal": {"normal": normals_from_slopes(rand(2, 4, -0.3, 0.3, size))},
        "anisotropy": {
            "roughness": torch.cat((rand(1, 6, 0.5, 0.8, size), rand(1, 7, 0.3, 0.5, size))),
            "rotation": torch.cat((torch.cos(angle), torch.sin(angle))),
        },
        "f90": {"f90": rand(1, 8, 0.2, 1, size)},
        "coat": {"coat": rand(1, 9, 0.01, 0.04, size), "coat_roughness": rand(1, 10, 0.2, 0.5, size)},
        "sheen": {"sheen": rand(3, 11, 0.1, 0.5, size), "sheen_roughness": torch.tensor([0.5])},
        "rolloff": {"rolloff": torch.tensor([0.1, 0.1])}, "layered": {},
    }
    for part in parts:
        found |= every[part]
    return Microfacet({**found, **maps}, parts=parts)


def of_metalness(*parts: str, **maps: torch.Tensor) -> Microfacet:
    """Return a material whose diffuse and F0 are those of a base colour and a metalness."""
    diffuse, f0 = from_metalness(rand(3, 1, 0.05, 0.8), (rand(1, 2) * 3).round() / 3)
    return microfacet(*parts, diffuse=diffuse, specular_f0=f0, **maps)
