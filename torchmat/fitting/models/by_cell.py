"""Means of images for what all texels share, under near lights and cameras: of cells, each seen from its own middle.

A far light's image is one number for a reflectance that all texels have in common: its mean. A near one shines on every part
from elsewhere, so each part has a mean of its own, under the directions at its middle.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.fitting.training import Training

_CELLS = 8  # along each side: a cell of an image 1.3 widths from its light spans 4 degrees
_KNOWN = 1e-6  # of a cell's weight, below which it says nothing


class Cells(NamedTuple):
    """`light`, `view` [m, 3, 1, 1], `values` [m, 3] and what each counts [m], float64; `sample` [m] is the image it is of."""

    light: Tensor
    view: Tensor
    values: Tensor
    importance: Tensor
    sample: Tensor


def cells_of(training: Training, texels: Tensor | None = None) -> Cells:
    """Return the means of the used images over cells of some `texels`, bool [H, W] (None: all)."""
    btf = training.btf
    size = (min(_CELLS, btf.height), min(_CELLS, btf.width))
    placed = btf.of_size(*size)
    parts: list[list[Tensor]] = []
    for block in btf.blocks(training.used, training.dtype, training.progress):
        run = torch.arange(block.samples.start, block.samples.stop)
        kept = training.used[run].nonzero()[:, 0]
        weight = torch.ones(1, 1, btf.height, btf.width, dtype=training.dtype) if block.weight is None else block.weight[kept]
        weight = weight if texels is None else weight * texels
        share = functional.adaptive_avg_pool2d(weight.to(training.dtype), size).expand(len(kept), 1, *size)
        mean = functional.adaptive_avg_pool2d(block.images[kept] * weight, size) / share.clamp(min=1e-12)
        counts = training.counted(share, run[kept])
        light, view = placed.directions(run[kept], torch.float64)
        planes = [light.expand(-1, 3, *size), view.expand(-1, 3, *size), mean, counts, run[kept, None, None, None].expand(-1, 1, *size)]
        parts.append([one.movedim(1, -1).flatten(0, 2) for one in planes])
    light, view, values, counts, sample = (torch.cat(one) for one in zip(*parts, strict=True))
    known = counts[:, 0] > _KNOWN
    light, view = (one[known][:, :, None, None] for one in (light, view))
    return Cells(light, view, values[known].double(), counts[known, 0].double(), sample[known, 0])
