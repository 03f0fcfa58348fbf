"""The error that a fit to chosen photographs is expected to have over the hemisphere, before they are taken.

The truth is taken for what the model's maps can follow, with a prior of the size that the maps have, and a misfit that is alike
in directions near each other: photographs close together repeat it instead of averaging it away. Of a least-squares fit to
photographs S with derivatives J, normal matrix ``M = J_S^T J_S + s^2 / prior`` and covariance K of misfit and noise, the expected
squared error toward t is ``K_tt - 2 J_t M^-1 J_S^T K_St + J_t M^-1 (J_S^T K_SS J_S + s^4 / prior) M^-1 J_t^T``. With a misfit
of noise alone that is I-optimality (A-optimality over the directions that count).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

_REACH = 0.3  # radians over which the misfit of a model stays alike: measured on two RTI captures, scripts/bench/README.md
_VALUES = 3_000_000  # of sums at a time
_ALIKE = 0.8  # share of the squared residual that is misfit; the rest is noise of each photograph


def likeness(light: Tensor, view: Tensor, other_light: Tensor, other_view: Tensor) -> Tensor:
    """Return how alike the misfit of pairs [n, 3] and [m, 3] is, [n, m]: 1 for the same pair."""
    squared = _angle(light, other_light).square() + _angle(view, other_view).square()
    return torch.exp(-squared / (2 * _REACH**2))


def _angle(one: Tensor, other: Tensor) -> Tensor:
    # Of chords, which near 0 keep the digits that an arccosine loses.
    return 2 * torch.arcsin((torch.cdist(one.double(), other.double(), compute_mode="donot_use_mm_for_euclid_dist") / 2).clamp(max=1))


@dataclass(frozen=True)
class Design:
    """What photographs would tell: of every pair of light and view of a list, for some texels.

    `slope` [texel, pair, colour, k] are derivatives in units of the prior, so that the prior is the unit matrix; `noise` is
    s^2; `alike` [pair, pair] the likeness of their misfit.
    """

    slope: Tensor
    noise: float
    alike: Tensor

    def sums(self, chosen: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Return J^T J and J^T K J / s^2 of chosen pairs, [texel, k, k] each."""
        some = self.slope[:, list(chosen)]
        alike = self.alike[list(chosen)][:, list(chosen)]
        mixed = (alike @ some.flatten(2)).reshape(some.shape).flatten(1, 2)
        flat = some.flatten(1, 2)
        plain = flat.transpose(1, 2) @ flat
        return plain, _ALIKE * (flat.transpose(1, 2) @ mixed) + (1 - _ALIKE) * plain

    def near(self, chosen: Sequence[int], pairs: Sequence[int]) -> Tensor:
        """Return J^T K / s^2 of chosen pairs with others, [texel, pair, colour, k]: the misfit that they share."""
        alike = self.alike[list(pairs)][:, list(chosen)]
        some = self.slope[:, list(chosen)]
        return _ALIKE * (alike @ some.flatten(2)).reshape(len(some), len(pairs), *some.shape[2:])

    def errors(self, chosen: Sequence[int], targets: Sequence[int]) -> Tensor:
        """Return the expected squared error toward each target, [target], of a fit to chosen pairs."""
        toward = self.slope[:, list(targets)]
        plain, mixed = self.sums(chosen)
        return self._errors(plain[None], mixed[None], self.near(chosen, targets)[None], toward)[0]

    def errors_with(self, chosen: Sequence[int], more: Sequence[int], targets: Sequence[int]) -> Tensor:
        """Return the same with each of `more` pairs added to the chosen ones, one at a time, [more, target]."""
        toward, shared = self.slope[:, list(targets)], self.near(chosen, targets)
        plain, mixed = self.sums(chosen)
        found = []
        for some in torch.tensor(list(more)).split(max(1, _VALUES // toward.numel())):
            own = self.slope[:, some].transpose(0, 1)  # [more, t, c, k]
            square = own.transpose(2, 3) @ own
            cross = self.near(chosen, some.tolist()).transpose(0, 1).transpose(2, 3) @ own
            alike = _ALIKE * self.alike[some][:, list(targets)]
            common = shared + alike[:, None, :, None, None] * own[:, :, None]
            found.append(self._errors(plain + square, mixed + cross + cross.transpose(2, 3) + square, common, toward))
        return torch.cat(found)

    def _errors(self, plain: Tensor, mixed: Tensor, shared: Tensor, toward: Tensor) -> Tensor:
        """Return the errors [n, target] of sums [n, texel, k, k] and what is shared [n, texel, target, colour, k]."""
        unit = torch.eye(plain.shape[-1], dtype=plain.dtype)
        inverse = torch.linalg.inv(plain + self.noise * unit)
        gain = toward.flatten(1, 2) @ inverse  # J_t M^-1, [n, t, target * colour, k]
        spread = self.noise * mixed + self.noise**2 * unit
        fitted = (gain * (gain @ spread)).sum(dim=-1)
        common = self.noise * (gain * shared.flatten(2, 3)).sum(dim=-1)
        error = self.noise * _ALIKE - 2 * common + fitted
        return error.unflatten(-1, toward.shape[1:3]).mean(dim=(1, 3)).clamp(min=0)

    def volumes(self, chosen: Sequence[int], more: Sequence[int]) -> Tensor:
        """Return the volume that each of `more` pairs, added to the chosen ones, leaves to the maps: -log det, [more].

        The covariance of misfit and noise weighs photographs, by least squares that know it.
        """
        own = torch.eye(len(self.alike), dtype=torch.float64)
        covariance = self.noise * (_ALIKE * self.alike + (1 - _ALIKE) * own)
        known = [int(number) for number in chosen]
        some = self.slope[:, known].transpose(1, 2)  # [t, c, m, k]
        weighed = torch.linalg.solve(covariance[known][:, known], some)
        told = (some.transpose(2, 3) @ weighed).sum(dim=1) + torch.eye(some.shape[-1], dtype=torch.float64)
        # One more row, less what those chosen say of it, has a variance of its own (Schur's complement).
        across = covariance[list(more)][:, known]  # [n, m]
        share = torch.linalg.solve(covariance[known][:, known], across.T).T
        rest = covariance.diagonal()[list(more)] - (across * share).sum(dim=1)
        left = self.slope[:, list(more)] - (across @ weighed.transpose(1, 2).flatten(2)).reshape(len(some), len(more), *self.slope.shape[2:])
        left = left / rest.clamp(min=1e-12).sqrt()[:, None, None]
        gain = left @ torch.linalg.inv(told)[:, None] @ left.transpose(2, 3)
        unit = torch.eye(gain.shape[-1], dtype=torch.float64)
        return -(torch.linalg.slogdet(told)[1][:, None] + torch.linalg.slogdet(unit + gain)[1]).mean(dim=0)
