"""Small distribution materials of random maps for the tests of what is done with them: edit, blend, refit, pack."""

from __future__ import annotations

import math

import torch
from tests.models.examples import directions, per_image

from torchmat.models import Distribution
from torchmat.models.distribution import default_tilt

ALL_PARTS = ("normal", "specular_mask", "fresnel", "rotation", "tilt")
MASKED = (*ALL_PARTS[:-1], "masking")  # Smith's denominator takes the place of D, whose cosines a tilt bends
LIGHT, VIEW = (per_image(directions(6, torch.float32, seed)) for seed in (1, 2))


def unit(value: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.normalize(value, dim=0)


def distribution(
    height: int = 4, width: int = 5, lobes: int = 1, parts: tuple[str, ...] = ("specular_mask",), *, seed: int = 0,
    relief: bool = False, mask_channels: int = 1, side: int = 6, dtype: torch.dtype = torch.float32, **settings,
) -> Distribution:
    """Return a material of random maps; heights reach 0.02 texture widths."""
    generator = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    angle = 2 * math.pi * random(1, height, width)
    every = {
        "normal": unit(torch.cat((random(2, height, width) - 0.5, torch.ones(1, height, width, dtype=torch.float64)))),
        "specular_mask": 0.1 + random(mask_channels, height, width), "fresnel": random(1, height, width),
        "rotation": torch.cat((torch.cos(angle), torch.sin(angle))),
        "tilt": 0.9 * default_tilt(torch.float64) + 0.05,
        "masking": 0.1 + 0.6 * random(2),
    }
    maps = {"diffuse": 0.05 + random(3, height, width)} | {name: every[name] for name in parts}
    if lobes > 0:
        maps["specular"] = 0.5 * random(3 * lobes, side, side)
    if lobes > 1:
        index = 0.05 + random(lobes, height, width)
        maps["index"] = index / index.sum(dim=0)
    if relief:
        maps |= {"height": 0.02 * random(1, height, width), "ambient": 0.1 * random(3, height, width)}
    maps = {name: value.to(dtype) for name, value in maps.items()}
    return Distribution(maps, lobes=lobes, parts=parts, mask_channels=mask_channels, **settings)


def shaded(material: Distribution) -> torch.Tensor:
    with torch.no_grad():
        return material.shade(LIGHT.to(material.dtype), VIEW.to(material.dtype))
