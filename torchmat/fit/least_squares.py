"""Linear least squares over all texels at once: one pass over the images, one small factorisation.

All texels share the design matrix, so the right-hand sides are one streamed matrix product. Only texels with samples
of reduced weight get normal equations of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat.btf.btf import Btf

_TEXELS = 16384  # solved at a time: their normal matrices are the largest tensors


@dataclass(frozen=True)
class Design:
    """A design matrix [sample, K], orthonormalised: ``design = basis @ back``.

    `basis` [sample, rank] has orthonormal columns (rows of samples that do not take part are 0); `to_coefficients`
    [K, rank] is the minimum-norm way back; `back` [rank, K]. Products are summed in the orthonormal basis, where
    float32 does not lose the digits that the squared condition number of the plain normal equations would.
    """

    basis: Tensor
    to_coefficients: Tensor
    back: Tensor

    @property
    def rank(self) -> int:
        """Number of independent columns."""
        return self.basis.shape[1]

    @property
    def terms(self) -> int:
        """Number of columns, K."""
        return self.back.shape[1]


def make_design(matrix: Tensor, used: Tensor) -> Design:
    """Factorise `matrix` [sample, K] over the samples that are `used` (bool); dependent columns are dropped."""
    matrix = torch.where(used[:, None], matrix.double(), torch.zeros((), dtype=torch.float64))
    # Singular vectors are taken of columns of one length, so that the rank does not depend on the terms' units.
    length = matrix.norm(dim=0)
    length = torch.where(length > 0, length, torch.ones_like(length))
    left, singular, right = torch.linalg.svd(matrix / length, full_matrices=False)
    # Directions come in float32; what lies below their rounding is not a column of its own.
    kept = singular > singular.max().clamp(min=1e-300) * 1e-6
    left, singular, right = left[:, kept], singular[kept], right[kept]
    back = singular[:, None] * right * length
    return Design(left, torch.linalg.pinv(back), back)


@dataclass(frozen=True)
class Moments:
    """Sums over the used samples: `product` [rank, 3, H, W] of basis times value, and each image's mean [sample, 3]."""

    product: Tensor
    means: Tensor


def stream_moments(btf: Btf, design: Design, used: Tensor, dtype: torch.dtype = torch.float32) -> Moments:
    """Make the one pass over the images of `btf` that a linear fit needs."""
    basis = design.basis.to(dtype)
    product = torch.zeros(design.rank, 3 * btf.height * btf.width, dtype=dtype)
    means = torch.zeros(len(btf), 3, dtype=torch.float64)
    for block in btf.blocks(used, dtype):
        rows = slice(block.samples.start, block.samples.stop)
        images = block.images
        if block.weight is None:
            means[rows] = images.mean(dim=(2, 3)).double()
        else:
            images = images * block.weight
            total = block.weight.sum(dim=(2, 3))
            means[rows] = (images.sum(dim=(2, 3)) / total.clamp(min=1e-12)).double()
        product.addmm_(basis[rows].T, images.flatten(1))
    return Moments(product.unflatten(1, (3, btf.height, btf.width)), means)


@dataclass(frozen=True)
class Deficit:
    """What reduced weights take away from the shared normal equations, for the texels that have any.

    `texels` [t] flat indices; `normal` [t, rank, rank]; `offset` [t, rank, 3] the same for the part of the values that
    is already explained; `seen` [t] the summed weight of the used samples.
    """

    texels: Tensor
    normal: Tensor
    offset: Tensor
    seen: Tensor


def stream_deficit(btf: Btf, design: Design, used: Tensor, explained: Tensor) -> Deficit | None:
    """Sum (1 - weight) over the used samples; None when every weight is 1. Reads weights only, no images.

    `explained` [sample, 3] is what every texel shares (a global lobe).
    """
    rank, texels = design.rank, btf.height * btf.width
    row, column = torch.triu_indices(rank, rank)
    pairs = design.basis[:, row] * design.basis[:, column]
    offsets = (design.basis[:, :, None] * explained.double()[:, None, :]).flatten(1)
    columns = torch.cat((pairs, offsets, used[:, None].double()), dim=1)
    total, touched = None, torch.zeros(texels, dtype=torch.bool)
    for samples, weight in btf.weight_blocks(used):
        rows = slice(samples.start, samples.stop)
        missing = (1 - weight[:, 0].flatten(1)) * used[rows, None]
        if total is None:
            total = torch.zeros(columns.shape[1], texels, dtype=torch.float64)
        hit = (missing > 0).any(dim=0)
        touched |= hit
        total[:, hit] += columns[rows].T @ missing[:, hit].double()
    if total is None or not bool(touched.any()):
        return None
    where = touched.nonzero()[:, 0]
    total = total[:, where]
    normal = torch.zeros(len(where), rank, rank, dtype=torch.float64)
    normal[:, row, column] = total[: len(row)].T
    normal[:, column, row] = total[: len(row)].T
    offset = total[len(row) : -1].T.unflatten(1, (rank, 3))
    return Deficit(where, normal, offset, float(used.sum()) - total[-1])


@dataclass(frozen=True)
class LinearFit:
    """`coefficients` [K, 3, H, W], and `coverage` [1, H, W]: the share of the K unknowns that the samples determine.

    Where the coverage is below 1 the coefficients are those of minimum norm.
    """

    coefficients: Tensor
    coverage: Tensor


def solve_texels(
    btf: Btf, design: Design, moments: Moments, used: Tensor, explained: Tensor | None = None
) -> LinearFit:
    """Return the least-squares coefficients of every texel for values minus `explained` [sample, 3]."""
    if explained is None:
        explained = torch.zeros(len(btf), 3, dtype=torch.float64)
    explained = torch.where(used[:, None], explained.double(), torch.zeros((), dtype=torch.float64))
    dtype = moments.product.dtype
    shared = design.basis.T @ explained  # [rank, 3]
    product = moments.product - shared[:, :, None, None].to(dtype)
    coefficients = torch.einsum("kr,rchw->kchw", design.to_coefficients.to(dtype), product)
    coverage = torch.full((1, btf.height, btf.width), design.rank / design.terms)
    deficit = stream_deficit(btf, design, used, explained)
    if deficit is not None:
        flat, ranks = coefficients.flatten(2), coverage.flatten()
        for part in torch.arange(len(deficit.texels)).split(_TEXELS):
            texels = deficit.texels[part]
            right = product.flatten(2)[:, :, texels].permute(2, 0, 1).double() + deficit.offset[part]
            solved, rank = _solve_masked(design, deficit.normal[part], right)
            flat[:, :, texels] = solved.permute(1, 2, 0).to(dtype)
            ranks[texels] = (rank / design.terms).float()
        coefficients, coverage = flat.unflatten(2, (btf.height, btf.width)), ranks.reshape(coverage.shape)
    return LinearFit(coefficients.contiguous(), coverage)


def _solve_masked(design: Design, deficit: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    """Solve texels [t] whose normal matrix is 1 - deficit in the orthonormal basis; return coefficients and ranks.

    Where that is well conditioned a Cholesky factorisation does; elsewhere the minimum-norm solution is taken in the
    space of the coefficients, where the norm has its meaning.
    """
    normal = torch.eye(design.rank, dtype=torch.float64) - deficit
    factor, info = torch.linalg.cholesky_ex(normal)
    weakest = factor.diagonal(dim1=-2, dim2=-1).amin(dim=1)
    good = (info == 0) & (weakest > 1e-3)
    solution = torch.zeros(len(normal), design.terms, right.shape[2], dtype=torch.float64)
    rank = torch.full((len(normal),), float(design.rank), dtype=torch.float64)
    if bool(good.any()):
        solved = torch.cholesky_solve(right[good], factor[good])
        solution[good] = design.to_coefficients @ solved
    if bool((~good).any()):
        left = design.back.T @ normal[~good] @ design.back
        scale = left.diagonal(dim1=-2, dim2=-1).amax(dim=1).clamp(min=1e-300)
        values, vectors = torch.linalg.eigh(left / scale[:, None, None])
        kept = values > 1e-7
        inverse = torch.where(kept, 1 / torch.where(kept, values, 1.0), 0.0)
        turned = vectors.transpose(1, 2) @ (design.back.T @ right[~good])
        solution[~good] = vectors @ (inverse[..., None] * turned) / scale[:, None, None]
        rank[~good] = kept.sum(dim=1).double()
    return solution, rank
