"""Linear least squares for many right-hand sides that share one design matrix: one small factorisation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat.repeatable import one_thread

DETERMINED = 1e-6  # share of the full design's information in a direction, below which a texel has none


@dataclass(frozen=True)
class Design:
    """A design matrix [sample, K], orthonormalised: ``matrix = basis @ back``.

    `basis` [sample, rank] has orthonormal columns (rows of samples that do not take part are 0); `back` [rank, K];
    `to_coefficients` [K, rank] is the way back. Where columns depend on each other it gives, of all coefficients that
    predict the same, those of minimum norm in the units that the columns have. Products are summed in the orthonormal
    basis, where float32 does not lose the digits that the squared condition number of the plain normal equations would.
    `penalty` is what a squared coefficient costs. `root` [sample] is the root of what each sample counts, None for all
    alike: the matrix is then the one whose rows are multiplied with it.
    """

    basis: Tensor
    back: Tensor
    to_coefficients: Tensor
    penalty: float
    root: Tensor | None = None

    @property
    def left(self) -> Tensor:
        """What values are multiplied with, [sample, rank]: the basis, its rows times the root of what they count."""
        return self.basis if self.root is None else self.basis * self.root[:, None]

    @property
    def rank(self) -> int:
        """Number of independent columns."""
        return self.basis.shape[1]

    @property
    def terms(self) -> int:
        """Number of columns, K."""
        return self.back.shape[1]


def make_design(matrix: Tensor, used: Tensor, ridge: float = 0.0, importance: Tensor | None = None) -> Design:
    """Factorise `matrix` [sample, K] over the samples that are `used` (bool), each of which counts `importance` [sample].

    `ridge` penalises squared coefficients, as a share of the columns' mean energy; 0 is plain least squares. The units
    of the columns, however far apart, cost no digits.
    """
    root = None if importance is None else importance.double().sqrt()
    matrix = matrix if root is None else matrix.double() * root[:, None]
    matrix = torch.where(used[:, None], matrix.double(), torch.zeros((), dtype=torch.float64))
    # The rank is judged on columns of one length, so that it does not depend on the terms' units.
    length = matrix.norm(dim=0)
    length = torch.where(length > 0, length, torch.ones_like(length))
    with one_thread():
        left, singular, right = torch.linalg.svd(matrix / length, full_matrices=False)
    # Directions come in float32; what lies below their rounding is not a column of its own.
    kept = singular > singular.max().clamp(min=1e-300) * 1e-6
    basis, back = left[:, kept], singular[kept, None] * right[kept] * length
    # The factorisation leaves 1e-17 in the rows of zeros, enough for held-out images to leave their trace.
    basis = torch.where(used[:, None], basis, torch.zeros((), dtype=torch.float64))
    penalty = ridge * float(matrix.square().sum()) / matrix.shape[1]
    if penalty > 0:
        damped = back.T @ back + penalty * torch.eye(back.shape[1], dtype=back.dtype)
        way_back = _solve_scaled(damped, back.T)
    else:
        way_back = _least_norm(singular[kept], right[kept], length)
    return Design(basis, back, way_back, penalty, root)


def _least_norm(singular: Tensor, right: Tensor, length: Tensor) -> Tensor:
    """Return the pseudo-inverse [K, rank] of ``singular[:, None] * right * length`` by way of columns of one length.

    A pseudo-inverse of columns in their own units would take the smallest for rounding and drop them. That of columns
    of one length solves as well; what it holds of directions without effect is taken off, which leaves the least norm.
    """
    one = (right / singular[:, None]).T / length[:, None]
    if len(right) == len(length):
        return one
    with one_thread():
        others = torch.linalg.svd(right, full_matrices=True)[2][len(right) :]
        without_effect = torch.linalg.qr((others / length).T)[0]
    return one - without_effect @ (without_effect.T @ one)


def _solve_scaled(matrix: Tensor, right: Tensor) -> Tensor:
    """Solve symmetric positive definite systems [..., K, K], rows and columns scaled to a diagonal of ones before."""
    scale = matrix.diagonal(dim1=-2, dim2=-1).sqrt()[..., None]
    return torch.linalg.solve(matrix / scale / scale.transpose(-1, -2), right / scale) / scale


def solve_masked(design: Design, deficit: Tensor, right: Tensor, floor: float) -> tuple[Tensor, Tensor]:
    """Solve texels [t] whose normal matrix is 1 - deficit in the orthonormal basis; return coefficients and ranks.

    The rank counts directions with more than `floor` of the full design's information.

    Where the samples determine all that the design does, the orthonormal basis is solved by Cholesky, whose digits do
    not suffer from the scale of the columns; elsewhere, and with a penalty, it is solved in the space of the
    coefficients, where the norm has its meaning.
    """
    normal = torch.eye(design.rank, dtype=torch.float64) - deficit
    values = torch.linalg.eigvalsh(normal)
    rank = (values > floor).sum(dim=1).double()
    good = (values > DETERMINED).all(dim=1) & (design.penalty == 0)
    solution = right.new_zeros(len(right), design.terms, right.shape[2])
    if bool(good.any()):
        factor = torch.linalg.cholesky(normal[good])
        solution[good] = design.to_coefficients @ torch.cholesky_solve(right[good], factor)
    if bool((~good).any()):
        solution[~good] = _in_coefficients(design, normal[~good], right[~good])
    return solution, rank


def _in_coefficients(design: Design, normal: Tensor, right: Tensor) -> Tensor:
    """Solve texels [t, rank, rank] for coefficients [t, K, 3]: with the penalty, or by the pseudo-inverse without."""
    matrix = design.back.T @ normal @ design.back
    right = design.back.T @ right
    if design.penalty > 0:
        matrix += design.penalty * torch.eye(design.terms, dtype=torch.float64)
        return _solve_scaled(matrix, right)
    # Measured against the full design: a texel without samples has rounding errors for a matrix, and no solution.
    scale = design.back.square().sum(dim=0).max()
    values, vectors = torch.linalg.eigh(matrix / scale)
    kept = values > 1e-8
    inverse = torch.where(kept, 1 / torch.where(kept, values, 1.0), 0.0)
    turned = vectors.transpose(1, 2) @ right
    return vectors @ (inverse[..., None] * turned) / scale
