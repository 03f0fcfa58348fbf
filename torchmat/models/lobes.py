"""One global reflectance for a whole material: Phong, or an anisotropic Ashikhmin-Shirley lobe.

Each lobe maps parameters [..., P] and directions to a value per sample, the same code for fitting (one direction per
image) and shading (directions per texel). Parameters live in the space they are fitted in: exponents as logarithms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import frames, safe

LOG_EXPONENT_RANGE = (math.log(1e-2), math.log(1e5))


class Lobe(NamedTuple):
    """Names and bounds of the P parameters, starting points for a fit, and the function.

    `evaluate(parameters [..., P], light, view)` takes planes [..., 3, h, w] and returns [..., 3, h, w]; parameters
    without leading dimensions serve every image. `jacobian`, where a formula is at hand, gives [..., 3, P] for
    directions [..., 3, 1, 1]; None leaves it to differentiation. `axis` is the number of the parameter that is the angle
    of a line, the same after half a turn.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    starts: tuple[tuple[float, ...], ...]
    evaluate: Callable[[Tensor, Tensor, Tensor], Tensor]
    jacobian: Callable[[Tensor, Tensor, Tensor], Tensor] | None = None
    axis: int | None = None


def _column(parameters: Tensor, first: int, count: int) -> Tensor:
    """Return parameters [..., count] as planes [..., count, 1, 1]."""
    return parameters[..., first : first + count, None, None]


def _phong(parameters: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """k_d (N.L) + k_s (N.H)^n (Ma et al. 2004, eq. 2), N = z."""
    diffuse, specular = _column(parameters, 0, 3), _column(parameters, 3, 3)
    exponent = torch.exp(_column(parameters, 6, 1))
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


def _ashikhmin_shirley(parameters: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """k_d (N.L) + pi (N.L) times the specular lobe of Ashikhmin & Shirley 2000, eq. 4, tangent at `axis` from +x.

    The diffuse part stays Lambert's, as in the Phong base, so that the two bases differ in the lobe alone.
    """
    diffuse, specular = _column(parameters, 0, 3), _column(parameters, 3, 3)
    along, across = torch.exp(_column(parameters, 6, 1)), torch.exp(_column(parameters, 7, 1))
    axis = _column(parameters, 8, 1)
    total = light + view
    half = safe.normalise(total)
    x, y, z = half[..., 0:1, :, :], half[..., 1:2, :, :], half[..., 2:3, :, :]
    h_dot_u = x * torch.cos(axis) + y * torch.sin(axis)
    h_dot_v = y * torch.cos(axis) - x * torch.sin(axis)
    # (n_u cos^2 + n_v sin^2) of the azimuth; at the pole both are 0 over 0 and the power of 1 is 1 whatever it says.
    exponent = safe.divide(along * h_dot_u**2 + across * h_dot_v**2, x * x + y * y)
    n_dot_l, n_dot_v = light[..., 2:3, :, :], view[..., 2:3, :, :]
    # H.L of unit vectors is |L + V| / 2, which does not cancel where they are nearly opposite at the horizon. The
    # derivative of a length is its direction, so H is held fixed: through it the way back would overflow there.
    h_dot_l = (half.detach() * total).sum(dim=-3, keepdim=True) / 2
    fresnel = specular + (1 - specular) * (1 - h_dot_l.clamp(0, 1)) ** 5
    scale = torch.sqrt((along + 1) * (across + 1)) / (8 * math.pi)
    # (N.L) / (H.L max(N.L, N.V)) as two quotients: near the horizon the product of the denominators underflows.
    falloff = safe.divide(safe.divide(n_dot_l, torch.maximum(n_dot_l, n_dot_v)), h_dot_l)
    lobe = (math.pi * scale * safe.power(z, exponent) * falloff) * fresnel
    return diffuse * n_dot_l + lobe


_COLOURS = ("diffuse_r", "diffuse_g", "diffuse_b", "specular_r", "specular_g", "specular_b")
_NO_LIMIT = math.inf

LOBES: dict[str, Lobe] = {
    "phong": Lobe(
        (*_COLOURS, "log_exponent"),
        (*[0.0] * 6, LOG_EXPONENT_RANGE[0]),
        (*[_NO_LIMIT] * 6, LOG_EXPONENT_RANGE[1]),
        tuple((*[0.3] * 3, *[0.2] * 3, math.log(n)) for n in (2.0, 12.0, 80.0, 500.0)),
        _phong,
        _phong_jacobian,
    ),
    "ashikhmin_shirley": Lobe(
        (*_COLOURS, "log_exponent_along", "log_exponent_across", "axis"),
        (*[0.0] * 6, LOG_EXPONENT_RANGE[0], LOG_EXPONENT_RANGE[0], -_NO_LIMIT),
        (*[_NO_LIMIT] * 3, *[1.0] * 3, LOG_EXPONENT_RANGE[1], LOG_EXPONENT_RANGE[1], _NO_LIMIT),
        tuple(
            (*[0.3] * 3, *[0.1] * 3, math.log(n * ratio), math.log(n / ratio), axis)
            for n in (8.0, 80.0)
            for ratio, axis in ((1.0, 0.0), (3.0, 0.0), (3.0, math.pi / 4), (3.0, math.pi / 2), (3.0, -math.pi / 4))
        ),
        _ashikhmin_shirley,
        axis=8,
    ),
}
