"""Photographs as a camera took them: what their files say of the camera, and their pixels in the frame of its sensor."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchmat.capturing.develop import Developed, develop, said_of
from torchmat.images import Exif

# Quarter turns, counterclockwise, from the picture as it is shown to the sensor's, by EXIF orientation. Mirrored ones are no camera's.
_TURNS = {1: 0, 2: 0, 3: 2, 4: 2, 5: 1, 6: 1, 7: 3, 8: 3}
_GREY = (0.2126, 0.7152, 0.0722)
_BRIGHT, _DARK = 0.8, 0.4  # what the brightest percent is brought to in a picture for finding the board, where it is darker than that


@dataclass(frozen=True, eq=False)
class Photograph:
    """One photograph.

    Args:
        path: its file, of a merged bracket that of the exposure that names it.
        size: width and height in pixels, in the frame of the sensor: a camera that was held upright has it as one that was not.
        turns: quarter turns, counterclockwise, from the picture as it is shown to the sensor's frame.
        exif: what the file says of camera and exposure.
        read: develops it: its pixels as they are shown, linear, and which of them are clipped.
    """

    path: Path
    size: tuple[int, int]
    turns: int
    exif: Exif
    read: Callable[[], Developed]

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    def developed(self) -> Developed:
        """Return the pixels, and which of them are clipped, in the frame of the sensor."""
        found = self.read()
        linear = torch.rot90(found.linear, self.turns, (1, 2)).contiguous()
        return found._replace(linear=linear, clipped=torch.rot90(found.clipped, self.turns, (0, 1)).contiguous())

    def linear(self) -> Tensor:
        """Return the pixels [3, H, W], float32, linear, in the frame of the sensor."""
        return self.developed().linear


def photograph(path: str | Path, encoding: str = "auto", read: Callable[[], Developed] | None = None) -> Photograph:
    """Return a photograph of a file, raw ones too; `read` where its pixels come from elsewhere, `encoding` as `load_btf` has it.

    Raises DataError, which names the file, where it cannot be opened.
    """
    path = Path(path)
    exif = said_of(path)
    turns = _TURNS[exif.orientation]
    width, height = exif.size
    return Photograph(path, (width, height), turns, exif, read or (lambda: develop(path, encoding)))


def turned_alike(photographs: Sequence[Photograph]) -> list[Photograph]:
    """Return photographs of which those that were turned upright by a program lie as most others of their size do.

    Such a file no longer says how its camera was held. A quarter turn counterclockwise is taken: the other one differs from it in the
    principal point and the tangential distortion alone, which are small.
    """
    counted = Counter(one.size for one in photographs)
    found = []
    for one in photographs:
        width, height = one.size
        if counted[height, width] > counted[one.size] or (counted[height, width] == counted[one.size] and width < height):
            one = Photograph(one.path, (height, width), (one.turns + 1) % 4, one.exif, one.read)
        found.append(one)
    return found


def grey_codes(linear: Tensor) -> np.ndarray:
    """Return a picture [H, W] of 8-bit codes in which a board is looked for; what is dark is brightened."""
    grey = torch.einsum("c,chw->hw", linear.new_tensor(_GREY), linear).clamp_(min=0)
    bright = float(torch.quantile(grey.flatten()[:: max(1, grey.numel() // 100_000)], 0.99))
    if 0 < bright < _DARK:
        grey = grey * (_BRIGHT / bright)
    grey = grey.clamp_(max=1)
    return (grey.pow_(1 / 2.2) * 255).round_().to(torch.uint8).numpy()
