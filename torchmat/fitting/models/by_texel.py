"""The least squares of texels that have directions of their own: near lights and cameras give each its own equations.

Strips of texels, one after the other, sum products of the basis with itself and with the values in double precision: memory is
that of a strip, whatever the images' size. Each texel's sums go through the samples in their order, whatever the threads do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.btf.btf import Btf
from torchmat.fitting.models.streamed import LinearFit
from torchmat.fitting.training import Training
from torchmat.solvers.least_squares import DETERMINED

_TEXELS = 8192  # of a strip
_VALUES = 1_000_000  # of the basis at a time
_CERTAIN = 1e-7  # of a column's information must be its own, or the texel's rank is counted
_KEPT = 1e-11  # of the largest eigenvalue of sums of squares, below which there is rounding alone

Basis = Callable[[Tensor, Tensor], Tensor]


class Seen(NamedTuple):
    """Some samples of a strip: their numbers [k], unit planes of light and view, values [k, 3, h, w], and weight [k, 1, h, w].

    All float64; `reduced` says that some weight is below 1 for another reason than what its sample counts.
    """

    rows: Tensor
    light: Tensor
    view: Tensor
    values: Tensor
    weight: Tensor
    reduced: bool


def strips(btf: Btf) -> Iterator[tuple[slice, Btf]]:
    """Yield rows of texels and the same samples of them, few enough for a double-precision equation each."""
    step = max(1, _TEXELS // btf.width)
    for top in range(0, btf.height, step):
        count = min(step, btf.height - top)
        yield slice(top, top + count), btf.window(top, 0, count, btf.width)


def seen_of(training: Training, strip: Btf, terms: int, encode: Callable[[Tensor], Tensor] | None = None) -> Iterator[Seen]:
    """Yield the used samples of a strip, as many at a time as leave room for `terms` planes of each."""
    some = max(1, _VALUES // (terms * strip.height * strip.width))
    for block in strip.blocks(training.used, training.dtype):
        run = torch.arange(block.samples.start, block.samples.stop)
        for part in training.used[run].nonzero()[:, 0].split(some):
            values = block.images[part]
            values = (values if encode is None else encode(values)).double()
            weight = torch.ones(len(part), 1, strip.height, strip.width, dtype=torch.float64)
            weight = weight if block.weight is None else block.weight[part].double()
            reduced = block.weight is not None and bool((weight < 1).any())
            light, view = strip.directions(run[part], torch.float64)
            yield Seen(run[part], light, view, values, training.counted(weight, run[part]), reduced)


class Equations(NamedTuple):
    """Sums over the samples of texels: `normal` [t, K, K] and `right` [t, K, 3]; `full` as if every sample counted wholly."""

    normal: Tensor
    right: Tensor
    full: Tensor | None


def equations(
    training: Training, strip: Btf, terms: int, basis: Basis, encode: Callable[[Tensor], Tensor] | None = None,
    explained: Basis | None = None,
) -> Equations:
    """Return the sums over the used samples of a strip, for values less what is `explained` by (light, view)."""
    size = (strip.height, strip.width)
    texels = strip.height * strip.width
    pairs, right = torch.zeros(terms * (terms + 1) // 2, texels, dtype=torch.float64), torch.zeros(terms, 3, texels, dtype=torch.float64)
    lost: Tensor | None = None
    for seen in seen_of(training, strip, terms, encode):
        count = len(seen.rows)
        left = basis(seen.light, seen.view).expand(count, terms, *size).reshape(count, terms, texels)
        values = seen.values if explained is None else seen.values - explained(seen.light, seen.view)
        values, weight = values.reshape(count, 3, texels), seen.weight.reshape(count, 1, texels)
        missing = None
        if seen.reduced:
            missing = training.counted(torch.ones_like(seen.weight), seen.rows).reshape(count, 1, texels) - weight
            lost = torch.zeros_like(pairs) if lost is None else lost
        # Sample by sample and plane by plane: products of batches as small take ten times as long.
        for sample, one in enumerate(left):
            weighted = one * weight[sample]
            right.addcmul_(weighted[:, None], values[sample])
            _add_pairs(pairs, weighted, one)
            if missing is not None and lost is not None:
                _add_pairs(lost, one * missing[sample], one)
    normal = _symmetric(pairs, terms)
    return Equations(normal, right.permute(2, 0, 1).contiguous(), None if lost is None else normal + _symmetric(lost, terms))


def _add_pairs(total: Tensor, first: Tensor, second: Tensor) -> None:
    """Add the products of `first` and `second` [K, t], each with itself and those behind it, to `total` [K (K + 1) / 2, t]."""
    place, terms = 0, len(first)
    for term in range(terms):
        total[place : place + terms - term].addcmul_(first[term], second[term:])
        place += terms - term


def _symmetric(pairs: Tensor, terms: int) -> Tensor:
    """Return matrices [t, K, K] of their upper halves [K (K + 1) / 2, t]."""
    row, column = torch.triu_indices(terms, terms)
    found = pairs.new_empty(pairs.shape[1], terms, terms)
    found[:, row, column] = found[:, column, row] = pairs.T
    return found


def solve(found: Equations, ridge: float = 0.0, floor: float = DETERMINED) -> tuple[Tensor, Tensor]:
    """Return coefficients [t, K, 3] and ranks [t]: how many of the K unknowns the samples determine.

    `ridge` penalises squared coefficients, as a share of the columns' mean energy. A direction counts as determined with more
    than `floor` of what all samples wholly would tell; where some is not, coefficients are those of the least norm.
    """
    normal, right, full = found
    terms = normal.shape[1]
    solution, rank = torch.zeros_like(right), torch.zeros(len(normal), dtype=torch.float64)
    energy = normal.diagonal(dim1=1, dim2=2)
    scale = torch.where(energy > 0, energy, 1.0).sqrt()
    scaled = normal / scale[:, :, None] / scale[:, None]
    factor, failed = torch.linalg.cholesky_ex(scaled)
    good = (failed == 0) & (factor.diagonal(dim1=1, dim2=2).square().amin(dim=1) > _CERTAIN)
    if full is not None:
        good &= (normal == full).flatten(1).all(dim=1)
    rank[good] = float(terms)
    others = (~good & (energy.sum(dim=1) > 0)).nonzero()[:, 0]
    if len(others):
        rank[others] = _ranks(normal[others], (normal if full is None else full)[others], floor)
    if ridge > 0:
        penalty = ridge * energy.sum(dim=1) / terms
        there = penalty > 0
        damped = normal + penalty[:, None, None] * torch.eye(terms, dtype=torch.float64)
        solution[there] = _by_cholesky(damped[there], right[there])
        return solution, rank
    whole = good.clone()
    whole[others] = rank[others] == terms
    solution[whole] = _by_cholesky(normal[whole], right[whole])
    rest = others[rank[others] < terms]
    if len(rest):
        solution[rest] = _least_norm(normal[rest], right[rest])
    return solution, rank


def _by_cholesky(normal: Tensor, right: Tensor) -> Tensor:
    """Solve positive definite systems, rows and columns scaled to a diagonal of ones before."""
    scale = normal.diagonal(dim1=1, dim2=2).sqrt()[:, :, None]
    factor = torch.linalg.cholesky(normal / scale / scale.transpose(1, 2))
    return torch.cholesky_solve(right / scale, factor) / scale


def _ranks(normal: Tensor, full: Tensor, floor: float) -> Tensor:
    """Return how many directions of the `full` equations the `normal` ones tell more than a share `floor` of."""
    energy = full.diagonal(dim1=1, dim2=2)
    scale = torch.where(energy > 0, energy, 1.0).sqrt()
    values, vectors = torch.linalg.eigh(full / scale[:, :, None] / scale[:, None])
    kept = values > _KEPT * values[:, -1:].clamp(min=1e-300)
    turned = vectors * torch.where(kept, values.clamp(min=1e-300).rsqrt(), 0.0)[:, None]
    share = torch.linalg.eigvalsh(turned.transpose(1, 2) @ (normal / scale[:, :, None] / scale[:, None]) @ turned)
    return (share > floor).sum(dim=1).double()


def _least_norm(normal: Tensor, right: Tensor) -> Tensor:
    values, vectors = torch.linalg.eigh(normal)
    kept = values > _KEPT * values[:, -1:].clamp(min=1e-300)
    inverse = torch.where(kept, 1 / torch.where(kept, values, 1.0), 0.0)
    return vectors @ (inverse[:, :, None] * (vectors.transpose(1, 2) @ right))


class TexelFit(NamedTuple):
    """What `fit_texels` finds: the fit, and the weighted sums of basis times value that it rests on, [K, 3, H, W]."""

    fit: LinearFit
    right: Tensor


def fit_texels(
    training: Training, terms: int, basis: Basis, ridge: float = 0.0, encode: Callable[[Tensor], Tensor] | None = None,
    explained: Basis | None = None,
) -> TexelFit:
    """Return the least-squares coefficients [K, 3, H, W] of every texel for a `basis` [k, K, h, w] of (light, view)."""
    btf = training.btf
    # What only clipped samples tell has at most their weight's share of the full information (`streamed.solve_texels`).
    floor = max(DETERMINED, btf.clipped_weight * (1 + 1e-5) if btf.may_clip else 0.0)
    coefficients, sums, ranks = [], [], []
    for _, strip in strips(btf):
        found = equations(training, strip, terms, basis, encode, explained)
        solution, rank = solve(found, ridge, floor)
        size = (strip.height, strip.width)
        coefficients.append(solution.permute(1, 2, 0).unflatten(2, size).to(training.dtype))
        sums.append(found.right.permute(1, 2, 0).unflatten(2, size).to(training.dtype))
        ranks.append((rank / terms).float().reshape(1, *size))
    fit = LinearFit(torch.cat(coefficients, dim=2).contiguous(), torch.cat(ranks, dim=1))
    return TexelFit(fit, torch.cat(sums, dim=2))
