"""Passes over all images of a store, a run at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchmat.btf.decode import Decoder
from torchmat.btf.store import RELEASE_BYTES, PixelStore
from torchmat.machine import give_back
from torchmat.progress import progress

BLOCK_VALUES = 8_000_000  # values of one decoded block: 32 MB in float32, small beside any BTF worth streaming
# Where texels are taken a few rows at a time: so many values of up to so many samples stay in the processor's cache, and
# below the size from which an allocator asks for fresh pages, each of which costs a fault.
BAND_VALUES, BAND_SAMPLES = 1 << 21, 128
_KEPT_BYTES = 31 << 20
_BAND_BYTES = 16_000_000  # of codes that bands pass by before their pages are dropped
_STEP_BYTES = 4 * _BAND_BYTES  # of the file that one step may span


class Block(NamedTuple):
    """A run of consecutive samples.

    `samples` are its indices [k]; `images` [k, 3, H, W] linear; `weight` [k, 1, H, W] in [0, 1], or None when it is
    1 throughout. The tensors are scratch: they may be overwritten, and hold until the next block is asked for.
    """

    samples: range
    images: Tensor
    weight: Tensor | None


def _row_bytes(store: PixelStore) -> int:
    """Return the bytes of the file from one row of texels to the next: pages are read whole, however few of them are wanted."""
    return max(1, abs(store.pixels.strides[2]))


def bands(store: PixelStore, show: bool | None) -> Iterator[range]:
    """Yield runs of rows of texels, whose samples are few values at a time; drops mapped pages behind the pass."""
    count, channels, height, width = store.pixels.shape
    row = _row_bytes(store)
    step = max(1, min(BAND_VALUES // (channels * width * min(count, BAND_SAMPLES)), _STEP_BYTES // (count * channels * row)))
    large = store.pixels.nbytes > RELEASE_BYTES
    if large:
        give_back()  # what was freed before is not to lie beside what is found now
    # glibc gives freed memory back above a bound that grows with what is freed, up to twice 32 MB. Below it each band would be
    # given fresh pages, whose faults take longer than what is computed in them.
    torch.empty(_KEPT_BYTES, dtype=torch.uint8)
    passed = 0
    for top in progress(range(0, height, step), "reading images", show=show):
        yield range(top, min(top + step, height))
        passed += count * channels * step * row
        if passed > _BAND_BYTES:
            store.release(range(count))
            passed = 0
    store.release(range(count))
    if large:
        give_back()


def runs(store: PixelStore, wanted: Tensor | None, most: int | None = None) -> list[range]:
    """Return consecutive runs of at most `most` samples, one block each, without those that hold no sample of `wanted` (bool)."""
    count, channels, height, width = store.pixels.shape
    step = most or max(1, min(BLOCK_VALUES // (channels * height * width), _STEP_BYTES // (channels * height * _row_bytes(store))))
    every = [range(first, min(first + step, count)) for first in range(0, count, step)]
    return [run for run in every if wanted is None or bool(wanted[run.start : run.stop].any())]


def stream_blocks(
    store: PixelStore, decoder: Decoder, weigh: Callable[[range], Tensor | None], wanted: Tensor | None,
    dtype: torch.dtype, show: bool | None, most: int | None = None,
) -> Iterator[Block]:
    """Yield the blocks of `store` in order; `weigh` gives the weights of a run; `show` as in `progress`.

    Mapped pages are dropped behind the pass, so memory stays bounded, unless blocks of `most` samples are asked for: those are
    of a band, behind which `bands` does. Decoding uses all cores as it is: a thread that
    decodes ahead was measured to take a third longer, since both then fight for them.
    """
    order = runs(store, wanted, most)
    buffer = torch.empty(max(map(len, order), default=0), *store.pixels.shape[1:], dtype=dtype)
    for run in progress(order, "reading images", show=show):
        codes = np.ascontiguousarray(store.pixels[run.start : run.stop])
        yield Block(run, decoder.into(codes, buffer[: len(run)]), weigh(run))
        if most is None:
            store.release(run)
