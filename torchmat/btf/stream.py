"""Passes over all images of a store, a run at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchmat.btf.decode import Decoder
from torchmat.btf.store import PixelStore
from torchmat.progress import progress

BLOCK_VALUES = 8_000_000  # values of one decoded block: 32 MB in float32, small beside any BTF worth streaming


class Block(NamedTuple):
    """A run of consecutive samples.

    `samples` are its indices [k]; `images` [k, 3, H, W] linear; `weight` [k, 1, H, W] in [0, 1], or None when it is
    1 throughout. The tensors are scratch: they may be overwritten, and hold until the next block is asked for.
    """

    samples: range
    images: Tensor
    weight: Tensor | None


def runs(store: PixelStore, wanted: Tensor | None) -> list[range]:
    """Return consecutive runs of samples, one block each, without those that hold no sample of `wanted` (bool)."""
    count, channels, height, width = store.pixels.shape
    step = max(1, BLOCK_VALUES // (channels * height * width))
    every = [range(first, min(first + step, count)) for first in range(0, count, step)]
    return [run for run in every if wanted is None or bool(wanted[run.start : run.stop].any())]


def stream_blocks(
    store: PixelStore, decoder: Decoder, weigh: Callable[[range], Tensor | None], wanted: Tensor | None,
    dtype: torch.dtype, show: bool | None,
) -> Iterator[Block]:
    """Yield the blocks of `store` in order; `weigh` gives the weights of a run; `show` as in `progress`.

    Mapped pages are dropped behind the pass, so memory stays bounded. Decoding uses all cores as it is: a thread that
    decodes ahead was measured to take a third longer, since both then fight for them.
    """
    order = runs(store, wanted)
    buffer = torch.empty(max(map(len, order), default=0), *store.pixels.shape[1:], dtype=dtype)
    for run in progress(order, "reading images", show=show):
        codes = np.ascontiguousarray(store.pixels[run.start : run.stop])
        yield Block(run, decoder.into(codes, buffer[: len(run)]), weigh(run))
        store.release(run)
