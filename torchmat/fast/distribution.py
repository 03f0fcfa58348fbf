"""The distribution material's value by the compiled part, with the gradients of all its maps."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchmat.fast.call import call, fits, wants_gradient
from torchmat.fast.switch import library

STRIPS = 16  # as in distribution.h


@dataclass(frozen=True)
class Maps:
    """What the value is made of, None for what is not there.

    `rise` [n, 1, 1, 1] is Fresnel's towards grazing, `frame` [xyz, along across normal, H, W], `squares` [2] those of Smith's
    roughnesses; the others are the material's maps.
    """

    rise: Tensor | None
    frame: Tensor | None
    squares: Tensor
    diffuse: Tensor
    specular: Tensor
    specular_mask: Tensor | None = None
    fresnel: Tensor | None = None
    index: Tensor | None = None

    @property
    def every(self) -> list[Tensor | None]:
        """All of it, in the order in which a Maps is made."""
        return list(vars(self).values())

    @property
    def planes(self) -> list[Tensor | None]:
        """What each texel has of its own, in the order in which the functions take it."""
        return [self.frame, self.diffuse, self.specular_mask, self.fresnel, self.index]


Plain = Callable[[Tensor, Tensor, Tensor, Maps], Tensor]


def value(light: Tensor, view: Tensor, half: Tensor, maps: Maps, dense: bool, plain: Plain) -> Tensor | None:
    """Return the value [n, 3, H, W] under directions [n, 3, 1, 1]; None where that is for plain torch.

    `plain` does the same with torch: what is differentiated twice goes through it.
    """
    found, directions = library(), (light, view, half)
    if found is None or any(one.ndim != 4 or one.shape[2:] != (1, 1) or len(one) != len(light) for one in directions):
        return None
    if not fits(*directions, *(one for one in maps.every if one is not None)) or wants_gradient(*directions):
        return None
    return _Value.apply(found, dense, plain, *directions, *maps.every)


class _Value(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, found: ctypes.CDLL, dense: bool, plain: Plain, light: Tensor, view: Tensor, half: Tensor, *given: Tensor | None,
    ) -> Tensor:
        ctx.save_for_backward(light, view, half, *given)
        ctx.how = found, dense, plain
        maps = Maps(*given)  # type: ignore[arg-type]
        arguments = arguments_of(found, dense, (light, view, half), maps)
        out = light.new_empty(len(light), 3, *maps.diffuse.shape[1:])
        call(found, "distribution", *arguments, out)
        return out

    @staticmethod
    def backward(ctx: Any, *above: Tensor) -> tuple[Tensor | None, ...]:
        light, view, half, *given = ctx.saved_tensors
        found, dense, plain = ctx.how
        maps, wanted = Maps(*given), ctx.needs_input_grad[6:]
        if torch.is_grad_enabled():  # to be differentiated once more
            sources = [one for one, want in zip(maps.every, wanted, strict=True) if want and one is not None]
            gradients = iter(torch.autograd.grad(plain(light, view, half, maps), sources, above[0], create_graph=True))
            return (None,) * 6 + tuple(next(gradients) if want else None for want in wanted)
        arguments = arguments_of(found, dense, (light, view, half), maps)
        gradients_of = Gradients(maps, len(light))
        call(found, "distribution_gradients", *arguments, above[0].contiguous(), *gradients_of.places)
        return (None,) * 6 + tuple(one if want else None for one, want in zip(gradients_of.every(), wanted, strict=True))


class Gradients:
    """Where the compiled part puts the gradients of what the value is made of."""

    def __init__(self, maps: Maps, samples: int) -> None:
        self.maps = maps
        self._planes = [None if one is None else torch.empty(one.shape, dtype=one.dtype) for one in maps.planes]
        self._specular = torch.empty(maps.specular.shape, dtype=maps.specular.dtype)
        # Of what all texels share a row a strip, of which the first ends as the sum.
        self._squares, self._rise, self._table = (
            torch.empty(STRIPS, size, dtype=maps.diffuse.dtype) for size in (2, samples, table_size(maps.specular))
        )

    @property
    def places(self) -> list[Tensor | None]:
        """What the functions are given."""
        return [*self._planes, self._specular, self._squares, self._rise, self._table]

    def every(self) -> list[Tensor | None]:
        """Return the gradients in the order in which a Maps is made."""
        frame, diffuse, *others = self._planes
        of_rise = None if self.maps.rise is None else self._rise[0].reshape(self.maps.rise.shape)
        return [of_rise, frame, self._squares[0], diffuse, self._specular, *others]


def table_size(specular: Tensor) -> int:
    return len(specular) // 3 * (specular.shape[-1] + 1) ** 2 * 4


def packed(found: ctypes.CDLL, specular: Tensor) -> Tensor:
    """Return specular maps [3 lobes, size, size] as the functions look them up."""
    table = specular.new_empty(table_size(specular))
    call(found, "distribution_table", specular.contiguous(), table, len(specular) // 3, specular.shape[-1])
    return table


def arguments_of(found: ctypes.CDLL, dense: bool, directions: tuple[Tensor, ...], maps: Maps) -> list[Any]:
    """Return what the functions are given of samples and maps."""
    lobes, size = len(maps.specular) // 3, maps.specular.shape[-1]
    table = packed(found, maps.specular)
    before = [*(one.reshape(len(one), 3) for one in directions), maps.rise, *maps.planes, table, maps.squares]
    texels, channels = maps.diffuse.shape[1] * maps.diffuse.shape[2], 1 if maps.specular_mask is None else len(maps.specular_mask)
    counts = [len(directions[0]), texels, size, lobes, channels, dense]
    return [*(one if one is None else one.contiguous() for one in before), *counts]
