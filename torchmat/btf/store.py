"""The stored codes of a BTF, in memory or mapped from a file, and which of them count."""

from __future__ import annotations

import mmap
from dataclasses import dataclass

import numpy as np

# Flag codes of a sample. Zero means valid, so that an untouched (sparse) file of flags means "all valid".
VALID, CLIPPED, INVALID = 0, 1, 2
RELEASE_BYTES = 256_000_000  # a smaller store stays mapped: faulting its pages in again costs more than it saves


_BAND_ROWS = 64  # a window of no more is one of many
_TAKEN_BYTES = 32_000_000  # of a large mapped array are copied before its pages are dropped again


def taken(array: np.ndarray, samples: np.ndarray | slice) -> np.ndarray:
    """Return a copy of some rows of an array, contiguous; of a large mapped one no more than few are in memory beside it."""
    if isinstance(samples, slice):
        samples = np.arange(len(array))[samples]
    found = np.empty((len(samples), *array.shape[1:]), array.dtype)
    step = max(1, _TAKEN_BYTES // max(1, array.strides[0]))
    for first in range(0, len(samples), step):
        rows = samples[first : first + step]
        for place, row in enumerate(rows.tolist(), first):
            found[place] = array[row]
        release(array, range(int(rows.min()), int(rows.max()) + 1))
    return found


def _large(array: np.ndarray) -> bool:
    mapped = getattr(array, "_mmap", None)
    return mapped is not None and len(mapped) > RELEASE_BYTES


def release(array: np.ndarray, samples: range, large: bool | None = None) -> None:
    """Drop the pages of some rows of a mapped array from memory, None where it is large; what was written into a shared map stays in its file."""
    mapped = getattr(array, "_mmap", None)
    if mapped is None or not (_large(array) if large is None else large) or not hasattr(mmap, "MADV_DONTNEED"):
        return
    row = array.strides[0]  # of the whole sample in the file, also where the array shows a window of it
    first = samples.start * row // mmap.PAGESIZE * mmap.PAGESIZE  # advice is given for whole pages
    mapped.madvise(mmap.MADV_DONTNEED, first, samples.stop * row - first)


@dataclass
class PixelStore:
    """The stored codes of all images, in memory or mapped from a file.

    `pixels` [sample, 3, H, W] in any decodable type; `flags` [sample, H, W] uint8 of VALID, CLIPPED, INVALID, or None
    when every sample is valid; `clipped` and `invalid` [sample] count the flagged texels of each image; `low` and
    `high` [sample] are the smallest and largest code, and `checksums` those of codes and flags, None where nobody has
    looked. `pixels` and `flags` may be views of larger arrays.
    """

    pixels: np.ndarray
    flags: np.ndarray | None
    clipped: np.ndarray
    invalid: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    checksums: np.ndarray | None = None

    def release(self, samples: range) -> None:
        """Drop the mapped pages of `samples` from memory, so that a pass over a large file leaves no trace of itself."""
        large = _large(self.pixels)  # flags go with their codes, of which they are a third
        for array in (self.pixels, self.flags):
            if array is not None:
                release(array, samples, large)

    def window(self, rows: slice, columns: slice) -> PixelStore:
        """Return the store of some texels: a view, whose codes are not looked at."""
        pixels = self.pixels[:, :, rows, columns]
        counts = {name: np.zeros_like(getattr(self, name)) for name in ("clipped", "invalid")}
        if self.flags is None:
            return PixelStore(pixels, None, **counts)
        flags = self.flags[:, rows, columns]
        many = rows.stop is None or rows.stop - (rows.start or 0) > _BAND_ROWS  # behind a pass over few rows `bands` releases
        for sample in np.flatnonzero(self.clipped + self.invalid):  # other rows of a flag file are holes, never read
            counts["clipped"][sample] = np.count_nonzero(flags[sample] == CLIPPED)
            counts["invalid"][sample] = np.count_nonzero(flags[sample] == INVALID)
            if many:
                release(self.flags, range(sample, sample + 1))
        return PixelStore(pixels, flags, **counts)

    def picked(self, samples: np.ndarray) -> PixelStore:
        """Return the store of some samples, copied."""
        flags = None if self.flags is None else self.flags[samples]
        ends = {name: None if getattr(self, name) is None else getattr(self, name)[samples] for name in ("low", "high")}
        return PixelStore(self.pixels[samples], flags, self.clipped[samples], self.invalid[samples], **ends)

    def ends(self) -> tuple[float, float]:
        """Return the smallest and the largest code of all images."""
        if self.low is None or self.high is None:
            return self.pixels.min(), self.pixels.max()
        return self.low.min(), self.high.max()


def summarise(pixels: np.ndarray, flags: np.ndarray) -> PixelStore:
    """Make a PixelStore of codes [sample, 3, H, W] and flags [sample, H, W], with its counts and ranges."""
    clipped = (flags == CLIPPED).sum(axis=(1, 2))
    invalid = (flags == INVALID).sum(axis=(1, 2))
    kept = flags if (clipped.any() or invalid.any()) else None
    return PixelStore(pixels, kept, clipped, invalid, pixels.min(axis=(1, 2, 3)), pixels.max(axis=(1, 2, 3)))
