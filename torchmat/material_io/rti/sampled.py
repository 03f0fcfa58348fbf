"""Any material as an RTI model: lit from all over the hemisphere, seen along the normal, and fitted in codes of a screen.

Nothing of it is solved texel by texel: all texels have the same lights, so that their coefficients are one matrix product.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor

from torchmat import colour, frames, metrics, safe
from torchmat.models import Hsh, Lptm, Material, Ptm
from torchmat.models.bases import BASES
from torchmat.models.linear import SRGB

FITTED, CHECKED = 128, 24  # lights that a fit asks, and others that its error is measured under
_LOWEST = 0.08  # of a light's z: 85 degrees
_ASLANT = (0.48, -0.36, 0.8)
RTI_MODELS = ("ptm", "lptm", "hsh")


def hemisphere_of_lights(count: int, dtype: torch.dtype, turn: float = 0.0) -> Tensor:
    """Return `count` lights [count, 3, 1, 1], evenly over the hemisphere above 5 degrees, turned by `turn`."""
    return frames.spiral(count, _LOWEST, turn).to(dtype)[:, :, None, None]


def is_rti(material: Material, models: tuple[str, ...] = RTI_MODELS) -> bool:
    """Return whether a material is one of `models` with its sums in codes of a screen and nothing beside them."""
    own = [spec.name for spec in material.own_specs()]
    return material.name in models and material.options["space"] == SRGB and set(material.maps.keys()) == set(own)


def along_the_normal(dtype: torch.dtype) -> Tensor:
    """Return the view [3, 1, 1] of all RTI."""
    return torch.tensor([0.0, 0.0, 1.0], dtype=dtype)[:, None, None]


def _pictures(material: Material, lights: Tensor) -> Iterator[Tensor]:
    view = along_the_normal(material.dtype)
    for light in lights:
        yield material.shade(light, view)


@torch.no_grad()
def as_rti(material: Material, model: str, terms: int = 9) -> Material:
    """Return `model` ("ptm", "lptm" or "hsh" of `terms`) as near to a material as its least squares come, in codes of a screen."""
    basis = BASES[f"hsh{terms}" if model == "hsh" else "polynomial"]
    lights = hemisphere_of_lights(FITTED, material.dtype)
    matrix = basis.evaluate(lights.double(), along_the_normal(torch.float64))[:, :, 0, 0]
    solution = torch.linalg.pinv(matrix).to(material.dtype)  # [terms, lights]
    total = torch.zeros(len(basis.terms), 3, *material.size, dtype=material.dtype)
    mean = torch.zeros(3, *material.size, dtype=material.dtype)
    for number, picture in enumerate(_pictures(material, lights)):
        code = colour.linear_to_srgb(picture)
        mean += code / FITTED
        for term, weight in zip(total, solution[:, number].tolist(), strict=True):
            term.add_(code, alpha=weight)
    kept: dict[str, Any] = {"space": SRGB, "storage": "float", "tiles": material.tiles}
    if model == "hsh":
        return Hsh({"harmonic": total.flatten(0, 1)}, terms=terms, **kept)
    if model == "ptm":
        return Ptm({"polynomial": total.flatten(0, 1)}, **kept)
    brightness = colour.luminance(mean)
    chroma = torch.where(brightness > 0, safe.divide(mean, brightness), torch.ones_like(mean))
    return Lptm({"chroma": chroma, "luminance": colour.luminance(total, dim=1)}, **kept)


@torch.no_grad()
def sees_the_view(material: Material) -> bool:
    """Return whether a material looks different from elsewhere."""
    light = torch.tensor([0.36, 0.48, 0.8], dtype=material.dtype)[:, None, None]
    aslant = torch.tensor(_ASLANT, dtype=material.dtype)[:, None, None]
    first, second = material.shade(light, along_the_normal(material.dtype)), material.shade(light, aslant)
    return not torch.allclose(first, second, rtol=1e-5, atol=1e-6)


@torch.no_grad()
def shading_error(material: Material, found: Material) -> tuple[float, float]:
    """Return how far `found` is from a material seen along the normal, under lights that no fit asked: relative error, and dB.

    The relative error is of linear light; the dB are those of what a screen shows.
    """
    lights = hemisphere_of_lights(CHECKED, material.dtype, turn=1.0)
    off = power = display = 0.0
    for wanted, shown in zip(_pictures(material, lights), _pictures(found.to(material.dtype), lights), strict=True):
        off += float((shown - wanted).square().double().sum())
        power += float(wanted.square().double().sum())
        display += float((colour.display(shown) - colour.display(wanted)).square().double().mean()) / CHECKED
    return (off / power if power > 0 else off), metrics.psnr(display)
