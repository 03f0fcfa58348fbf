"""Directions as the compiled part takes them: of each sample or for all, of each texel or for all."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from torchmat.planes import common_lead


@dataclass(frozen=True)
class Directions:
    """Light and view [n or 1, 3, h, w] of `count` samples, contiguous: h and w are the texels' or 1.

    `lead` is the shape that the samples had.
    """

    planes: tuple[Tensor, Tensor]
    lead: torch.Size
    size: torch.Size

    @classmethod
    def of(cls, light: Tensor, view: Tensor, size: torch.Size) -> Self:
        """Return those of light and view [..., 3, h, w], which broadcast, over maps of `size`."""
        lead = common_lead(light, view)
        return cls((_listed(light, lead), _listed(view, lead)), lead, size)

    @property
    def count(self) -> int:
        """How many samples there are."""
        return math.prod(self.lead)

    @property
    def each_texel(self) -> bool:
        """Whether texels have directions of their own."""
        return any(_places(one) > 1 for one in self.planes)

    @property
    def sizes(self) -> list[int]:
        """How many directions there are and of how many texels, of light and of view."""
        return [size for one in self.planes for size in (len(one), _places(one))]

    def new_value(self) -> Tensor:
        """Return room for a value [..., 3, H, W]."""
        return self.planes[0].new_empty(*self.lead, 3, *self.size)


def _places(direction: Tensor) -> int:
    return direction.shape[-2] * direction.shape[-1]


def _listed(direction: Tensor, lead: torch.Size) -> Tensor:
    alone = math.prod(direction.shape[:-3]) == 1
    whole = direction if alone else direction.expand(*lead, *direction.shape[-3:])
    return whole.detach().reshape(-1, *direction.shape[-3:]).contiguous()
