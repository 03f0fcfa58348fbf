"""Whether a surface repeats at its borders: asked of its images, where nobody says so."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from torchmat.errors import RangeError, message

AUTO_TILES: Literal["auto"] = "auto"
# Textures that are made to repeat reach 0.3 to 1.3 (a JPEG of leather), what was cut out of a larger surface 2 and more,
# a disk 4: measured on sets of five vendors and their halves, the reference BTFs and the wallpaper of Bonn 2003.
LARGEST_SEAM = 1.5
# The border of such a texture varies 0.4 as much as its inside and more, that of a lion's head on grey paper 0.2, that of
# a cat before black 0.01.
LEAST_BORDER = 0.3


class Tiling(NamedTuple):
    """Whether a surface repeats, and what says so.

    Args:
        repeats: whether it does.
        seam: root mean square step across its border, from the last row or column to the first, in units of the largest
            such step between neighbours within; of rows and columns the larger.
        border: how much its outermost rows and columns vary along themselves, in units of those within; the largest of
            the four.
        masked: whether an object mask leaves texels out, so that what is left is no texture to lay side by side.
    """

    repeats: bool
    seam: float
    border: float
    masked: bool = False

    def sentence(self) -> str:
        """Return what was decided, with its figure."""
        if self.masked:
            return "it does not repeat: an object mask cuts it out"
        if self.seam > LARGEST_SEAM:
            return f"it does not repeat: the step across its border is {self.seam:.2f} of the largest inside"
        if not self.repeats:
            return f"it does not repeat: its border is even, as a background is ({self.border:.2f} of what varies inside)"
        return f"it repeats: the step across its border is {self.seam:.2f} of the largest inside"

    def report(self) -> dict[str, Any]:
        """Return the figures of a report."""
        return {name: value for name, value in self._asdict().items() if name != "masked" or value}


def check_tiles(where: str, tiles: object) -> None:
    """Raise RangeError unless `tiles` is True, False or "auto"."""
    if not isinstance(tiles, bool) and tiles != AUTO_TILES:
        step = "auto asks the images."
        raise RangeError(message(where, "tiles", "be true, false or auto", f"it is {tiles!r}", step))


def tiling_of(images: Tensor | Iterable[Tensor]) -> Tiling:
    """Return whether the surface that images [n, C, H, W], or several such blocks of one size, show repeats.

    It does when the step across its border is no larger than 1.5 of the largest between neighbours within, along rows and
    columns both, unless its border is even where its inside is not: that is an object before a background. What says
    nothing, an even picture, repeats.
    """
    steps: list[Tensor] = []  # mean squares, [W] and [H], the last one across the border
    spread: list[Tensor] = []  # along each column [W] and row [H]
    for block in (images,) if isinstance(images, Tensor) else images:
        grey = block.detach().mean(dim=1, dtype=torch.float64)
        for number, lines in enumerate((grey, grey.mT)):  # [n, along, which]
            step = lines.roll(-1, -1).sub_(lines).square_().sum(dim=(0, 1))
            varies = lines.var(dim=1, correction=0).sum(dim=0)
            if len(steps) < 2:
                steps.append(step)
                spread.append(varies)
            else:
                steps[number] = steps[number] + step
                spread[number] = spread[number] + varies
    seam = max(_share(step[-1:], step[:-1]) for step in steps)
    border = max(_share(torch.stack([varies[0], varies[-1]]), varies.mean()[None]) for varies in spread)
    inside = max(float(varies.max()) for varies in spread)
    even = border < LEAST_BORDER and inside > 0
    return Tiling(seam <= LARGEST_SEAM and not even, seam, border)


def _share(values: Tensor, within: Tensor) -> float:
    """Return the largest of `values` in units of the largest within, as roots; 0 where both are 0."""
    largest, unit = float(values.max()), float(within.max()) if within.numel() else 0.0
    if unit == 0:
        return 0.0 if largest == 0 else float("inf")
    return (largest / unit) ** 0.5
