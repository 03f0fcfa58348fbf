"""A material in ever smaller copies, so that a texture seen from afar is filtered and does not sparkle."""

from __future__ import annotations

from typing import Any, Protocol

import torch
from torch import Tensor

from torchmat.models import Material
from torchmat.models.edit import resampled, resized


class Shader(Protocol):
    """What can be rendered: a Material, a Brdf, or measured images."""

    @property
    def dtype(self) -> torch.dtype:
        """The precision of its values and of the directions that it takes."""

    def shade_at(self, uv: Tensor, light: Tensor, view: Tensor) -> Tensor:
        """Return the value [..., 3, h, w] at texture coordinates `uv` [2, h, w], as `Material.shade_at` does."""


def _halved(shader: Any, gradient: bool) -> Shader:
    if isinstance(shader, Material):
        height, width = shader.size
        return (resampled if gradient else resized)(shader, (max(1, (height + 1) // 2), max(1, (width + 1) // 2)))
    return shader.halved()


class Pyramid:
    """A shader and its copies of half the size, a quarter ..., each made when it is first needed.

    With `gradient` gradients pass through the copies to the shader's own maps.
    """

    def __init__(self, shader: Shader, gradient: bool = False) -> None:
        self.levels, self.gradient = [shader], gradient
        self.size: tuple[int, int] = getattr(shader, "whole_size", getattr(shader, "size", (1, 1)))
        # Halves are rounded up: 5 texels become 3, 2, 1.
        self._count = (max(self.size) - 1).bit_length() + 1 if self._shrinks(shader) else 1

    @staticmethod
    def _shrinks(shader: Shader) -> bool:
        return isinstance(shader, Material) or hasattr(shader, "halved")

    @property
    def dtype(self) -> torch.dtype:
        """The precision of the shader."""
        return self.levels[0].dtype

    def level_of(self, footprint: Tensor) -> Tensor:
        """Return the level, a fraction, at which a texel is as wide as `footprint` (in textures)."""
        texels = (footprint * max(self.size)).clamp(min=1e-30)
        return torch.log2(texels).clamp(0, self._count - 1)

    def at_level(self, level: int) -> Shader:
        """Return the shader of level 0 (full size), 1 (half) ..."""
        while len(self.levels) <= level:
            with torch.set_grad_enabled(self.gradient):
                self.levels.append(_halved(self.levels[-1], self.gradient))
        return self.levels[level]

    def parts(self, footprint: Tensor) -> list[tuple[Shader, Tensor | slice, Tensor | None]]:
        """Return (shader, which points, their weight) whose weighted values add up to each point's value.

        Points [P] of up to a texel's footprint take the full size; others blend the two levels between which they lie.
        """
        if self._count == 1 or not len(footprint):
            return [(self.levels[0], slice(None), None)]
        level = self.level_of(footprint)
        if not bool((level > 0).any()):
            return [(self.levels[0], slice(None), None)]
        lower = level.floor()
        share = level - lower
        found: list[tuple[Shader, Tensor | slice, Tensor | None]] = []
        for step in range(int(lower.max()) + 2):
            weight = torch.where(lower == step, 1 - share, torch.where(lower == step - 1, share, 0))
            which = (weight > 0).nonzero()[:, 0]
            if len(which):
                found.append((self.at_level(step), which, weight[which]))
        return found
