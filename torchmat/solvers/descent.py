"""Adam on all samples or on batches of them, and LBFGS: named stop reasons, and always the best parameters met.

The objective is the only interface. ``objective(rows)`` returns its value over chosen samples (None: all) as a float and
leaves its gradient in the parameters' `grad`; the parameters are changed in place.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from torchmat.progress import progress
from torchmat.repeatable import one_thread
from torchmat.solvers.adam_steps import AdamSteps
from torchmat.solvers.clock import Watch
from torchmat.solvers.stop_reasons import BUDGET, CONVERGED, DIVERGED, NOT_FINITE, STEP_LIMIT

_PATIENCE = 25  # steps within which the lowest value must fall by the tolerance
_WORSE = 100.0  # times the value at the start: no useful step is that far uphill
_FLAT = 1.5  # times the value at the start: what goes to and fro above has not converged
_LOOK, _SMOOTH, _UPHILL, _NEARLY = 50, 0.98, 8.0, 1.05  # of batches
# A few samples may carry nearly all the energy, so that a running mean rises eightfold by chance: then, and at the end, two
# states are compared on the same batches, so many of the last ones, and this many times as much there is worse indeed.
_PAIRED, _WORSE_THERE = 8, 4.0
_NOTHING = 1e-4  # of the first value: below, batches of noise-free data differ by any factor
_WARM, _END = 20, 0.03  # steps until the full rate; share of it at the end
_BETAS = (0.9, 0.99)
_MEMORY, _STEPS_A_CALL, _VALUES_A_CALL = 20, 4, 60  # of LBFGS: pairs that it keeps, and steps and values between looks
_WALL = 1e3  # times the lowest value: what stands for one that is not finite
# torch's LBFGS forgets a pair of step and change of gradient whose product is below 1e-10, and squares slopes along a
# step. The objective is scaled so that the bound lies below what rounding leaves of the first value, squared, and no
# square overflows: to this first value, or to this length of the first gradient where that is less.
_FIRST_VALUE = {torch.float32: 1e10, torch.float64: 1e24}
_FIRST_GRADIENT = {torch.float32: 1e7, torch.float64: 1e60}
_RECOVERIES, _SHORTER = 3, 0.1  # of LBFGS after a step that is not finite, each with a shorter first step

Objective = Callable[[Tensor | None], float]


@dataclass
class Descent:
    """How far a descent came: the lowest value met, why it stopped, and (seconds, lowest value) as it went on."""

    value: float = math.inf
    reason: str = STEP_LIMIT
    steps: int = 0
    history: list[tuple[float, float]] = field(default_factory=list)


class _Best:
    """The best parameters met, and what is done at every new value: the clock, the curve, the history."""

    def __init__(self, parameters: Sequence[Tensor], watch: Watch, made: Callable[[], Any] | None) -> None:
        self.parameters, self.watch, self.made = parameters, watch, made
        self.kept = [value.detach().clone() for value in parameters]
        self.found = Descent()

    def look(self, value: float) -> bool:
        """Keep the parameters if `value` is the lowest so far; return whether value and gradient are finite."""
        # The sum of many finite numbers may overflow: that costs a step, and hides no NaN.
        finite = math.isfinite(value) and all(bool(torch.isfinite(p.grad).all()) for p in self.parameters if p.grad is not None)
        if finite and value < self.found.value:
            self.found.value = value
            self.kept = [parameter.detach().clone() for parameter in self.parameters]
        self.found.history.append((self.watch.seconds, self.found.value))
        return finite

    def note(self) -> None:
        """Add a point to the curve where it wants one."""
        if self.made is not None and self.watch.due:
            self.watch.note(self.made)

    def keep_last(self, value: float, lowest: float) -> None:
        """Take the present parameters for the best where their value is so, but for the noise of batches."""
        if value <= _NEARLY * lowest:
            self.kept = [parameter.detach().clone() for parameter in self.parameters]

    def compare(self, objective: Objective, batches: Sequence[Tensor]) -> tuple[float, float]:
        """Return the mean value over the same batches at the present parameters and at the best."""
        some = [batches[place] for place in torch.linspace(0, len(batches) - 1, min(_PAIRED, len(batches))).round().int().tolist()]
        last, found = [parameter.detach().clone() for parameter in self.parameters], []
        for values in (last, self.kept):
            self._set(values)
            found.append(sum(objective(rows) for rows in some) / len(some))
            _clear(self.parameters)
        self._set(last)
        return found[0], found[1]

    def _set(self, values: Sequence[Tensor]) -> None:
        with torch.no_grad():
            for parameter, value in zip(self.parameters, values, strict=True):
                parameter.copy_(value)

    def restore(self) -> None:
        """Bring the best parameters back."""
        self._set(self.kept)

    def end(self, reason: str) -> Descent:
        """Bring the best parameters back and say why."""
        self.restore()
        self.found.reason = reason
        return self.found


def _clear(parameters: Sequence[Tensor]) -> None:
    for parameter in parameters:
        parameter.grad = None


def adam(
    parameters: Sequence[Tensor], objective: Objective, *, rates: Sequence[float], steps: int, tolerance: float = 1e-4,
    until: float = math.inf, watch: Watch | None = None, made: Callable[[], Any] | None = None, show: bool | None = False,
) -> Descent:
    """Run Adam on the whole objective, with a rate for each parameter, the same throughout.

    It has converged when 25 steps lower the best value by less than `tolerance` of it, has diverged above a hundred
    times its first value, and stops at the watch's second `until` or its limit. `made` is what the curve measures.
    """
    watch = watch or Watch()
    best, first = _Best(parameters, watch, made), math.inf
    until = min(until, watch.limit)
    solver = AdamSteps(parameters, _BETAS)
    lowest: list[float] = []
    for step in progress(range(steps + 1), "fitting", show=show):
        _clear(parameters)
        value = objective(None)
        first = value if step == 0 else first
        if not best.look(value):
            return best.end(NOT_FINITE)
        best.note()
        if value > _WORSE * first:
            return best.end(DIVERGED)
        lowest.append(best.found.value)
        if value == 0 or (step >= _PATIENCE and lowest[-1] > lowest[-1 - _PATIENCE] * (1 - tolerance)):
            # A flat stretch far above the start is no minimum.
            return best.end(CONVERGED if value <= _FLAT * first else DIVERGED)
        spent = watch.seconds >= until
        if step == steps or spent:
            return best.end(BUDGET if spent else STEP_LIMIT)
        solver.step(rates)
        best.found.steps += 1
    return best.end(STEP_LIMIT)


def minibatch(
    parameters: Sequence[Tensor], objective: Objective, draw: Callable[[torch.Generator], Tensor], *, rates: Sequence[float],
    steps: int, batch: int, seed: int = 0, eps: float = 1e-8, until: float = math.inf, watch: Watch | None = None,
    made: Callable[[], Any] | None = None, show: bool | None = False,
) -> Descent:
    """Run Adam on `batch` samples at a time, a rate for each parameter, which falls along half a cosine.

    `draw` gives all samples in a random order, again and again. Values of batches are judged by their running mean. Where
    that is eight times its lowest the parameters are compared with the best on the same batches, and it has diverged if they
    are four times as bad there; at the end the last ones count as the best unless they are worse on the same batches.
    `until` is the watch's second at which it must stop, where that is before the watch's limit: rates then fall sooner.
    """
    watch = watch or Watch()
    best, running, first, begun = _Best(parameters, watch, made), None, math.inf, watch.seconds
    until = min(until, watch.limit)
    generator = torch.Generator().manual_seed(seed)
    solver = AdamSteps(parameters, _BETAS, eps)
    order, place = draw(generator), 0
    batch, recent, known = min(batch, len(order)), deque[Tensor](maxlen=_LOOK), 0.0
    for step in progress(range(steps + 1), "fitting", show=show):
        spent = watch.seconds >= until
        last = step == steps or spent
        # The last step is judged as well, on the batch that it was made for.
        if not last and place + batch > len(order):
            order, place = draw(generator), 0
        if not last or step == 0:
            rows, place = order[place : place + batch], place + batch
            recent.append(rows)
        _clear(parameters)
        value = objective(rows)
        running = value if running is None else _SMOOTH * running + (1 - _SMOOTH) * value
        first = value if step == 0 else first
        # A mean of few batches says little: the start is the best until there are more.
        judged = last or (step > 0 and step % _LOOK == 0)
        if not math.isfinite(value) or (judged and not best.look(running)):
            return best.end(NOT_FINITE)
        best.note()
        if running > _UPHILL * max(min(best.found.value, first), _NOTHING * first, known):
            now, lowest = best.compare(objective, list(recent))
            if not now <= _WORSE_THERE * lowest:
                return best.end(DIVERGED)
            best.keep_last(now, lowest)
            known, _ = running, objective(rows)  # the gradient of this step again
        if last:
            means = running, best.found.value
            best.keep_last(*(means if means[0] <= _NEARLY * means[1] else best.compare(objective, list(recent))))
            return best.end(BUDGET if spent and step < steps else STEP_LIMIT)
        # Nothing but a limit of seconds may make the steps depend on the clock.
        done = step / steps if until == math.inf else max(step / steps, (watch.seconds - begun) / max(until - begun, 1e-9))
        share = min(1.0, (step + 1) / _WARM) * (_END + (1 - _END) * 0.5 * (1 + math.cos(math.pi * min(done, 1.0))))
        solver.step([rate * share for rate in rates])
        best.found.steps += 1
    return best.end(STEP_LIMIT)


class _Spent(Exception):
    """Raised inside the objective, where LBFGS gives no other way out."""


def lbfgs(
    parameters: Sequence[Tensor], objective: Objective, *, steps: int, tolerance: float = 1e-5, first_step: float = 1.0,
    until: float = math.inf, watch: Watch | None = None, made: Callable[[], Any] | None = None, show: bool | None = False,
) -> Descent:
    """Run LBFGS with a strong Wolfe line search on the whole objective.

    A value that is not finite is a wall to the line search. Where that leaves it stuck it goes on from the best
    parameters, its memory forgotten and its first step a tenth, at most three times; then the reason is "not finite".
    It has converged when four steps lower the value, which must not be negative, by less than `tolerance` of it. The
    unit of the objective does not matter: the first step that is tried changes the parameters by `first_step` in all.
    """
    watch = watch or Watch()
    until = min(until, watch.limit)
    best, finite, scale = _Best(parameters, watch, made), True, 0.0

    def closure() -> Tensor:
        nonlocal finite, scale
        _clear(parameters)
        value = objective(None)
        good = best.look(value)
        if good:
            scale = scale or _scale_of(value, parameters)
            good = _scaled(parameters, scale)
        finite = finite and good
        if watch.seconds >= until:
            raise _Spent
        if not good:  # a slope of 0 on the wall halves the bracket; NaN would end in NaN parameters
            for parameter in parameters:
                parameter.grad = torch.zeros_like(parameter)
        return torch.tensor(scale * (value if good else _WALL * best.found.value) if scale else 1.0, dtype=torch.float64)

    solver, recoveries = _new_lbfgs(parameters, first_step), 0
    for _ in progress(range(-(-steps // _STEPS_A_CALL)), "fitting", show=show, each=_STEPS_A_CALL):
        before, finite = best.found.value, True
        try:
            solver.step(closure)
        except _Spent:
            return best.end(BUDGET)
        best.found.steps += _STEPS_A_CALL
        stalled = math.isfinite(before) and before - best.found.value <= tolerance * before
        if not finite and (stalled or not math.isfinite(best.found.value)):
            best.restore()
            recoveries += 1
            if recoveries > _RECOVERIES or not math.isfinite(best.found.value):
                return best.end(NOT_FINITE)
            solver = _new_lbfgs(parameters, first_step * _SHORTER**recoveries)
        elif stalled:
            return best.end(CONVERGED)
        best.note()
    return best.end(STEP_LIMIT)


def _scale_of(value: float, parameters: Sequence[Tensor]) -> float:
    """Return what the objective is multiplied with, a power of 2, from its first value and gradient."""
    kind = torch.float64 if all(parameter.dtype == torch.float64 for parameter in parameters) else torch.float32
    with one_thread():
        length = math.sqrt(sum(float(p.grad.double().square().sum()) for p in parameters if p.grad is not None))
    if not value > 0 or not length > 0:
        return 1.0
    return 2.0 ** round(min(math.log2(_FIRST_VALUE[kind] / value), math.log2(_FIRST_GRADIENT[kind] / length)))


def _scaled(parameters: Sequence[Tensor], scale: float) -> bool:
    """Multiply gradients with the scale; return whether they stay finite."""
    for parameter in parameters:
        if parameter.grad is not None:
            parameter.grad.mul_(scale)
    return all(bool(torch.isfinite(p.grad).all()) for p in parameters if p.grad is not None)


def _new_lbfgs(parameters: Sequence[Tensor], first_step: float) -> torch.optim.LBFGS:
    # Its own reasons to stop are off: they have no names.
    return torch.optim.LBFGS(
        parameters, lr=first_step, max_iter=_STEPS_A_CALL, max_eval=_VALUES_A_CALL, tolerance_grad=0, tolerance_change=0,
        history_size=_MEMORY, line_search_fn="strong_wolfe",
    )
