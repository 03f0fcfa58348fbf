"""Levenberg-Marquardt for many small problems at once, with bounds.

The residual function is the only interface: it maps parameters [problem, P] to residuals [problem, R]. Its Jacobian
comes from forward differentiation, or from the caller where a formula is faster. Each problem has its own damping and
its own stop reason.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor
from torch.autograd import forward_ad

from torchmat.errors import FitError, check_finite, message
from torchmat.repeatable import one_thread
from torchmat.solvers.stop_reasons import CONVERGED, NOT_FINITE, OPEN, STEP_LIMIT

_ROUNDING = 10.0  # times what one rounding of residuals and parameters changes: below, nothing is promised


@dataclass(frozen=True)
class Solution:
    """Best parameters [problem, P], half the squared residual [problem], and why each problem stopped.

    `history` [steps, problem] is the cost after each step.
    """

    parameters: Tensor
    cost: Tensor
    reasons: tuple[str, ...]
    history: Tensor


@cache
def load_forward_rules() -> None:
    """Load torch's rules for forward differentiation, which use what torch itself warns about as deprecated."""
    with warnings.catch_warnings(), forward_ad.dual_level():
        warnings.simplefilter("ignore", DeprecationWarning)
        forward_ad.make_dual(torch.zeros(1), torch.zeros(1))


def forward_jacobian(residual: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
    """Return the function that gives d residual / d parameters, [problem, R, P], by forward differentiation.

    Problems do not mix, so one tangent serves all of them.
    """

    load_forward_rules()

    def jacobian(parameters: Tensor) -> Tensor:
        tangents = torch.eye(parameters.shape[1], dtype=parameters.dtype)[:, None, :]
        tangents = tangents.expand(-1, len(parameters), -1)

        def along(tangent: Tensor) -> Tensor:
            return torch.func.jvp(residual, (parameters,), (tangent,))[1]

        return torch.func.vmap(along)(tangents).permute(1, 2, 0)

    return jacobian


def _cost(residuals: Tensor) -> Tensor:
    with one_thread():
        return 0.5 * (residuals * residuals).sum(dim=1)


def _bounds(start: Tensor, low: Tensor | None, high: Tensor | None) -> tuple[Tensor, Tensor]:
    infinite = torch.full_like(start[0], torch.inf)
    low = -infinite if low is None else low.to(start)
    high = infinite if high is None else high.to(start)
    return low, high


class _State:
    """Everything that a step changes, per problem."""

    def __init__(self, parameters: Tensor, residuals: Tensor) -> None:
        problems = len(parameters)
        self.parameters, self.residuals, self.cost = parameters, residuals, _cost(residuals)
        self.damping = torch.full((problems,), 1e-3, dtype=parameters.dtype)
        self.growth = torch.full((problems,), 2.0, dtype=parameters.dtype)
        self.scale = torch.zeros_like(parameters)
        self.done = torch.zeros(problems, dtype=torch.bool)
        self.failed = torch.zeros(problems, dtype=torch.bool)

    def reasons(self, left_open: Tensor) -> tuple[str, ...]:
        """Name why each problem stopped; `left_open` [problem] says whether a step without damping promises more."""
        known = zip(self.done.tolist(), self.failed.tolist(), left_open.tolist(), strict=True)
        return tuple(
            NOT_FINITE if failed else STEP_LIMIT if not done else OPEN if more else CONVERGED
            for done, failed, more in known
        )

    def accept(self, better: Tensor, candidate: Tensor, residuals: Tensor, cost: Tensor, gain: Tensor) -> None:
        """Take the steps that lowered the cost; adapt damping by the gain ratio (Nielsen 1999)."""
        self.parameters = torch.where(better[:, None], candidate, self.parameters)
        self.residuals = torch.where(better[:, None], residuals, self.residuals)
        self.cost = torch.where(better, cost, self.cost)
        shrink = (1 - (2 * gain - 1) ** 3).clamp(min=1 / 3, max=2)
        self.damping = torch.where(better, self.damping * shrink, self.damping * self.growth).clamp(1e-15, 1e15)
        self.growth = torch.where(better, torch.full_like(self.growth, 2.0), (self.growth * 2).clamp(max=1e8))


def levenberg_marquardt(
    residual: Callable[[Tensor], Tensor], start: Tensor, low: Tensor | None = None, high: Tensor | None = None,
    *, jacobian: Callable[[Tensor], Tensor] | None = None, max_steps: int = 100, tolerance: float = 1e-10,
) -> Solution:
    """Minimise half the squared residual of each problem, from `start` [problem, P], within `low` and `high` [P].

    Damping scales with the largest curvature met per parameter (Moré 1978), so that units do not matter. A parameter
    at a bound which the gradient pushes outward is held for that step. `jacobian` [problem, R, P], if given, must be
    that of `residual`. A problem has converged when a step promises or brings less than `tolerance` of its cost or
    moves by less than `tolerance`, relative; where that holds only since damping shortens the step along directions that
    hardly matter, while without it the step promises more, these are "directions left open". It stops as not finite
    where the Jacobian is, or where every shorter step gives NaN or Inf. Parameters returned are the best met.

    Raises FitError when the start itself gives NaN or Inf.
    """
    check_finite("levenberg_marquardt", "start", start)
    low, high = _bounds(start, low, high)
    start = torch.minimum(torch.maximum(start, low), high)
    state = _State(start, residual(start))
    if not bool(torch.isfinite(state.cost).all()):
        step = "Start nearer, or check the data for extreme values."
        raise FitError(message("levenberg_marquardt", "the start", "give finite residuals", "it does not", step))
    jacobian = jacobian or forward_jacobian(residual)
    history = [state.cost.clone()]
    for _ in range(max_steps):
        if bool(state.done.all()):
            break
        _step(residual, jacobian, state, low, high, tolerance)
        history.append(state.cost.clone())
    more = state.done & ~state.failed
    if bool(more.any()):
        promised, ahead = _undamped(state, jacobian(state.parameters), low, high)
        # A promise alone may be the error of a Jacobian by differences: it counts where the step keeps it.
        kept = _cost(residual(ahead)) < (1 - tolerance) * state.cost
        more = more & (promised > tolerance * state.cost) & kept & ~_small(ahead - state.parameters, state.parameters, tolerance)
    return Solution(state.parameters, state.cost, state.reasons(more), torch.stack(history))


def _held(state: _State, gradient: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return which parameters [problem, P] are at a bound that the gradient pushes against."""
    return ((state.parameters <= low) & (gradient > 0)) | ((state.parameters >= high) & (gradient < 0))


def _small(move: Tensor, parameters: Tensor, tolerance: float) -> Tensor:
    """Return which moves [problem] are small: relative to the parameters, or for those near 0 to what changes residuals."""
    return (move.abs() <= tolerance * (parameters.abs() + tolerance)).all(dim=1)


def _undamped(state: _State, jacobian: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Return what a step without damping promises beyond what rounding hides, and the parameters after it.

    By singular values of the Jacobian's columns, of length 1 each: their squares, the normal equations, would hide the
    directions in question. What rounding makes of a direction, the more the weaker it is, promises nothing.
    """
    eps = torch.finfo(jacobian.dtype).eps
    jacobian, residuals = jacobian.nan_to_num(0, 0, 0).double(), state.residuals.double()
    with one_thread():
        held = _held(state, torch.einsum("brp,br->bp", jacobian, residuals), low, high)
        jacobian = torch.where(held[:, None], 0.0, jacobian)
        length = jacobian.norm(dim=1)
        unit = torch.where(length > 0, length, 1.0)
        left, strength, right = torch.linalg.svd(jacobian / unit[:, None], full_matrices=False)
        size = residuals.norm(dim=1)
        noise = _ROUNDING * eps * size[:, None] / strength.clamp(min=1e-300)
        along = (left.transpose(1, 2) @ residuals[..., None])[..., 0]
        along = torch.where(noise < size[:, None], along.sign() * (along.abs() - noise).clamp(min=0), 0.0)
        move = -(right.transpose(1, 2) @ (along / strength.clamp(min=1e-300))[..., None])[..., 0] / unit
        # One rounding of the parameters changes the residuals by so much, and the cost by that times their size.
        blur = _ROUNDING * eps * (length * state.parameters.double()).norm(dim=1)
        promised = 0.5 * along.square().sum(dim=1) - blur * (size + blur)
    ahead = torch.minimum(torch.maximum(state.parameters + move.to(low.dtype), low), high)
    return promised.to(ahead.dtype), ahead


def _propose(state: _State, jacobian: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return each problem's next parameters, the decrease of cost they promise, and whether it has no finite step."""
    normal = jacobian.transpose(1, 2) @ jacobian
    gradient = torch.einsum("brp,br->bp", jacobian, state.residuals)
    broken = ~(torch.isfinite(normal).all(dim=2).all(dim=1) & torch.isfinite(gradient).all(dim=1))
    held = _held(state, gradient, low, high) | broken[:, None]
    gradient = torch.where(held, torch.zeros_like(gradient), gradient)
    normal = torch.where(held[:, :, None] | held[:, None, :], torch.zeros_like(normal), normal)
    # Scaled to columns of unit length before they are damped and solved: of 1e-6 and 1e6 no digits would be left.
    state.scale = torch.maximum(state.scale, normal.diagonal(dim1=1, dim2=2).sqrt())
    unit = torch.where(state.scale > 0, state.scale, torch.ones_like(state.scale))
    damped = normal / unit[:, :, None] / unit[:, None, :]
    damped = damped + state.damping[:, None, None] * torch.eye(normal.shape[-1], dtype=normal.dtype)
    move, singular = torch.linalg.solve_ex(damped, (gradient / unit)[..., None])
    # Singular but for rounding: no step, which is rejected, and the next one is damped more.
    move = -torch.where((singular != 0)[:, None], torch.nan, move[..., 0]) / unit
    candidate = torch.minimum(torch.maximum(state.parameters + move, low), high)
    move = candidate - state.parameters
    promised = -(gradient * move).sum(1) - 0.5 * torch.einsum("bp,bpq,bq->b", move, normal, move)
    return candidate, promised, broken


def _step(
    residual: Callable[[Tensor], Tensor], jacobian_of: Callable[[Tensor], Tensor], state: _State, low: Tensor,
    high: Tensor, tolerance: float,
) -> None:
    jacobian = jacobian_of(state.parameters)
    with one_thread():
        candidate, promised, broken = _propose(state, jacobian, low, high)
    move = candidate - state.parameters
    residuals = residual(candidate)
    cost = _cost(residuals)
    finite = torch.isfinite(cost)
    gain = torch.where(finite & (promised > 0), (state.cost - cost) / promised.clamp(min=1e-300), cost.new_tensor(-1.0))
    better = finite & (cost < state.cost) & ~state.done
    floor = tolerance * state.cost + torch.finfo(cost.dtype).tiny
    small_gain = (promised.abs() <= floor) | (better & ((state.cost - cost) <= floor))
    small_move = _small(move, state.parameters, tolerance)
    stuck = ~better & (state.damping >= 1e14)
    state.accept(better, candidate, residuals, cost, gain)
    state.failed = state.failed | (~state.done & (broken | (stuck & ~finite)))
    state.done = state.done | broken | (finite & (small_gain | small_move)) | stuck
