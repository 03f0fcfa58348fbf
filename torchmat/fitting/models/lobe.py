"""Fit of one lobe for the whole material to means over its texels, by Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchmat.brdf.lobe import Lobe
from torchmat.solvers import LevenbergMarquardt
from torchmat.solvers.levenberg_marquardt import Solution, levenberg_marquardt

_BRIGHTEST = 4.0
_COLOURS = ("diffuse_", "specular_")
_STEP, _STEP_AROUND = 1e-5, 1e-2  # relative to the parameter, and to what counts as 0


class LobeProblem(NamedTuple):
    """Lobe against means: `light`, `view` [..., m, 3, 1, 1], `values` [..., m, 3], `weight` [..., m, 1]."""

    lobe: Lobe
    light: Tensor
    view: Tensor
    values: Tensor
    weight: Tensor

    def residual(self, parameters: Tensor) -> Tensor:
        """Return weighted differences [problem, 3 m] for parameters [problem, P]."""
        predicted = self.lobe.evaluate(parameters[:, None], self.light, self.view)[..., 0, 0]
        return ((predicted - self.values) * self.weight).flatten(1)

    def jacobian(self, parameters: Tensor) -> Tensor:
        """Return the derivatives of the residual, [problem, 3 m, P], by the lobe's formula."""
        assert self.lobe.jacobian is not None
        rows = self.lobe.jacobian(parameters[:, None], self.light, self.view)
        return (rows * self.weight[..., None]).flatten(1, 2)

    def solve(self, start: Tensor, **settings: Any) -> Solution:
        """Minimise from `start` [problem, P] within the lobe's bounds."""
        low, high = lobe_limits(self.lobe, self.values)
        start = torch.minimum(torch.maximum(start, low), high)
        jacobian = None if self.lobe.jacobian is None else self.jacobian
        return levenberg_marquardt(self.residual, start, low, high, **{"jacobian": jacobian, **settings})


def _colours(lobe: Lobe) -> Tensor:
    """Return which parameters are colours, bool [P]: they scale with the data."""
    return torch.tensor([name.startswith(_COLOURS) for name in lobe.names])


def lobe_limits(lobe: Lobe, values: Tensor) -> tuple[Tensor, Tensor]:
    """Return the lobe's bounds [P], colours bounded by a few times the brightest value.

    A narrow lobe between two samples can have any peak; without a bound one such light decides a whole average.
    """
    low, high = torch.tensor(lobe.low, dtype=torch.float64), torch.tensor(lobe.high, dtype=torch.float64)
    brightest = values.max().clamp(min=1e-12) * _BRIGHTEST
    return low, torch.where(_colours(lobe), torch.minimum(high, brightest), high)


def scaled_starts(lobe: Lobe, values: Tensor) -> Tensor:
    """Return the lobe's starting points [start, P] with their colours brought to the data's brightness."""
    starts = torch.tensor(lobe.starts, dtype=torch.float64)
    scale = values.mean().clamp(min=1e-12) / 0.3
    return torch.where(_colours(lobe), starts * scale, starts)


def by_differences(residual: Callable[[Tensor], Tensor], own_data: bool = False) -> Callable[[Tensor], Tensor]:
    """Return the function that gives d residual / d parameters, [problem, R, P], by central differences.

    All parameters at once, or one after the other where each problem has its `own_data`. In float64 they leave nine digits, more than a step needs. Loading torch's forward differentiation takes a second,
    which is longer than such a fit.
    """

    def jacobian(parameters: Tensor) -> Tensor:
        problems, count = parameters.shape
        step = _STEP * parameters.abs().clamp(min=_STEP_AROUND)
        if own_data:
            moves = torch.eye(count, dtype=parameters.dtype)[:, None] * step
            columns = [(residual(parameters + move) - residual(parameters - move)) for move in moves]
            return torch.stack([gap / (2 * wide[:, None]) for gap, wide in zip(columns, step.T, strict=True)], dim=-1)
        moves = (torch.eye(count, dtype=parameters.dtype)[:, None] * step).flatten(0, 1)
        moved = torch.cat((parameters.repeat(count, 1) + moves, parameters.repeat(count, 1) - moves))
        ahead, behind = residual(moved).unflatten(0, (2, count, problems)).unbind(0)
        return ((ahead - behind) / (2 * step.T[:, :, None])).permute(1, 2, 0)

    return jacobian


def limits_of(solver: LevenbergMarquardt | None, **usual: Any) -> dict[str, Any]:
    """Return the solver's settings, or else what is `usual` here, as keywords of `levenberg_marquardt`."""
    filled = (solver or LevenbergMarquardt()).filled(**usual)
    return {"max_steps": filled.steps, "tolerance": filled.tolerance}


def fit_lobe(
    lobe: Lobe, light: Tensor, view: Tensor, values: Tensor, differences: bool = False, importance: Tensor | None = None,
    solver: LevenbergMarquardt | None = None,
) -> tuple[Tensor, str]:
    """Return (parameters [P], stop reason) of the lobe nearest to `values` [m, 3] at planes `light`, `view`, float64.

    From every start for a few steps, then the best is carried through by `solver`. `importance` [m] is what each value counts, None
    for all alike. `differences` takes the Jacobian from central
    differences where the lobe has no formula.
    """
    root = torch.ones(1, 1, dtype=values.dtype) if importance is None else importance.to(values.dtype).sqrt()[:, None]
    problem = LobeProblem(lobe, light, view, values, root)
    settings = {"jacobian": by_differences(problem.residual)} if differences and lobe.jacobian is None else {}
    explored = problem.solve(scaled_starts(lobe, values), max_steps=6, **settings)
    solution = problem.solve(explored.parameters[explored.cost.argmin()][None], **limits_of(solver), **settings)
    return solution.parameters[0], solution.reasons[0]
