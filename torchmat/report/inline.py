"""Pictures inside a page: PNG as data URIs, and how large they are shown."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import torch
from torch import Tensor

# Half a second of a short fit's report went into squeezing its pictures: a little larger, they are written five times as fast.
PNG_LEVEL = 1


def data_uri(planes: Tensor, colours: str = "gray", low: float | None = None, high: float | None = None) -> str:
    """Return planes as a PNG data URI: [3, H, W] as display values 0 to 1, [1, H, W] in `colours` from `low` to `high`.

    The ends of a single plane are its least and largest value where they are None.
    """
    from matplotlib.image import imsave

    stream, fast = io.BytesIO(), {"compress_level": PNG_LEVEL}
    if len(planes) == 3:
        pixels = (planes.nan_to_num(0.0).clamp(0, 1) * 255).round().to(torch.uint8)
        imsave(stream, pixels.permute(1, 2, 0).contiguous().numpy(), format="png", pil_kwargs=fast)
    else:
        imsave(stream, planes[0].nan_to_num(0.0).float().numpy(), format="png", cmap=colours, vmin=low, vmax=high, pil_kwargs=fast)
    return _encoded(stream.getvalue())


def file_uri(path: Path) -> str:
    """Return a PNG file as a data URI."""
    return _encoded(path.read_bytes())


def _encoded(content: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(content).decode()}"


def shown_size(height: int, width: int, wanted: int) -> tuple[int, int]:
    """Return the height and width in which a picture is shown: enlarged by the largest whole factor that stays in `wanted`."""
    factor = max(1, wanted // max(height, width))
    return height * factor, width * factor
