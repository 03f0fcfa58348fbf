"""The training images as a matrix, image by image, and the leading directions of such a matrix: what factorisations are made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from torchmat import safe
from torchmat.errors import FitError, RangeError, message
from torchmat.fitting.models.streamed import Encode
from torchmat.fitting.training import Training
from torchmat.repeatable import one_thread, orthonormal

OVERSAMPLING = 10  # extra directions of the random projection (Halko, Martinsson, Tropp 2011)
_POWER_STEPS = 2
_KEEP_VALUES = 64_000_000  # training images up to this many values (256 MB) are decoded once and kept
_LEAST_COUNT = 1e-6  # of the mean


class ImageMatrix:
    """The training images as a matrix, in runs of rows; samples of weight 0 hold their texel's mean.

    Clipped samples stay as they are: a factorisation has no weights, and the mean would put out their highlights.
    `encode` makes of the images what the matrix holds; images that are few are kept unless `keep` is false.
    """

    def __init__(self, training: Training, keep: bool = True, encode: Encode | None = None) -> None:
        self.training = training
        self._encode = encode if encode is not None else lambda images: images
        self.rows = training.used.nonzero()[:, 0]
        counts = None if training.importance is None else training.importance[self.rows]
        # What counts nothing is still divided by: it stays below what a float of the others holds.
        self._root = None if counts is None else counts.clamp(min=_LEAST_COUNT).sqrt().to(training.dtype)
        btf = training.btf
        self.texels = btf.height * btf.width
        self._mean = self._texel_mean() if btf.mask is not None or btf.invalid_share > 0 or btf.clipped_share > 0 else None
        small = keep and len(self.rows) * 3 * self.texels <= _KEEP_VALUES
        self._kept = [(s, images.clone()) for s, images in self._read()] if small else None

    def _texel_mean(self) -> Tensor:
        total = torch.zeros(3, self.training.btf.height, self.training.btf.width, dtype=torch.float64)
        weight = torch.zeros(1, *total.shape[1:], dtype=torch.float64)
        for block in self.training.btf.blocks(self.training.used, self.training.dtype, self.training.progress):
            used = self.training.used[block.samples.start : block.samples.stop, None, None, None]
            share = used * (torch.ones(1, 1, 1, 1) if block.weight is None else block.weight)
            total += (self._encode(block.images) * share).sum(dim=0)
            weight += share.sum(dim=0).expand_as(weight)
        return safe.divide(total, weight.expand_as(total)).to(self.training.dtype)

    def _read(self) -> Iterator[tuple[slice, Tensor]]:
        start = 0
        for block in self.training.btf.blocks(self.training.used, self.training.dtype, self.training.progress):
            used = self.training.used[block.samples.start : block.samples.stop]
            images = self._encode(block.images)
            if block.weight is not None:
                assert self._mean is not None
                images = torch.where(block.weight > 0, images, self._mean)
            images = images[used]
            if self._root is not None:
                images = images * self._root[start : start + len(images), None, None, None]
            yield slice(start, start + len(images)), images
            start += len(images)

    def plain(self, table: Tensor) -> Tensor:
        """Return a table [sample, ...] of the matrix as that of the images, whose rows were not weighed."""
        return table if self._root is None else table / self._root.reshape(-1, *[1] * (table.ndim - 1))

    def weighed(self, table: Tensor) -> Tensor:
        """Return a table [sample, ...] of the images as that of the matrix, the reverse of `plain`."""
        return table if self._root is None else table * self._root.reshape(-1, *[1] * (table.ndim - 1))

    def runs(self) -> Iterator[tuple[slice, Tensor]]:
        """Yield (rows of the matrix, images [k, 3, texels]); with `importance` a row is weighed by its root."""
        for rows, images in self._kept if self._kept is not None else self._read():
            yield rows, images.flatten(2)


def range_finder(
    times: Callable[[Tensor], Tensor], transposed: Callable[[Tensor], Tensor], columns: int, rank: int,
    generator: torch.Generator, dtype: torch.dtype,
) -> tuple[Tensor, Tensor]:
    """Return an orthonormal range [rows, r] of a matrix given by its products, and range^T matrix, [r, columns]."""
    probe = torch.randn(columns, rank, generator=generator, dtype=dtype)
    found = orthonormal(times(probe))
    for _ in range(_POWER_STEPS - 1):
        found = orthonormal(times(orthonormal(transposed(found))))
    return found, transposed(found).T


def leading(matrix: Tensor, count: int) -> Tensor:
    """Return the leading left singular vectors [r, count] of a wide matrix [r, n], by QR of its transpose."""
    with one_thread():
        triangle = torch.linalg.qr(matrix.T, mode="r").R
        return torch.linalg.svd(triangle.T.double()).U[:, :count].to(matrix.dtype)


def require_at_most(name: str, value: int, most: int) -> None:
    """Raise RangeError or FitError unless an option is from 1 to what the data determines."""
    if value < 1:
        raise RangeError(message("fit", name, "be at least 1", f"it is {value}"))
    if value > most:
        step = f"Use at most {most}."
        raise FitError(message("fit", name, "not exceed what the data determines", f"it is {value} of {most}", step))
