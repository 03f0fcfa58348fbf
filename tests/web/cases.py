"""Materials of every model that has a shader, with every option that its shader knows, and directions to shade them under."""

from __future__ import annotations

import math

import pytest
import torch
from tests.hard_cases.hard_directions import half_pairs, hard_grid, rows_of
from tests.models.examples import EXAMPLE_OPTIONS, directions, make, make_maps, per_image
from torch import Tensor

from torchmat.brdf.analytic import ANALYTIC
from torchmat.models import MATERIALS, Material
from torchmat.models.distribution import DISTRIBUTION_PARTS
from torchmat.models.shading_map import ShadingMap
from torchmat.web.glsl import shader_of

SHADED = tuple(name for name, kind in MATERIALS.items() if shader_of(kind) is not None)
_UNMASKED = [part for part in DISTRIBUTION_PARTS if part != "masking"]
_MORE: dict[str, list[dict]] = {
    "phong_srf": [{"residual": "cosine", "base": base} for base in ("phong", "ashikhmin_shirley")],
    "hsh": [{"terms": 4, "space": "srgb"}, {"terms": 9}, {"terms": 16, "space": "srgb"}],
    "distribution": [
        {"lobes": 5, "parts": ["normal", "masking"], "fresnel_exponent": 1}, {"lobes": 1, "parts": ["fresnel"], "fresnel_exponent": 0.7},
        {"lobes": 12, "parts": ["rotation"]}, {"lobes": 0, "parts": _UNMASKED}, {"lobes": 1, "parts": ["tilt"], "mask_channels": 3},
    ],
    "microfacet": [{"parts": parts} for parts in (["coat"], ["coat", "layered"], ["layered"], ["anisotropy"], ["normal", "sheen"])],
    "sphere_images": [{"angles_deg": [0.0]}, {"angles_deg": [0.0, 90.0]}, {"angles_deg": [float(a) for a in range(0, 181, 30)]}],
}
CASES = [
    pytest.param(name, options, id=f"{name}-{number}")
    for name in SHADED for number, options in enumerate([*EXAMPLE_OPTIONS[name], *_MORE.get(name, [])])
]


def make_exact(name: str, options: dict, height: int, width: int, **settings) -> Material:
    """Return a random material in float32 whose textures hold it to the bit."""
    return make(name, options, height, width, torch.float32, **{"storage": "float", **settings}).as_exported()


def of_every_formula() -> list[ShadingMap]:
    """Return shading maps of every BRDF that is a formula."""
    maps = make_maps("shading_map", EXAMPLE_OPTIONS["shading_map"][0], 5, 4, torch.float32)
    found = []
    for brdf, formula in ANALYTIC.items():
        shape = [min(max(value, low), high) for value, low, high in zip((-0.9, -1.4, 0.4), formula.low[6:], formula.high[6:], strict=False)]
        lobe = torch.tensor([0.4, 0.3, 0.2, 0.3, 0.2, 0.1, *shape][: len(formula.names)])
        found.append(ShadingMap({**maps, "lobe": lobe}, slices=4, brdf=brdf, storage="float").as_exported())
    return found


def hard_and_random(count: int = 24) -> tuple[Tensor, Tensor]:
    """Return light and view [n, 3, 1, 1]: where formulas break, below the horizon, and random ones."""
    random = [per_image(directions(count, torch.float32, seed, lowest=0.02)) for seed in (5, 6)]
    below = rows_of([((0.6, 0.0, -0.8), (0.0, 0.0, 1.0)), ((0.0, 0.0, 1.0), (0.6, 0.0, 0.0))], torch.float32)
    parts = (hard_grid(torch.float32), rows_of(half_pairs(), torch.float32), below, random)
    return torch.cat([one[0] for one in parts]), torch.cat([one[1] for one in parts])


def bumps(height: int, width: int, size: float = 0.08) -> Tensor:
    """Return a smooth relief [1, H, W] that repeats, of a few bumps, `size` texture widths deep."""
    y, x = torch.meshgrid(*(torch.arange(n) * (2 * math.pi / n) for n in (height, width)), indexing="ij")
    return size * (torch.sin(2 * x + 0.3) * torch.cos(y) + 0.4 * torch.sin(3 * y + x))[None].float() / 2.8
