"""Smoothing splines over light and view, each column with the penalty that foretells samples left out best.

Cubed distances to knots around a plane, least squares with a penalty on the bending (Duchon 1977; knots fewer than samples as in Wood
2003, "Thin plate regression splines"). Leave-one-out errors come from the hat matrix, without a second fit (Allen 1974).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.models.rbf import coordinates, cubes, plane_terms
from torchmat.repeatable import one_thread

MOST_KNOTS = 512
HALF_SCALES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)
_PENALTIES = 10.0 ** torch.linspace(-12, 1, 40, dtype=torch.float64)  # of the largest singular value, squared
_SAME = 1e-6  # of the largest spread of directions: what is less does not tell one from another
_STIFF = 1e-9  # of the largest cube: knots that coincide bend nothing
_TRIED_SAMPLES, _TRIED_KNOTS = 1024, 256  # for the choice among scales, which need not be as fine as the fit
_MARGIN = 0.1  # of the range of a weight over the samples: so far beyond may a direction between them go


class Spline(NamedTuple):
    """Numbers of the samples that are `knots`, the columns' coefficients [knots + 9, c], and the sum of squares left out [c]."""

    knots: Tensor
    table: Tensor
    left_out: Tensor


def farthest(points: Tensor, count: int) -> Tensor:
    """Return the numbers of `count` points [n, d] far from each other: first the nearest to their mean, then ever the farthest one."""
    if count >= len(points):
        return torch.arange(len(points))
    chosen = [int((points - points.mean(dim=0)).square().sum(dim=1).argmin())]
    distance = (points - points[chosen[0]]).square().sum(dim=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = torch.minimum(distance, (points - points[chosen[-1]]).square().sum(dim=1))
    return torch.tensor(chosen)


def smooth(points: Tensor, values: Tensor, root: Tensor, penalty: float | None, most_knots: int = MOST_KNOTS) -> Spline:
    """Return the spline through values [n, c] at points [n, d], float64; a sample weighs `root` [n, 1] squared.

    `penalty` is a share of the largest singular value squared, or None for the one of least leave-one-out error in each column.
    """
    with one_thread():
        return _smooth(points, values, root, penalty, most_knots)


def _smooth(points: Tensor, values: Tensor, root: Tensor, penalty: float | None, most_knots: int) -> Spline:
    knots = farthest(points, most_knots)
    # Directions that all samples share have no slope: the plane is spanned by what differs.
    plane, strength, turn = torch.linalg.svd(root * plane_terms(points), full_matrices=False)
    known = strength > _SAME * strength[0]
    plane, back = plane[:, known], turn[known].T / strength[known]
    # Coefficients of knots that no plane could replace, such that the bending is the sum of their squares.
    of_knots = plane_terms(points[knots]) @ back
    free = torch.linalg.qr(of_knots, mode="complete").Q[:, of_knots.shape[1] :]
    between = cubes(points[knots], points[knots])
    stiffness, bent = torch.linalg.eigh(free.T @ between @ free)
    kept = stiffness > _STIFF * between.max()
    bent = free @ (bent[:, kept] / stiffness[kept].sqrt())
    bending = root * (cubes(points, points[knots]) @ bent)
    bending = bending - plane @ (plane.T @ bending)
    weighed = root * values
    rest = weighed - plane @ (plane.T @ weighed)
    left, singular, right = torch.linalg.svd(bending, full_matrices=False)
    along = left.T @ rest
    square = singular.square()
    scale = square[0] if len(square) else torch.ones((), dtype=points.dtype)
    # What no spline explains, and how much of each sample that is: nothing but rounding where knots are samples.
    beyond = rest - left @ along
    open_share = (1 - plane.square().sum(dim=1) - left.square().sum(dim=1)).clamp(min=0)
    open_share = torch.where(open_share < 1e-9, 0.0, open_share)
    tried = _PENALTIES if penalty is None else torch.tensor([max(penalty, float(_PENALTIES[0]))], dtype=torch.float64)
    errors = []
    for share in tried.tolist():
        stays = share * scale / (square + share * scale)
        missed = beyond + left @ (stays[:, None] * along)
        errors.append((missed / (open_share + left.square() @ stays).clamp(min=1e-12)[:, None]).square().sum(dim=0))
    best = torch.stack(errors).argmin(dim=0)
    damped = singular[:, None] / (square[:, None] + tried[best] * scale)
    inner = right.T @ (damped * along)
    flat = back @ (plane.T @ (weighed - root * (cubes(points, points[knots]) @ (bent @ inner))))
    return Spline(knots, torch.cat((bent @ inner, flat)), torch.stack(errors).amin(dim=0))


def best_scale(light: Tensor, view: Tensor, values: Tensor, root: Tensor, penalty: float | None, seed: int) -> Tensor:
    """Return how much the half vector counts [1], by the leave-one-out error of some samples: values [n, c] at directions [n, 3]."""
    random = torch.Generator().manual_seed(seed)
    some = torch.randperm(len(light), generator=random)[:_TRIED_SAMPLES].sort().values
    best, least = None, torch.inf
    for scale in torch.tensor(HALF_SCALES, dtype=torch.float64).split(1):
        points = coordinates(light[some], view[some], scale)
        error = float(smooth(points, values[some], root[some], penalty, _TRIED_KNOTS).left_out.sum())
        if best is None or error < least:
            best, least = scale, error
    assert best is not None
    return best


def reach_of(values: Tensor) -> Tensor:
    """Return the least and the largest weight [c, 2] that a spline may say, of its values [n, c] at the samples."""
    least, most = values.amin(dim=0), values.amax(dim=0)
    margin = _MARGIN * (most - least)
    return torch.stack((least - margin, most + margin), dim=1)
