"""Any registered model by a solver that steps: from a cheap start, all free maps together, against its own objective.

The objective is that of the closed forms: squared linear error, weighted as the samples are, over their squared sum.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import FitError
from torchmat.fitting.models.unbounded import Unbounded
from torchmat.fitting.training import Fitted, Training
from torchmat.repeatable import one_thread
from torchmat.solvers import Descent, adam, lbfgs, minibatch

DESCENTS = ("adam", "minibatch", "lbfgs")
_FEW = 24  # samples that the start is fitted to
_BATCH_VALUES, _FEWEST_IMAGES = 49152, 4  # texels x images of a batch, as many as stay in the processor's cache
_RATES = {"adam": 0.03, "minibatch": 0.03}
_STEPS = {"adam": 500, "minibatch": 1000, "lbfgs": 200}


def fit_by_descent(
    training: Training, fit: Callable[..., Fitted], solver: str, options: dict[str, Any], *, rate: float | None = None,
    steps: int | None = None, tolerance: float | None = None,
) -> Fitted:
    """Fit the model of the function `fit` by `solver`, from what `fit` makes of two dozen samples.

    `rate`, `steps` and `tolerance` are the solver's own; None leaves them to the solver.
    """
    with one_thread():
        begun = _start(training, fit, options)
    return descend(training, begun, solver, rate=rate, steps=steps, tolerance=tolerance)


def descend(
    training: Training, begun: Fitted, solver: str, *, keep: Sequence[str] = (), rate: float | None = None,
    steps: int | None = None, tolerance: float | None = None,
) -> Fitted:
    """Fit the maps of a flat material by `solver`, from what they are; those named in `keep` stay to the bit.

    `begun` is the start, with what it says that all texels share. Deterministic: sums over all samples are made with
    one thread.
    """
    with one_thread():
        shared = [spec.name for spec in begun.material.own_specs() if spec.constant or not spec.per_texel]
        unknowns = Unbounded(begun.material, (*keep, *(shared if training.shared is not None else ())))
        run = functools.partial(_RUNS[solver], training, unknowns)
        settings = {"rate": rate or _RATES.get(solver), "steps": _STEPS[solver] if steps is None else steps, "tolerance": tolerance}
        found = run(**{name: value for name, value in settings.items() if value is not None})
        material = unknowns.made()
    figures = {**begun.figures, "solver": solver, "steps": found.steps, "objective": found.value}
    return Fitted(material, found.reason, None, figures, history=found.history, shared=begun.shared.moved_to(material))


def _start(training: Training, fit: Callable[..., Fitted], options: dict[str, Any]) -> Fitted:
    """Return the fit to a few samples, evenly chosen; of all where few do not determine the model at all."""
    rows = training.used.nonzero()[:, 0]
    few = torch.zeros_like(training.used)
    few[rows[torch.linspace(0, len(rows) - 1, min(_FEW, len(rows))).round().long()]] = True
    try:
        return fit(replace(training, used=few, progress=False), **options)
    except FitError:
        return fit(training, **options)


class Objective:
    """Weighted squared error over the weighted squares of the values, and its gradient."""

    def __init__(self, training: Training, unknowns: Unbounded) -> None:
        self.training, self.unknowns = training, unknowns
        self.samples = training.used.nonzero()[:, 0]
        self.texels = training.btf.height * training.btf.width
        self.run = max(_FEWEST_IMAGES, _BATCH_VALUES // self.texels)
        self.size = max(sum(float((w * y.square()).sum(dtype=torch.float64)) for _, y, w in self._blocks()), 1e-30)

    def __call__(self, rows: Tensor | None = None) -> float:
        """Return the value over samples `rows` (None: all) and leave the gradient in the parameters."""
        parts = self._blocks() if rows is None else [(rows, *self._read(rows))]
        share = 1.0 if rows is None else len(self.samples) / len(rows)
        with torch.enable_grad():
            maps = self.unknowns.maps()
            # The parameters' own part is differentiated once, not once for each run of samples.
            leaves = {name: value.detach().requires_grad_() for name, value in maps.items()}
            material = self.unknowns.material.sharing({**self.unknowns.material.maps, **leaves})
            total = sum(self._add(material, *part, share / self.size) for part in parts)
            gradients = [leaf.grad if leaf.grad is not None else torch.zeros_like(leaf) for leaf in leaves.values()]
            torch.autograd.backward(list(maps.values()), gradients)
        return total

    def _add(self, material: Any, rows: Tensor, values: Tensor, weight: Tensor, share: float) -> float:
        light, view = (planes[rows].to(values.dtype) for planes in (self.training.light, self.training.view))
        gap = material.value(light, view) - values
        loss = (weight * gap.square()).sum() * share
        value = float(loss.detach())
        if math.isfinite(value):  # look-ups in places that are none may end the process
            loss.backward()
        return value

    def _blocks(self) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Yield runs of training samples: their numbers, values and weights, as few as stay in the cache."""
        training = self.training
        for block in training.btf.blocks(training.used, training.dtype):
            rows = torch.arange(block.samples.start, block.samples.stop)
            for part in training.used[rows].nonzero()[:, 0].split(self.run):
                weight = torch.ones(1, 1, 1, 1, dtype=training.dtype) if block.weight is None else block.weight[part]
                yield rows[part], block.images[part], training.counted(weight.to(training.dtype), rows[part])

    def _read(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        btf, dtype = self.training.btf, self.training.dtype
        return btf.images(rows, dtype), self.training.counted(btf.weights(rows).to(dtype), rows)


def _adam(training: Training, unknowns: Unbounded, rate: float, **settings: Any) -> Descent:
    settings |= {"watch": training.watch, "made": unknowns.made, "show": training.progress}
    rates = [rate] * len(unknowns.parameters)
    return adam(unknowns.parameters, Objective(training, unknowns), rates=rates, **settings)


def _lbfgs(training: Training, unknowns: Unbounded, **settings: Any) -> Descent:
    settings |= {"watch": training.watch, "made": unknowns.made, "show": training.progress}
    return lbfgs(unknowns.parameters, Objective(training, unknowns), **settings)


def _minibatch(training: Training, unknowns: Unbounded, rate: float, steps: int) -> Descent:
    objective, parameters = Objective(training, unknowns), unknowns.parameters

    def draw(generator: torch.Generator) -> Tensor:
        return objective.samples[torch.randperm(len(objective.samples), generator=generator)]

    return minibatch(
        parameters, objective, draw, rates=[rate] * len(parameters), steps=steps, batch=objective.run, seed=training.seed,
        watch=training.watch, made=unknowns.made, show=training.progress,
    )


_RUNS: dict[str, Callable[..., Descent]] = {"adam": _adam, "minibatch": _minibatch, "lbfgs": _lbfgs}
