"""One global reflectance for a whole material: Phong, or an anisotropic Ashikhmin-Shirley lobe.

Each lobe maps parameters [..., P] and directions to a value per sample, the same code for fitting (one direction per
image) and shading (directions per texel). Parameters live in the space they are fitted in: exponents as logarithms.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchmat import frames, safe
from torchmat.brdf.analytic import ANALYTIC
from torchmat.brdf.lobe import COLOURS, LOG_EXPONENT_RANGE, Lobe, column


def _phong(parameters: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """k_d (N.L) + k_s (N.H)^n (Ma et al. 2004, eq. 2), N = z."""
    diffuse, specular = column(parameters, 0, 3), column(parameters, 3, 3)
    exponent = torch.exp(column(parameters, 6))
    n_dot_h = frames.half_vector(light, view)[..., 2:3, :, :]
    return diffuse * light[..., 2:3, :, :] + specular * safe.power(n_dot_h, exponent)


def _phong_jacobian(parameters: Tensor, light: Tensor, view: Tensor) -> Tensor:
    exponent = torch.exp(parameters[..., 6])
    n_dot_h = frames.half_vector(light, view)[..., 2, 0, 0]
    lobe = safe.power(n_dot_h, exponent)
    # d/d(log n) of x^n = x^n n log x, which goes to 0 with x.
    growth = lobe * exponent * torch.log(torch.where(n_dot_h > 0, n_dot_h, torch.ones_like(n_dot_h)))
    cosine = light[..., 2, 0, 0].expand_as(lobe)
    rows = torch.zeros(*lobe.shape, 3, 7, dtype=lobe.dtype)
    for channel in range(3):
        rows[..., channel, channel] = cosine
        rows[..., channel, 3 + channel] = lobe
        rows[..., channel, 6] = parameters[..., 3 + channel] * growth
    return rows


LOBES: dict[str, Lobe] = {
    "phong": Lobe(
        (*COLOURS, "log_exponent"),
        (*[0.0] * 6, LOG_EXPONENT_RANGE[0]),
        (*[math.inf] * 6, LOG_EXPONENT_RANGE[1]),
        tuple((*[0.3] * 3, *[0.2] * 3, math.log(n)) for n in (2.0, 12.0, 80.0, 500.0)),
        _phong,
        _phong_jacobian,
    ),
    "ashikhmin_shirley": ANALYTIC["ashikhmin_shirley"],
}
