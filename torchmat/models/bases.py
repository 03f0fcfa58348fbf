"""Functions of light and view that linear models weigh: one table, used by shading and by fitting.

Each takes unit vectors `light`, `view` [..., 3, h, w] and returns planes [..., K, h, w].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import frames, safe


class Basis(NamedTuple):
    """Names of the K terms, and the function that evaluates them."""

    terms: tuple[str, ...]
    evaluate: Callable[[Tensor, Tensor], Tensor]


def _half(light: Tensor, view: Tensor) -> Tensor:
    """s . H (Ma et al. 2004, eq. 4)."""
    return frames.half_vector(light, view)


def _half_light(light: Tensor, view: Tensor) -> Tensor:
    """s . H + t . L + constant."""
    half = frames.half_vector(light, view)
    half, light = torch.broadcast_tensors(half, light)
    return torch.cat((half, light, torch.ones_like(light[..., :1, :, :])), dim=-3)


def _quadratic(light: Tensor, view: Tensor) -> Tensor:
    """All products up to degree two of the projected light and view."""
    light, view = torch.broadcast_tensors(light, view)
    linear = [light[..., 0, :, :], light[..., 1, :, :], view[..., 0, :, :], view[..., 1, :, :]]
    products = [linear[i] * linear[j] for i in range(4) for j in range(i, 4)]
    return torch.stack([torch.ones_like(linear[0]), *linear, *products], dim=-3)


def _polynomial(light: Tensor, view: Tensor) -> Tensor:
    """The biquadratic of the projected light (Malzbender et al. 2001, eq. 1)."""
    x, y = light[..., 0, :, :], light[..., 1, :, :]
    return torch.stack((x * x, y * y, x * y, x, y, torch.ones_like(x)), dim=-3)


def _cosine(light: Tensor, view: Tensor) -> Tensor:
    return light[..., 2:3, :, :]


def _legendre(degree: int, order: int, x: Tensor) -> Tensor:
    """Associated Legendre polynomial without the Condon-Shortley phase, over (1 - x^2)^(order / 2)."""
    value = math.prod(range(2 * order - 1, 0, -2)) * torch.ones_like(x)
    previous = torch.zeros_like(x)
    for step in range(order + 1, degree + 1):
        value, previous = ((2 * step - 1) * x * value - (step + order - 1) * previous) / (step - order), value
    return value


def _hemispherical(bands: int) -> Callable[[Tensor, Tensor], Tensor]:
    """Hemispherical harmonics of the light (Gautron et al. 2004): orthonormal over the hemisphere."""

    def evaluate(light: Tensor, view: Tensor) -> Tensor:
        x, y, z = light.unbind(-3)
        # The factor sqrt(1 - (2z - 1)^2) = 2 sqrt(z (1 - z)) goes with cos and sin of the azimuth, x and y over
        # sqrt(1 - z^2): together they are smooth at the pole, where each alone is not.
        shrink = 2 * safe.sqrt(safe.divide(z, 1 + z))
        cosine, sine = x * shrink, y * shrink
        turns = [(torch.ones_like(x), torch.zeros_like(x))]
        for _ in range(bands - 1):
            c, s = turns[-1]
            turns.append((c * cosine - s * sine, s * cosine + c * sine))
        planes = []
        for degree in range(bands):
            along = []  # of the orders 0, 1 ...: turned either way they have the polynomial of z in common
            for m in range(degree + 1):
                scale = (2 * degree + 1) * math.factorial(degree - m) / (2 * math.pi * math.factorial(degree + m))
                along.append(math.sqrt(scale * (2 if m else 1)) * _legendre(degree, m, 2 * z - 1))
            for order in range(-degree, degree + 1):
                planes.append(along[abs(order)] * turns[abs(order)][0 if order >= 0 else 1])
        return torch.stack(planes, dim=-3)

    return evaluate


def _hemispherical_terms(bands: int) -> tuple[str, ...]:
    return tuple(f"{degree}_{order + degree}" for degree in range(bands) for order in range(-degree, degree + 1))


_LINEAR = ("lx", "ly", "vx", "vy")
_QUADRATIC_TERMS = ("1", *_LINEAR, *(f"{a}_{b}" for i, a in enumerate(_LINEAR) for b in _LINEAR[i:]))

BASES: dict[str, Basis] = {
    "half": Basis(("hx", "hy", "hz"), _half),
    "half_light": Basis(("hx", "hy", "hz", "lx", "ly", "lz", "1"), _half_light),
    "quadratic": Basis(_QUADRATIC_TERMS, _quadratic),
    "polynomial": Basis(("lx_lx", "ly_ly", "lx_ly", "lx", "ly", "1"), _polynomial),
    "cosine": Basis(("cos",), _cosine),
    "hsh4": Basis(_hemispherical_terms(2), _hemispherical(2)),
    "hsh9": Basis(_hemispherical_terms(3), _hemispherical(3)),
    "hsh16": Basis(_hemispherical_terms(4), _hemispherical(4)),
}
