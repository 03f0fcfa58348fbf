"""Pictures of a capture's steps, for its page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from torchmat.capturing.page import small
from torchmat.colour import linear_to_srgb

_THUMB = 96  # pixels along the longer side in a contact sheet
_MARK = (0.1, 0.9, 0.3)


def shown(linear: Tensor) -> Tensor:
    """Return linear planes [3, H, W] as display values, the brightest percent at white."""
    bright = float(torch.quantile(linear.flatten()[:: max(1, linear.numel() // 100_000)], 0.99))
    return linear_to_srgb((linear / max(bright, 1e-6)).clamp(0, 1))


def marked(linear: Tensor, pixels: np.ndarray) -> Tensor:
    """Return a photograph as display values, of a page's size, with crosses at pixels [k, 2]."""
    planes = shown(small(linear))
    factor = linear.shape[-1] // planes.shape[-1]
    height, width = planes.shape[-2:]
    for column, row in np.round((pixels + 0.5) / factor - 0.5).astype(int):
        for step in range(-4, 5):
            for x, y in ((column + step, row), (column, row + step)):
                if 0 <= x < width and 0 <= y < height:
                    planes[:, y, x] = torch.tensor(_MARK)
    return planes


def thumb(linear: Tensor) -> Tensor:
    """Return linear planes [3, h, w] as small display values."""
    factor = max(1, -(-max(linear.shape[-2:]) // _THUMB))
    return shown(torch.nn.functional.avg_pool2d(linear[None], factor)[0])


def contact_sheet(thumbs: Sequence[Tensor]) -> Tensor:
    """Return pictures [3, h, w] of one size beside and below each other."""
    columns = int(np.ceil(np.sqrt(len(thumbs))))
    blank = torch.ones_like(thumbs[0])
    rows = [list(thumbs[start : start + columns]) for start in range(0, len(thumbs), columns)]
    return torch.cat([torch.cat([*row, *([blank] * (columns - len(row)))], dim=-1) for row in rows], dim=-2)
