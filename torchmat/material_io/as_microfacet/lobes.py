"""Specular maps as GGX lobes: each table that texels share, or mix, becomes a roughness, a direction and a colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.material_io.as_microfacet.directions import lobe_pairs
from torchmat.material_io.as_microfacet.error import shade_pairs
from torchmat.models.distribution import Distribution
from torchmat.models.ggx import ggx_share, schlick_rise, squared_alpha
from torchmat.repeatable import one_thread
from torchmat.solvers.levenberg_marquardt import levenberg_marquardt

_ROUGHNESS = (0.1, 0.16, 0.25, 0.35, 0.47, 0.6, 0.78, 1.0)  # roots of alpha that are tried
_RATIOS = (1.0, 1.5, 2.3)  # of the roughness along over that across
_TURNS = 4  # of the direction along, over half a turn
_GRAZING = 1e-4
_STEPS = 20
_STEP = 1e-5  # of a difference
_MOST_LIFT = 4.0
_MOST_KINDS, _LOOKED_AT, _NEAR = 24, 4096, 3  # mixtures of lobes that are fitted; texels that say which; of them a texel blends
_EXACT = 1e-12


class Lobes(NamedTuple):
    """GGX lobes of K kinds: root of alpha along and across, the turn, and the factor on F90, [K]; what stands before D [K, 3],
    and diffuse [K, 3]."""

    along: Tensor
    across: Tensor
    turn: Tensor
    lift: Tensor
    strength: Tensor
    diffuse: Tensor


@dataclass(frozen=True)
class _Seen:
    """Directions [n, 3], what they show [n, 3, K], Fresnel's rise [n, 1], and F0 and F90."""

    light: Tensor
    view: Tensor
    target: Tensor
    rise: Tensor
    f0: float
    f90: float

    def share(self, along: Tensor, across: Tensor, turn: Tensor, lift: Tensor) -> Tensor:
        """Return the lobes [n, K] of K roughnesses, turns and factors on F90, Fresnel's factor included."""
        cosine, sine = torch.cos(turn), torch.sin(turn)

        def turned(direction: Tensor) -> Tensor:
            x, y, z = (direction[:, k : k + 1] for k in range(3))
            return torch.stack((x * cosine + y * sine, y * cosine - x * sine, z.expand(-1, len(turn))), dim=1)[:, :, None]

        total = self.light + self.view
        half = total / total.norm(dim=1, keepdim=True)
        squares = squared_alpha(torch.stack((along, across)))[:, None]
        return ggx_share(turned(self.light), turned(self.view), turned(half), squares, _GRAZING)[:, 0, 0] * torch.lerp(
            torch.full_like(lift, self.f0), self.f90 * lift, self.rise
        )


def schlick_terms(exponent: float) -> tuple[float, float]:
    """Return a and b of the ``a + b x^5`` nearest to Fresnel's ``x^exponent``, x being 1 - L.H: Schlick's own are 0 and 1."""
    if exponent == 5:
        return 0.0, 1.0
    light, view = lobe_pairs()
    apart = (1 - (light + view).norm(dim=1) / 2).clamp(min=0)
    columns = torch.stack((torch.ones_like(apart), schlick_rise(apart)), dim=1)
    a, b = torch.linalg.lstsq(columns, apart[:, None] ** exponent).solution[:, 0].tolist()
    return max(a, 0.0), b


def fit_lobes(material: Distribution, f0: float, f90: float, lifted: bool) -> Lobes:
    """Return the lobes nearest to what the single row of texels of a material shows, whose Fresnel factor is near `f0` to `f90`.

    Roughness and direction over a grid and then, with a factor on F90 that takes up how masking differs if they are `lifted`,
    by Levenberg and Marquardt; strength and diffuse in closed form.
    """
    light, view = lobe_pairs()
    target = shade_pairs(material.double(), light, view)[:, :, 0]
    apart = 1 - (light + view).norm(dim=1) / 2
    seen = _Seen(light, view, target, schlick_rise(apart.clamp(min=0))[:, None], f0, f90)
    size = target.square().sum(dim=(0, 1)).sqrt().clamp(min=1e-12)
    with one_thread():
        start = torch.cat((_started(seen), torch.ones(target.shape[2], 1, dtype=torch.float64)), dim=1)
        cosine = light[:, 2, None]

        def residual(parameters: Tensor) -> Tensor:
            share = seen.share(*parameters.T)
            strength, diffuse, _ = solve_two(share, cosine.expand_as(share), target)
            return ((share[:, None] * strength + cosine[:, None] * diffuse - target) / size).flatten(0, 1).T

        def jacobian(parameters: Tensor) -> Tensor:
            # Of four parameters differences are quick; forward rules load what takes seconds.
            moves = _STEP * torch.eye(4, dtype=parameters.dtype)
            return torch.stack([(residual(parameters + move) - residual(parameters - move)) / (2 * _STEP) for move in moves], dim=2)

        ends = (0.0, _MOST_LIFT) if lifted else (1.0, 1.0)
        low, high = torch.tensor([[0.03, 0.03, -torch.inf, ends[0]], [1.0, 1.0, torch.inf, ends[1]]], dtype=torch.float64)
        found = levenberg_marquardt(residual, start, low, high, jacobian=jacobian, max_steps=_STEPS, tolerance=1e-6).parameters
        share = seen.share(*found.T)
        strength, diffuse, _ = solve_two(share, cosine.expand_as(share), target)
    along, across, turn, lift = found.T
    return Lobes(along, across, turn, lift, strength.T, diffuse.T)


def _started(seen: _Seen) -> Tensor:
    """Return the best roughness along and across, and turn, [K, 3] of the grid."""
    kinds = seen.target.shape[2]
    best, error = torch.zeros(kinds, 3, dtype=torch.float64), torch.full((kinds,), torch.inf, dtype=torch.float64)
    cosine = seen.light[:, 2]
    for root in _ROUGHNESS:
        for ratio in _RATIOS:
            for number in range(_TURNS if ratio > 1 else 1):
                shape = torch.tensor([[min(1.0, root * ratio**0.5)], [root / ratio**0.5], [torch.pi * number / _TURNS]], dtype=torch.float64)
                share = seen.share(shape[0], shape[1], shape[2], torch.ones(1, dtype=torch.float64))[:, 0]
                left = solve_two(share, cosine, seen.target)[2]
                better = left < error
                error = torch.where(better, left, error)
                best = torch.where(better[:, None], shape.T, best)
    return best


def solve_two(first: Tensor, second: Tensor, target: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the factors [3, K] >= 0 of two columns [n, K] or [n] for `target` [n, 3, K], and the squares left [K]."""
    first, second = (column if column.ndim > 1 else column[:, None] for column in (first, second))
    p, q = ((column[:, None] * target).sum(dim=0) for column in (first, second))
    a, b, c = (one.sum(dim=0) for one in (first * first, first * second, second * second))
    x, y, left = solve_sums(a, b, c, p, q)
    return x, y, ((target * target).sum(dim=0) + left).sum(dim=0).clamp(min=0)


def solve_sums(a: Tensor, b: Tensor, c: Tensor, p: Tensor, q: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the factors >= 0 of normal equations ``a x + b y = p``, ``b x + c y = q``, and the change of the squares."""
    a, c = a * (1 + 1e-9) + 1e-30, c * (1 + 1e-9) + 1e-30
    det = (a * c - b * b).clamp(min=1e-30)
    x, y = (p * c - q * b) / det, (q * a - p * b) / det
    # Of two unknowns that may not be negative, the one that is stays at 0 and the other is solved alone.
    alone_x, alone_y = (p / a).clamp(min=0), (q / c).clamp(min=0)
    x, y = torch.where(y < 0, alone_x, x.clamp(min=0)), torch.where(x < 0, alone_y, y.clamp(min=0))
    return x, y, a * x * x + 2 * b * x * y + c * y * y - 2 * (p * x + q * y)


def kinds_of(index: Tensor) -> Tensor:
    """Return the mixtures [J, K] of lobes that stand for all texels of `index` [K, H, W], the furthest from each other."""
    rows = index.flatten(1).T.double()
    rows = rows[torch.linspace(0, len(rows) - 1, min(_LOOKED_AT, len(rows))).round().long()]
    chosen = [rows[0]]
    distance = (rows - rows[0]).square().sum(dim=1)
    while len(chosen) < _MOST_KINDS and float(distance.max()) > 1e-4:
        chosen.append(rows[int(distance.argmax())])
        distance = torch.minimum(distance, (rows - chosen[-1]).square().sum(dim=1))
    return torch.stack(chosen)


def weights_of(index: Tensor, kinds: Tensor) -> Tensor:
    """Return how much [J, H, W] of each of the mixtures `kinds` [J, K] a texel takes: of the nearest three, by distance."""
    if len(kinds) == 1:
        return torch.ones_like(index[:1])
    rows = index.flatten(1).T.double()
    found = []
    for some in rows.split(65536):
        distance = torch.cdist(some, kinds).square() + _EXACT
        near, which = distance.topk(min(_NEAR, len(kinds)), dim=1, largest=False)
        weight = torch.zeros_like(distance).scatter_(1, which, 1 / near)
        found.append(weight / weight.sum(dim=1, keepdim=True))
    return torch.cat(found).T.reshape(-1, *index.shape[1:]).to(index.dtype)
