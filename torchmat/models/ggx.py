"""GGX's distribution and Smith's masking: what the models of rough surfaces share."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.models.base import combine

_LEAST = 1e-12  # of a squared length, whose root has a slope that is infinite at 0
_LEAST_MATTER = 50  # 1 / 2 %
_SMOOTHEST = 1e-6  # squared alpha that is added: a mirror would be infinite


def smith_denominator(light: Tensor, view: Tensor, squares: Tensor) -> tuple[Tensor, Tensor]:
    """Return N.L and ``2 (N.L)(N.V) / G``, both [..., 1, h, w], of height-correlated masking (Heitz 2014, eq. 99).

    It is ``N.L |(a_u v_x, a_v v_y, v_z)| + N.V |(a_u l_x, a_v l_y, l_z)|``, from which ``D F / (2 ...)`` is the lobe.
    Directions below the horizon count as on it.

    Args:
        light, view: unit vectors [..., 3, h, w] in the frame of the surface: along, across, normal.
        squares: the squares of the roughness a_u and a_v, [2, h, w] or [2, 1, 1]; one channel stands for both.
    """
    n_dot_l, n_dot_v = (direction[..., 2:3, :, :].clamp(min=0) for direction in (light, view))
    return n_dot_l, torch.addcmul(n_dot_l * _stretched(view, n_dot_v, squares), n_dot_v, _stretched(light, n_dot_l, squares))


def _stretched(direction: Tensor, cosine: Tensor, squares: Tensor) -> Tensor:
    along, across = direction[..., 0:1, :, :], direction[..., 1:2, :, :]
    length = cosine * cosine + along * along * squares[:1] + across * across * squares[-1:]
    return torch.sqrt(length.clamp(min=_LEAST))


def squared_alpha(roughness: Tensor) -> Tensor:
    """Return the square of GGX's alpha, at least 1e-6, for a roughness, the root of alpha."""
    square = roughness.square()
    return square.square() + _SMOOTHEST


def schlick_rise(apart: Tensor) -> Tensor:
    """Return the fifth power of 1 - cosine (Schlick 1994), as products: what `pow` takes is ten times as long."""
    square = apart * apart
    return square * square * apart


def usual_f90(f0: Tensor) -> Tensor:
    """Return the reflectance at grazing [1, H, W] of F0 [C, H, W]: 1, and less below the 2 % that any matter reflects.

    ``min(1, 50 F0)`` of the mean channel (Lagarde & de Rousiers 2014, section 3.1.3), so that a surface of F0 0 has no lobe.
    """
    return (_LEAST_MATTER * f0.mean(dim=0, keepdim=True)).clamp(max=1)


def ggx_share(light: Tensor, view: Tensor, half: Tensor, squares: Tensor, grazing: float) -> Tensor:
    """Return ``pi D G / (4 (N.L)(N.V)) N.L`` [..., 1, h, w]: the lobe without its Fresnel term.

    Args:
        light, view, half: unit vectors [..., 3, h, w] in the frame of the surface: along, across, normal.
        squares: the squares of alpha along and across, [2, h, w]; one channel stands for both.
        grazing: what is added to the denominator, so that it goes to 0 at grazing on any way.
    """
    cosines = [direction[..., 2:3, :, :] for direction in (light, view)]
    n_dot_l, n_dot_v = (cosine.clamp(min=0) for cosine in cosines)
    # A direction below the horizon is masked as one as far above it.
    lengths = [_stretched(direction, cosine, squares) for direction, cosine in zip((light, view), cosines, strict=True)]
    denominator = torch.addcmul(n_dot_l * lengths[1], n_dot_v, lengths[0])
    x, y, z = half[..., 0:1, :, :], half[..., 1:2, :, :], half[..., 2:3, :, :]
    slope = z * z + x * x / squares[:1] + y * y / squares[-1:]
    area = squares if len(squares) == 1 else torch.sqrt(squares[:1] * squares[1:])
    return n_dot_l / (slope * slope * area * (2 * denominator + 2 * grazing))


def _squared_length(vector: Tensor) -> Tensor:
    # Plane by plane: a norm over this dimension takes ten times as long.
    x, y, z = vector.split(1, dim=-3)
    return torch.addcmul(torch.addcmul(x * x, y, y), z, z)


class Stretched(NamedTuple):
    """Frames [xyz, 3, H, W] in which a rough surface is a round one, and `area`, alpha_u alpha_v, [1, H, W].

    Half vectors are shortened along and across by alpha, directions lengthened: their squared length is what D, and their
    length what Smith's masking wants.
    """

    half: Tensor
    direction: Tensor
    area: Tensor

    @classmethod
    def of(cls, frame: Tensor, squares: Tensor) -> Stretched:
        """Return those of frames (along, across, normal) and squared alphas [1 or 2, H, W]."""
        alphas = torch.sqrt(squares).expand(2, -1, -1)
        alphas = torch.cat((alphas, torch.ones_like(alphas[:1])))
        return cls(frame / alphas, frame * alphas, alphas[:1] * alphas[1:2])


def stretched_share(
    light: Tensor, view: Tensor, half: Tensor, frames: Stretched, grazing: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the lobe of `ggx_share`, N.L and N.V, each [..., 1, h, w], for directions of the plane.

    A direction below the horizon is masked as one as far above it.
    """
    slope = _squared_length(combine(half, frames.half))
    lengths, cosines = [], []
    for direction in (light, view):
        found = combine(direction, frames.direction)
        lengths.append(torch.sqrt(_squared_length(found).clamp(min=_LEAST)))
        cosines.append(found[..., 2:3, :, :].clamp(min=0))
    denominator = torch.addcmul(cosines[1] * lengths[0] + grazing, cosines[0], lengths[1])
    return cosines[0] / (slope * slope * (2 * frames.area) * denominator), cosines[0], cosines[1]
