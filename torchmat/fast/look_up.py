"""Looking maps up by the compiled part, with gradients."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torchmat.fast.call import call, fits
from torchmat.fast.switch import library

_BORDER, _LANES = 3, 4  # of packed maps, as in look_up.h
_STRIPS = 8  # sums of gradients in one map for all, whatever the number of threads
_MOST_VALUES = 50_000_000  # of packed maps
Plain = Callable[[Tensor, Tensor, bool, str], Tensor]


def look_up(maps: Tensor, uv: Tensor, tiles: bool, mode: str, plain: Plain) -> Tensor | None:
    """Return `maps` [N or 1, C, H, W] at `uv` [N, 2, h, w], [N, C, h, w]; None where that is for plain torch.

    `mode` is "bilinear" or "bicubic". `plain` does the same with torch: what is differentiated twice goes through it.
    """
    found = library()
    if found is None or not fits(maps, uv) or mode == "nearest" or len(maps) not in (1, len(uv)):
        return None
    if _packed_size(maps) > _MOST_VALUES:
        return None
    return _LookUp.apply(maps, uv, tiles, mode, found, plain)


def _packed_size(maps: Tensor) -> int:
    channels = maps.shape[1]
    lanes = 1 if channels == 1 else -(-channels // _LANES) * _LANES
    return len(maps) * lanes * (maps.shape[2] + 2 * _BORDER) * (maps.shape[3] + 2 * _BORDER)


def _one_for_all(batch: Tensor) -> Tensor:
    """Return a batch contiguous, as one where all are the same memory."""
    return batch[:1].contiguous() if batch.stride(0) == 0 else batch.contiguous()


class _LookUp(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, maps: Tensor, uv: Tensor, tiles: bool, mode: str, found: ctypes.CDLL, plain: Plain) -> Tensor:
        ctx.save_for_backward(maps, uv)
        ctx.how = tiles, mode, found, plain
        own, places = _one_for_all(maps), _one_for_all(uv)
        packed = _packed(found, own, tiles)
        count, (channels, rows, columns) = len(uv), own.shape[1:]
        out = own.new_empty(count, channels, *uv.shape[2:])
        size = uv.shape[2] * uv.shape[3]
        call(
            found, "look_up", packed, places, out, count, len(own), len(places), channels, rows, columns, size,
            mode == "bicubic", tiles,
        )
        return out

    @staticmethod
    def backward(ctx: Any, *above: Tensor) -> tuple[Tensor | None, ...]:
        maps, uv = ctx.saved_tensors
        tiles, mode, found, plain = ctx.how
        wanted = [bool(one) for one in ctx.needs_input_grad[:2]]
        if torch.is_grad_enabled():  # to be differentiated once more
            sources = [one for one, want in zip((maps, uv), wanted, strict=True) if want]
            gradients = iter(torch.autograd.grad(plain(maps, uv, tiles, mode), sources, above[0], create_graph=True))
            return (*(next(gradients) if want else None for want in wanted), None, None, None, None)
        own, places = _one_for_all(maps), _one_for_all(uv)
        many, count, (channels, rows, columns) = len(own), len(uv), own.shape[1:]
        strips = min(count, _STRIPS) if many == 1 else 1
        packed = _packed(found, own, tiles)
        sums = packed.new_zeros(many * strips * (packed.numel() // many)) if wanted[0] else None
        of_uv = uv.new_empty(uv.shape) if wanted[1] else None
        call(
            found, "look_up_gradients", packed, places, above[0].contiguous(), sums, of_uv, count, many, len(places), strips,
            channels, rows, columns, uv.shape[2] * uv.shape[3], mode == "bicubic", tiles,
        )
        of_maps = None
        if sums is not None:
            of_maps = torch.empty_like(own)
            call(found, "unpack", sums, of_maps, many, strips, channels, rows, columns, tiles)
            if many != len(maps):  # all are the same memory, and it does not matter which of them gets the gradient
                of_maps = torch.cat((of_maps, of_maps.new_zeros(len(maps) - 1, *of_maps.shape[1:])))
        return of_maps, of_uv, None, None, None, None


def _packed(found: ctypes.CDLL, maps: Tensor, tiles: bool) -> Tensor:
    packed = maps.new_empty(_packed_size(maps))
    call(found, "pack", maps, packed, *maps.shape, tiles)
    return packed
