"""Frames of texels by the compiled part, with the gradients of normals and rotations."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torchmat.fast.call import call, fits
from torchmat.fast.switch import library

Plain = Callable[[Tensor | None, Tensor | None], Tensor]


def frames(normal: Tensor | None, rotation: Tensor | None, plain: Plain) -> Tensor | None:
    """Return the frames [xyz, tangent bitangent normal, H, W] of normals [3, H, W] and rotations [2, H, W]; None where that is for plain torch.

    At least one must be there. `plain` does the same with torch: what is differentiated twice goes through it.
    """
    found = library()
    if found is None or not fits(*(one for one in (normal, rotation) if one is not None)):
        return None
    return _Frames.apply(found, plain, normal, rotation)


class _Frames(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, found: ctypes.CDLL, plain: Plain, normal: Tensor | None, rotation: Tensor | None) -> Tensor:
        ctx.save_for_backward(normal, rotation)
        ctx.how = found, plain
        known = normal if normal is not None else rotation
        assert known is not None
        rows, columns = known.shape[1:]
        out = known.new_empty(3, 3, rows, columns)
        call(found, "frames", *_contiguous(normal, rotation), rows * columns, out)
        return out

    @staticmethod
    def backward(ctx: Any, *above: Tensor) -> tuple[Tensor | None, ...]:
        given, wanted = ctx.saved_tensors, ctx.needs_input_grad[2:]
        found, plain = ctx.how
        if torch.is_grad_enabled():  # to be differentiated once more
            sources = [one for one, want in zip(given, wanted, strict=True) if want]
            gradients = iter(torch.autograd.grad(plain(*given), sources, above[0], create_graph=True))
            return None, None, *(next(gradients) if want else None for want in wanted)
        of = [torch.empty(one.shape, dtype=one.dtype) if want else None for one, want in zip(given, wanted, strict=True)]
        call(found, "frames_gradients", *_contiguous(*given), above[0][0, 0].numel(), above[0].contiguous(), *of)
        return None, None, *of


def _contiguous(*given: Tensor | None) -> list[Tensor | None]:
    return [None if one is None else one.detach().contiguous() for one in given]
