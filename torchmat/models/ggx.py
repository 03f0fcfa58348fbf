"""Smith's masking for GGX: what the models of rough surfaces share."""

from __future__ import annotations

import torch
from torch import Tensor

_LEAST = 1e-12  # of a squared length, whose root has a slope that is infinite at 0


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
