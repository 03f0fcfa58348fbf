"""The stored codes of a BTF, in memory or mapped from a file, and which of them count."""

from __future__ import annotations

import mmap
from dataclasses import dataclass

import numpy as np

# Flag codes of a sample. Zero means valid, so that an untouched (sparse) file of flags means "all valid".
VALID, CLIPPED, INVALID = 0, 1, 2
_RELEASE_BYTES = 256_000_000  # a smaller store stays mapped: faulting its pages in again costs more than it saves


@dataclass
class PixelStore:
    """The stored codes of all images, in memory or mapped from a file.

    `pixels` [sample, 3, H, W] in any decodable type; `flags` [sample, H, W] uint8 of VALID, CLIPPED, INVALID, or None
    when every sample is valid; `clipped` and `invalid` [sample] count the flagged texels of each image; `low` and
    `high` [sample] are the smallest and largest code.
    """

    pixels: np.ndarray
    flags: np.ndarray | None
    clipped: np.ndarray
    invalid: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def release(self, samples: range) -> None:
        """Drop the mapped pages of `samples` from memory, so that a pass over a large file leaves no trace of itself."""
        for array in (self.pixels, self.flags):
            mapped = getattr(array, "_mmap", None)
            if mapped is None or array.nbytes <= _RELEASE_BYTES or not hasattr(mmap, "MADV_DONTNEED"):
                continue
            row = array.nbytes // len(array)
            first = samples.start * row // mmap.PAGESIZE * mmap.PAGESIZE  # advice is given for whole pages
            mapped.madvise(mmap.MADV_DONTNEED, first, samples.stop * row - first)


def summarise(pixels: np.ndarray, flags: np.ndarray) -> PixelStore:
    """Make a PixelStore of codes [sample, 3, H, W] and flags [sample, H, W], with its counts and ranges."""
    clipped = (flags == CLIPPED).sum(axis=(1, 2))
    invalid = (flags == INVALID).sum(axis=(1, 2))
    kept = flags if (clipped.any() or invalid.any()) else None
    return PixelStore(pixels, kept, clipped, invalid, pixels.min(axis=(1, 2, 3)), pixels.max(axis=(1, 2, 3)))
