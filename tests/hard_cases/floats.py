"""Floats to sweep a function over: from the smallest subnormal to the largest, both signs, zero, and around kinks."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

_BITS = {torch.float32: (np.float32, np.int32), torch.float64: (np.float64, np.int64)}


def ordinals(values: np.ndarray) -> np.ndarray:
    """Return whole numbers that count floats from zero, in their order: neighbours differ by 1."""
    whole = {np.dtype(np.float32): np.int32, np.dtype(np.float64): np.int64}[values.dtype]
    bits = values.view(whole).astype(np.int64)
    lowest = np.int64(np.iinfo(whole).min)
    return np.where(bits < 0, lowest - bits, bits)


def from_ordinals(counts: np.ndarray, dtype: torch.dtype) -> np.ndarray:
    """Return the floats of such numbers."""
    kind, whole = _BITS[dtype]
    lowest = np.int64(np.iinfo(whole).min)
    return np.where(counts < 0, lowest - counts, counts).astype(whole).view(kind)


def neighbours(value: float, dtype: torch.dtype) -> list[float]:
    """Return a value rounded to `dtype` and the floats below and above it."""
    kind = _BITS[dtype][0]
    here = kind(value)
    with np.errstate(all="ignore"):
        found = [np.nextafter(here, kind(-np.inf)), here, np.nextafter(here, kind(np.inf))]
    return [float(one) for one in found if np.isfinite(one)]


def special(dtype: torch.dtype, low: float, high: float, kinks: Sequence[float] = ()) -> np.ndarray:
    """Return zero, the ends of the normal and subnormal range and kinks, within [low, high], with neighbours."""
    info = torch.finfo(dtype)
    smallest = float(from_ordinals(np.array([1]), dtype)[0])
    sizes = [
        smallest,
        info.tiny / 2,
        info.tiny,
        info.eps,
        math.sqrt(info.tiny),
        math.sqrt(info.max),
        info.max,
        1.0,
        1e-30,
        1e-10,
        1e-3,
    ]
    wanted = {0.0, -0.0, low, high}
    for size in (*sizes, *(-size for size in sizes), *kinks):
        wanted.update(neighbours(size, dtype))
    kept = sorted(one for one in wanted if low <= one <= high and math.isfinite(one))
    values = np.array([*kept, -0.0], dtype=_BITS[dtype][0])
    return values if low <= 0 else values[:-1]


def sweep(
    dtype: torch.dtype, count: int, random: np.random.Generator, low: float = -math.inf, high: float = math.inf,
    kinks: Sequence[float] = (),
) -> Tensor:
    """Return `special` floats and about `count` more within [low, high], in random order.

    Half of those are spread over all floats alike, so over all magnitudes; half over the common values.
    """
    kind = _BITS[dtype][0]
    most = float(torch.finfo(dtype).max)
    low, high = max(low, -most), min(high, most)
    first, last = ordinals(np.array([low, high], dtype=kind))
    every = from_ordinals(random.integers(first, last, count // 2, endpoint=True), dtype)
    common = random.uniform(max(low, -4), min(high, 4), count - count // 2) if low < 4 and high > -4 else []
    values = np.concatenate((special(dtype, low, high, kinks), every, np.asarray(common, dtype=kind)))
    random.shuffle(values)
    return torch.from_numpy(values.clip(kind(low), kind(high)))
