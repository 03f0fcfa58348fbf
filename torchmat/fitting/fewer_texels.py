"""Samples in fewer texels: each the mean of what is known of those that it covers."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.btf import Btf
from torchmat.btf.decode import Decoder
from torchmat.btf.store import CLIPPED, INVALID, VALID, summarise

_BLOCK_VALUES = 8_000_000
_KNOWN = 0.5  # of a texel's area: with less it is unknown


def shrunk_mask(mask: Tensor | None, size: Sequence[int]) -> Tensor | None:
    """Return an object mask [H, W] in `size` (rows, columns): where half of a texel shows the object; None if that is all.

    Where no texel is half object, those count that show any of it.
    """
    if mask is None:
        return None
    share = functional.adaptive_avg_pool2d(mask[None].float(), (size[0], size[1]))[0]
    found = share >= _KNOWN if bool((share >= _KNOWN).any()) else share > 0
    return None if bool(found.all()) else found


def averaged(btf: Btf, rows: Tensor, size: Sequence[int], dtype: torch.dtype) -> Btf:
    """Return samples `rows` [k] in `size` (rows, columns) of texels, averaged in linear light.

    Texels without weight are left out of the means; one clipped value makes its mean count as clipped.
    """
    shape = (size[0], size[1])
    images, flags = [], []
    for part in rows.split(max(1, _BLOCK_VALUES // (3 * btf.height * btf.width))):
        valid = btf.valid(part).to(dtype)
        there = functional.adaptive_avg_pool2d(valid, shape)
        mean = functional.adaptive_avg_pool2d(btf.images(part, dtype) * valid, shape)
        images.append(mean / there.clamp(min=1e-12))
        clipped = functional.adaptive_avg_pool2d(btf.clipped(part).to(dtype), shape) > 0
        flags.append(torch.where(there < _KNOWN, INVALID, torch.where(clipped, CLIPPED, VALID))[:, 0].to(torch.uint8))
    pixels = torch.cat(images).numpy()
    store = summarise(pixels, torch.cat(flags).numpy())
    decoder = Decoder(pixels.dtype, "linear", 1.0)
    near = None if btf.near is None else btf.near.picked(rows).resized(*shape)
    mask = shrunk_mask(btf.mask, size)
    return Btf(store, btf.light[rows], btf.view[rows], decoder, btf.source, btf.clipped_weight, mask=mask, near=near)
