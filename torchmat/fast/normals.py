"""Normals of slopes by the compiled part, for what is differentiated once."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torchmat.fast.call import call, fits, wants_gradient
from torchmat.fast.switch import library


def normals(slopes: Tensor, plain: Callable[[Tensor], Tensor]) -> Tensor | None:
    """Return unit normals [..., 3, H, W] of slopes [..., 2, H, W] that carry gradients; None where that is for plain torch.

    `plain` does the same with torch: what is differentiated twice goes through it.
    """
    if not wants_gradient(slopes) or not fits(slopes):
        return None
    found = library()
    return None if found is None else _Normals.apply(found, plain, slopes)


class _Normals(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, found: ctypes.CDLL, plain: Callable[[Tensor], Tensor], slopes: Tensor) -> Tensor:
        ctx.save_for_backward(slopes)
        ctx.how = found, plain
        *lead, _, rows, columns = slopes.shape
        out = slopes.new_empty(*lead, 3, rows, columns)
        call(found, "normals", slopes.detach().contiguous(), slopes.numel() // (2 * rows * columns), rows * columns, out)
        return out

    @staticmethod
    def backward(ctx: Any, *above: Tensor) -> tuple[Tensor | None, ...]:
        (slopes,), (found, plain) = ctx.saved_tensors, ctx.how
        if torch.is_grad_enabled():  # to be differentiated once more
            (once,) = torch.autograd.grad(plain(slopes), slopes, above[0], create_graph=True)
            return None, None, once
        of, texels = torch.empty(slopes.shape, dtype=slopes.dtype), slopes[..., 0, :, :].shape[-2:].numel()
        call(found, "normals_gradients", slopes.contiguous(), slopes.numel() // (2 * texels), texels, above[0].contiguous(), of)
        return None, None, of
