"""How far the distribution material is from samples on a surface, by the compiled part, with the gradients of all its maps.

Value, display and loss are one pass: what a fit does at each of its steps. Gradients are found with the value.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchmat.fast.call import call, fits, wants_gradient
from torchmat.fast.distribution import STRIPS, Gradients, Maps, arguments_of
from torchmat.fast.switch import library


@dataclass(frozen=True)
class Samples:
    """What was measured, and how the value is compared with it.

    `rows` [n] int64 of `pixels` [any, 3, H, W] and `flags` [any, H, W] uint8, each of which counts as `weights` [3] says;
    `lit` [any, 1, H, W] at `lit_rows` [n] is what the value is multiplied with, None for 1, and `ambient` [3, H, W] is added
    to that. A display shows (x + darkest) ^ power; a `power` of 0 compares values as they are.
    """

    pixels: Tensor
    flags: Tensor
    rows: Tensor
    weights: Tensor
    lit: Tensor | None
    lit_rows: Tensor | None
    ambient: Tensor | None
    darkest: float
    power: float


def serves(light: Tensor, view: Tensor, *maps: Tensor) -> bool:
    """Return whether the compiled part has the misfit under these directions."""
    there = (light, view)
    return (
        library() is not None and all(one.ndim == 4 and one.shape[2:] == (1, 1) for one in there) and len(light) == len(view)
        and fits(*there, *maps) and not wants_gradient(*there)
    )


def misfit(light: Tensor, view: Tensor, half: Tensor, maps: Maps, dense: bool, samples: Samples) -> Tensor | None:
    """Return the sum of weighted squared residuals, a number, once differentiable in all `maps` and the ambient."""
    found, planes = library(), [one for one in (samples.pixels, samples.lit, samples.ambient) if one is not None]
    if found is None or not fits(light, *planes) or not all(one.is_contiguous() for one in planes):
        return None
    return _Misfit.apply(found, dense, samples, light, view, half, samples.ambient, *maps.every)


class _Misfit(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, found: ctypes.CDLL, dense: bool, samples: Samples, light: Tensor, view: Tensor, half: Tensor, ambient: Tensor | None,
        *given: Tensor | None,
    ) -> Tensor:
        maps, wanted = Maps(*given), any(ctx.needs_input_grad[6:])  # type: ignore[arg-type]
        arguments = arguments_of(found, dense, (light, view, half), maps)
        of = Gradients(maps, len(light))
        of_ambient = None if ambient is None else torch.empty(ambient.shape, dtype=ambient.dtype)
        strips = torch.empty(STRIPS, dtype=torch.float64)
        measured = [samples.pixels, samples.flags, samples.rows, samples.weights, samples.lit, samples.lit_rows, ambient]
        call(
            found, "distribution_misfit", *arguments, *measured, float(samples.darkest), float(samples.power), strips, wanted,
            *of.places, of_ambient,
        )
        ctx.gradients = [of_ambient, *of.every()] if wanted else None
        return torch.tensor(math.fsum(strips.tolist()), dtype=light.dtype)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *above: Tensor) -> tuple[Tensor | None, ...]:
        of = [one if want else None for one, want in zip(ctx.gradients, ctx.needs_input_grad[6:], strict=True)]
        scale = above[0]
        return (None,) * 6 + tuple(None if one is None else one if scale == 1 else one * scale for one in of)
