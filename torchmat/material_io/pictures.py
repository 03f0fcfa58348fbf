"""Maps as the codes of pictures that other programs read, and what those codes stand for."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchmat import colour
from torchmat.errors import check_option
from torchmat.images import read_image, write_image

DEPTHS = (8, 16)
_CACHED = 200_000  # values


def codes_of(planes: Tensor, depth: int, coded: bool = False) -> np.ndarray:
    """Return maps [C, H, W] of values in [0, 1] as codes [H, W, C]; what lies outside is brought to the nearer end.

    With `coded` the first three channels are colours, which pictures hold sRGB-encoded; a fourth is linear.
    """
    check_option("export", "depth", depth, DEPTHS)
    planes, most = planes.detach().float(), 2**depth - 1
    found = np.empty((*planes.shape[1:], len(planes)), np.uint8 if depth == 8 else np.uint16)
    for rows in _bands(planes.shape[1], planes[:, :1].numel()):
        values = planes[:, rows].clamp(0, 1)
        if coded:
            values = torch.cat((colour.linear_to_srgb(values[:3]), values[3:]))
        found[rows] = values.mul(most).round_().clamp_(0, most).movedim(0, -1).numpy()
    return found


def _bands(rows: int, values: int) -> list[slice]:
    """Return runs of rows, of `values` each, that stay in the processor's cache."""
    step = max(1, _CACHED // max(values, 1))
    return [slice(top, min(top + step, rows)) for top in range(0, rows, step)]


def values_of(codes: np.ndarray, coded: bool = False) -> Tensor:
    """Return the values [C, H, W], float32, of codes [H, W, C], the counterpart of `codes_of`."""
    most = np.iinfo(codes.dtype).max if np.issubdtype(codes.dtype, np.integer) else 1
    channels = max(3, codes.shape[2]) if coded else codes.shape[2]
    found = torch.empty(channels, *codes.shape[:2])
    for rows in _bands(codes.shape[0], codes[:1].size):
        planes = torch.from_numpy(codes[rows].astype(np.float32)).movedim(-1, 0) / most
        if coded:
            first = planes[:3] if len(planes) >= 3 else planes[:1].expand(3, -1, -1)
            planes = torch.cat((colour.srgb_to_linear(first), planes[3:]))
        found[:, rows] = planes
    return found


def normal_codes(normal: Tensor, depth: int, flip: bool = False) -> np.ndarray:
    """Return unit normals [3, H, W] as codes that span -1..1; `flip` is DirectX's, whose green points down.

    Rounded to even codes about the middle: a flat normal's x and y are 0 to half a code alone.
    """
    turned = normal * torch.tensor([1.0, -1.0 if flip else 1.0, 1.0], dtype=normal.dtype)[:, None, None]
    return codes_of(turned / 2 + 0.5, depth)


def png_bytes(codes: np.ndarray) -> bytes:
    """Return codes [H, W, C] as the bytes of a PNG."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "codes.png"
        write_image(path, codes)
        return path.read_bytes()


def codes_of_bytes(data: bytes, suffix: str, where: str) -> np.ndarray:
    """Return the codes [H, W, C] of a PNG's or JPEG's bytes; errors of reading them name `where`."""
    from torchmat.errors import DataError

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"picture{suffix}"
        path.write_bytes(data)
        try:
            return read_image(path)
        except DataError as error:
            raise DataError(str(error).replace(str(path), where)) from error
