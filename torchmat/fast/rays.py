"""Rays over a height field by the compiled part, without gradients."""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat.fast.call import call, fits, wants_gradient
from torchmat.fast.switch import library


def first_roots(height: Tensor, uv: Tensor, slope: Tensor, low: float, high: float, refinements: int, tiles: bool) -> Tensor | None:
    """Return the largest z at which the surface at uv + z slope reaches z, [N, 1, h, w]; None where that is for plain torch.

    `height` [1, H, W] lies between `low` and `high`; `uv` [N, 2, h, w], `slope` [N, 2, 1 or h, 1 or w].
    """
    found = library()
    if found is None or not fits(height, uv, slope):
        return None
    arrays = _arrays(height, uv, slope, tiles)
    root = height.new_empty(len(uv), 1, *uv.shape[2:])
    call(
        found, "first_roots", *arrays, root, *_sizes(*arrays[1:], root), *height.shape[1:], float(low), float(high), refinements, tiles,
    )
    return root


def clearances(
    height: Tensor, uv: Tensor, slope: Tensor, span: float, shortest: float, tiles: bool, with_rise: bool
) -> tuple[Tensor, Tensor | None] | None:
    """Return by how much rays from the surface miss it, [N, 1, h, w]; None where that is for plain torch, or for gradients.

    With the height over their start at which they do, with `with_rise`, and then no more than the surface counts. `span` is how
    high the surface is at most above its lowest point, `shortest` the least run for each unit of height.
    """
    found = library()
    if found is None or not fits(height, uv, slope) or wants_gradient(height, uv, slope):
        return None
    arrays = _arrays(height, uv, slope, tiles)
    least = height.new_empty(len(uv), 1, *uv.shape[2:])
    rise = torch.empty_like(least) if with_rise else None
    call(
        found, "clearances", *arrays, least, rise, *_sizes(*arrays[1:], least), *height.shape[1:], float(span), float(height.max()),
        float(shortest), tiles,
    )
    return least, rise


def _arrays(height: Tensor, uv: Tensor, slope: Tensor, tiles: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Return the height that goes on by two texels, uv of one or of all, and slopes of one ray a direction or of all."""
    rows, columns = (torch.arange(size + 2) for size in height.shape[1:])
    if tiles:
        rows, columns = rows % height.shape[1], columns % height.shape[2]
    else:
        rows, columns = rows.clamp(max=height.shape[1] - 1), columns.clamp(max=height.shape[2] - 1)
    wide = height.detach()[0][rows][:, columns].contiguous()
    uv = uv.detach()
    places = uv[:1] if uv.stride(0) == 0 else uv
    slope = slope.detach()
    if slope.shape[2:] != (1, 1):
        slope = slope.expand(-1, -1, *uv.shape[2:])
    return wide, places.contiguous(), slope.contiguous()


def _sizes(uv: Tensor, slope: Tensor, out: Tensor) -> tuple[int, int, int, int]:
    return len(out), len(uv), slope.shape[2] * slope.shape[3], out.shape[2] * out.shape[3]
