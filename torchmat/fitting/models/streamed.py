"""The least squares of all texels: one pass over the images, a few rows of texels at a time.

All texels share the design matrix, so the right-hand sides are one streamed matrix product. Only texels with samples
of reduced weight get normal equations of their own. A band of rows is small enough for all its samples to stay in the
processor's cache: image by image, the sums of all texels would be read and written again for each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat.btf.btf import Btf
from torchmat.repeatable import add_product, product, wide_product
from torchmat.solvers.least_squares import DETERMINED, Design, solve_masked

Encode = Callable[[Tensor], Tensor]
_TEXELS = 16384  # solved at a time: their normal matrices are the largest tensors


@dataclass(frozen=True)
class Moments:
    """Sums over the used samples: `product` [rank, 3, H, W] of basis times value, and each image's mean [sample, 3]."""

    product: Tensor
    means: Tensor


def stream_moments(
    btf: Btf, design: Design, used: Tensor, dtype: torch.dtype = torch.float32, progress: bool | None = False,
    encode: Encode | None = None,
) -> Moments:
    """Make the one pass over the images of `btf` that a linear fit needs; `encode` makes of them what is fitted."""
    product = torch.empty(design.rank, 3, btf.height, btf.width, dtype=dtype)
    means, share = torch.zeros(len(btf), 3, dtype=torch.float64), torch.zeros(len(btf), 1, dtype=torch.float64)
    coded, encode = _coded(btf, encode, dtype)
    for rows, band in coded.bands(progress):
        product[:, :, rows] = _products(band, design, used, dtype, encode, (means, share))
    return Moments(product, means / share.clamp(min=1e-12))


def _coded(
    btf: Btf, encode: Encode | None, dtype: torch.dtype
) -> tuple[Btf, Encode | None]:
    """Return images and what is left to do to them: codes that are looked up in a table can be looked up encoded."""
    coded = None if encode is None or dtype != torch.float32 else btf.through(encode)
    return (btf, encode) if coded is None else (coded, None)


def _products(
    band: Btf, design: Design, used: Tensor, dtype: torch.dtype, encode: Encode | None,
    sums: tuple[Tensor, Tensor] | None = None,
) -> Tensor:
    """Return the sums [rank, 3, h, w] of basis times value of a band; adds those of each image's values and weights to `sums`."""
    basis = design.left.to(dtype)
    total = torch.zeros(design.rank, 3 * band.height * band.width, dtype=dtype)
    for block in band.blocks(used, dtype, band=True):
        rows = slice(block.samples.start, block.samples.stop)
        images = block.images if encode is None else encode(block.images)
        images = images if block.weight is None else images.mul_(block.weight.to(dtype))
        if sums is not None:
            texels = band.height * band.width
            share = torch.full((1, 1), float(texels)) if block.weight is None else block.weight.sum(dim=(2, 3))
            mean = images.mean(dim=(2, 3)) if block.weight is None else images.sum(dim=(2, 3)) / share.clamp(min=1e-12)
            sums[0][rows] += mean.double() * share.double()
            sums[1][rows] += share.double()
        add_product(total, basis[rows], images.flatten(1))
    return total.unflatten(1, (3, band.height, band.width))


def stream_means(btf: Btf, used: Tensor, texels: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
    """Return each used image's mean [sample, 3] over some `texels` (bool [H, W])."""
    means = torch.zeros(len(btf), 3, dtype=torch.float64)
    for block in btf.blocks(used, dtype):
        share = texels.to(dtype) if block.weight is None else texels * block.weight
        total = share.sum(dim=(-2, -1)).clamp(min=1e-12)
        mean = (block.images * share).sum(dim=(2, 3)) / total
        means[block.samples.start : block.samples.stop] = mean.double()
    return means


@dataclass(frozen=True)
class Deficit:
    """What reduced weights take away from the shared normal equations, for the texels that have any.

    `texels` [t] flat indices; `normal` [t, rank, rank]; `offset` [t, rank, 3] the same for the part of the values that
    is already explained.
    """

    texels: Tensor
    normal: Tensor
    offset: Tensor


def stream_deficit(btf: Btf, design: Design, used: Tensor, explained: Tensor) -> Deficit | None:
    """Sum (1 - weight) over the used samples; None when every weight is 1. Reads weights only, no images.

    `explained` [sample, 3] is what every texel shares (a global lobe).
    """
    rank, texels = design.rank, btf.height * btf.width
    row, column = torch.triu_indices(rank, rank)
    pairs = design.basis[:, row] * design.basis[:, column]
    offsets = (design.left[:, :, None] * explained.double()[:, None, :]).flatten(1)
    columns = torch.cat((pairs, offsets), dim=1)
    total, touched = None, torch.zeros(texels, dtype=torch.bool)
    for samples, weight in btf.weight_blocks(used):
        rows = slice(samples.start, samples.stop)
        weight = weight[:, 0].flatten(1)
        if total is None:
            total = torch.zeros(columns.shape[1], texels, dtype=torch.float64)
        hit = (weight if bool(used[rows].all()) else weight[used[rows]]).amin(dim=0) < 1
        touched |= hit
        part = torch.zeros(len(total), int(hit.sum()), dtype=torch.float64)
        add_product(part, columns[rows], (1 - weight[:, hit].double()) * used[rows, None])
        total[:, hit] += part
    if total is None or not bool(touched.any()):
        return None
    where = touched.nonzero()[:, 0]
    total = total[:, where]
    normal = torch.zeros(len(where), rank, rank, dtype=torch.float64)
    normal[:, row, column] = total[: len(row)].T
    normal[:, column, row] = total[: len(row)].T
    return Deficit(where, normal, total[len(row) :].T.unflatten(1, (rank, 3)))


@dataclass(frozen=True)
class LinearFit:
    """`coefficients` [K, 3, H, W], and `coverage` [1, H, W]: the share of the K unknowns that the samples determine.

    Where the coverage is below 1, coefficients are those of minimum norm, or rest on clipped samples alone.
    """

    coefficients: Tensor
    coverage: Tensor


def fit_bands(
    btf: Btf, design: Design, used: Tensor, dtype: torch.dtype = torch.float32, progress: bool | None = False,
    encode: Encode | None = None,
) -> LinearFit:
    """Return the least-squares coefficients of every texel, solved as its samples pass: nothing but them is kept."""
    coded, encode = _coded(btf, encode, dtype)
    found = _Found(btf, design, dtype)
    for rows, band in coded.bands(progress):
        found.add(rows, _solve_band(band, design, _products(band, design, used, dtype, encode), used, None))
    return found.fit


def solve_texels(
    btf: Btf, design: Design, moments: Moments, used: Tensor, explained: Tensor | None = None, reuse: bool = False
) -> LinearFit:
    """Return the least-squares coefficients of every texel for values minus `explained` [sample, 3].

    With `reuse` they take the place of the sums in memory, where they are as many: `moments` is of no use then.
    """
    if explained is not None:
        explained = torch.where(used[:, None], explained.double(), torch.zeros((), dtype=torch.float64))
    place = moments.product if reuse and design.rank == design.terms else None
    found = _Found(btf, design, moments.product.dtype, place)
    for rows, band in btf.bands():
        found.add(rows, _solve_band(band, design, moments.product[:, :, rows], used, explained))
    return found.fit


class _Found:
    """What is found of all texels, band by band: coefficients in `place`, if it is given, and coverage, held once where it is one number."""

    def __init__(self, btf: Btf, design: Design, dtype: torch.dtype, place: Tensor | None = None) -> None:
        self._size = (btf.height, btf.width)
        self._coefficients = torch.empty(design.terms, 3, *self._size, dtype=dtype) if place is None else place
        self._coverage: Tensor | None = None
        self._usual = design.rank / design.terms

    def add(self, rows: slice, band: LinearFit) -> None:
        self._coefficients[:, :, rows] = band.coefficients
        if self._coverage is None and not bool((band.coverage == self._whole()[:, :1, :1]).all()):
            self._coverage = self._whole().contiguous()
        if self._coverage is not None:
            self._coverage[:, rows] = band.coverage

    def _whole(self) -> Tensor:
        return torch.full((1, 1, 1), self._usual).expand(1, *self._size)

    @property
    def fit(self) -> LinearFit:
        return LinearFit(self._coefficients, self._whole() if self._coverage is None else self._coverage)


def _solve_band(btf: Btf, design: Design, sums: Tensor, used: Tensor, explained: Tensor | None) -> LinearFit:
    """Return the coefficients of the few texels of `btf` from their sums [rank, 3, h, w]."""
    dtype, target = sums.dtype, sums
    if explained is None:
        explained = torch.zeros(len(btf), 3, dtype=torch.float64)
    else:
        target = sums - product(design.left.T, explained)[:, :, None, None].to(dtype)
    coefficients = wide_product(design.to_coefficients.to(dtype), target.flatten(1)).unflatten(1, target.shape[1:])
    coverage = torch.full((1, btf.height, btf.width), design.rank / design.terms)
    deficit = stream_deficit(btf, design, used, explained)
    if deficit is not None:
        # What only clipped samples tell has at most their weight's share of the full information.
        # Weights are float32: all samples clipped must not count as just above it.
        floor = max(DETERMINED, btf.clipped_weight * (1 + 1e-5) if btf.may_clip else 0.0)
        flat, ranks = coefficients.flatten(2), coverage.flatten()
        for part in torch.arange(len(deficit.texels)).split(_TEXELS):
            texels = deficit.texels[part]
            right = target.flatten(2)[:, :, texels].permute(2, 0, 1).double() + deficit.offset[part]
            solved, rank = solve_masked(design, deficit.normal[part], right, floor)
            flat[:, :, texels] = solved.permute(1, 2, 0).to(dtype)
            ranks[texels] = (rank / design.terms).float()
        coefficients, coverage = flat.unflatten(2, (btf.height, btf.width)), ranks.reshape(coverage.shape)
    return LinearFit(coefficients, coverage)
