"""Any model by a solver that steps: from a start, all free maps together, against an objective.

The value of an objective is the weighted sum of its squares over that of a black picture: for "linear", that of the closed
forms, the relative error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import FitError
from torchmat.fitting.objective import LINEAR, Objective, Residual, mean_value
from torchmat.fitting.training import Fitted, Training
from torchmat.models import Material
from torchmat.models.unbounded import Unbounded
from torchmat.repeatable import one_thread
from torchmat.solvers import Descent, Problem, Stepping

Prior = Callable[[dict[str, Tensor]], Tensor]
_FEW = 24  # samples that the start is fitted to
_BATCH_VALUES, _FEWEST_IMAGES = 49152, 4  # texels x images of a batch, as many as stay in the processor's cache


def fit_by_descent(
    training: Training, fit: Callable[..., Fitted], solver: Stepping, options: dict[str, Any],
    objective: str | Residual = LINEAR,
) -> Fitted:
    """Fit the model of the function `fit` by `solver`, from what `fit` makes of two dozen samples."""
    with one_thread():
        begun = _start(training, fit, options)
    return descend(training, begun, solver, objective)


def descend(training: Training, begun: Fitted, solver: Stepping, objective: str | Residual = LINEAR) -> Fitted:
    """Fit the maps of a flat material by `solver`, from what they are.

    `begun` is the start, with what it says that all texels share. Deterministic: sums over all samples are made with
    one thread.
    """
    material = begun.material
    with one_thread():
        shared = [spec.name for spec in material.own_specs() if spec.constant or not spec.per_texel]
        unknowns = Unbounded(material.own_specs(), material.maps, shared if training.shared is not None else (), training.btf.mask)


        def made() -> Material:
            return begun.material.with_maps(**unknowns.made())

        found = run_descent(solver, training, unknowns, Seen(training, material), objective, made)
        material = made()
    figures = {**begun.figures, **figures_of(solver, found)}
    return Fitted(material, found.reason, None, figures, history=found.history, shared=begun.shared.moved_to(material))


def run_descent(
    solver: Stepping, training: Training, unknowns: Unbounded, seen: Seen, objective: str | Residual,
    made: Callable[[], Material], prior: Prior | None = None,
) -> Descent:
    """Change the unknowns by a solver to what the samples of `seen` want; `made` gives the material as it stands.

    A `prior` is what maps cost by themselves, in relative errors: what samples leave open goes where it is least.
    """
    misfit = Misfit(seen, unknowns, objective, prior)

    def draw(generator: torch.Generator) -> Tensor:
        return seen.samples[torch.randperm(len(seen.samples), generator=generator)]

    return solver.filled().descend(Problem(
        unknowns.parameters, misfit, unknowns.rates, draw, seen.run, training.seed, watch=training.watch, made=made,
        show=training.progress,
    ))


def figures_of(solver: Stepping, found: Descent) -> dict[str, Any]:
    """Return what a report says of a descent."""
    return {"solver": solver.filled().described(), "steps": found.steps, "objective": found.value}


def _start(training: Training, fit: Callable[..., Fitted], options: dict[str, Any]) -> Fitted:
    """Return the fit to a few samples, evenly chosen; of all where few do not determine the model at all."""
    rows = training.used.nonzero()[:, 0]
    few = torch.zeros_like(training.used)
    few[rows[torch.linspace(0, len(rows) - 1, min(_FEW, len(rows))).round().long()]] = True
    try:
        return fit(replace(training, used=few, progress=False), **options)
    except FitError:
        return fit(training, **options)


class Seen:
    """Training samples, and what a flat material and maps of it show of them."""

    def __init__(self, training: Training, material: Material) -> None:
        self.training, self.material = training, material
        self.samples = training.used.nonzero()[:, 0]
        self.run = max(_FEWEST_IMAGES, _BATCH_VALUES // (training.btf.height * training.btf.width))

    def predicted(self, maps: dict[str, Tensor], rows: Tensor) -> Tensor:
        """Return the values [k, 3, H, W] of samples `rows` with `maps` in place of the material's own."""
        light, view = self.training.planes(rows)
        return self.material.sharing({**self.material.maps, **maps}).value(light, view)

    def read(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return the measured values of samples `rows`, and what they count."""
        btf, dtype = self.training.btf, self.training.dtype
        return btf.images(rows, dtype), self.training.counted(btf.weights(rows).to(dtype), rows)

    def blocks(self) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Yield runs of training samples: their numbers, values and weights, as few as stay in the cache."""
        training = self.training
        for block in training.btf.blocks(training.used, training.dtype):
            rows = torch.arange(block.samples.start, block.samples.stop)
            for part in training.used[rows].nonzero()[:, 0].split(self.run):
                weight = torch.ones(1, 1, 1, 1, dtype=training.dtype) if block.weight is None else block.weight[part]
                yield rows[part], block.images[part], training.counted(weight.to(training.dtype), rows[part])


class Misfit:
    """The objective over samples, as a number and its gradient in the unknowns."""

    def __init__(
        self, seen: Seen, unknowns: Unbounded, objective: str | Residual = LINEAR, prior: Prior | None = None
    ) -> None:
        self.seen, self.unknowns, self.prior = seen, unknowns, prior
        # The linear error has no need of the data's level, which costs a pass over it.
        self.objective = Objective(objective, 1.0 if objective == LINEAR else mean_value(seen.training))
        self.size = self._size_of_black()

    def _size_of_black(self) -> float:
        total = 0.0
        for _, values, weight in self.seen.blocks():
            squares = self.objective.squares(torch.zeros_like(values), values, weight)
            total += float(squares.sum(dtype=torch.float64))
        # A residual of one's own, such as a logarithm, may say nothing of black.
        return max(total, 1e-30) if math.isfinite(total) else 1.0

    def __call__(self, rows: Tensor | None = None) -> float:
        """Return the value over samples `rows` (None: all) and leave the gradient in the parameters."""
        parts = self.seen.blocks() if rows is None else [(rows, *self.seen.read(rows))]
        share = 1.0 if rows is None else len(self.seen.samples) / len(rows)
        with torch.enable_grad():
            maps = self.unknowns.maps()
            # The parameters' own part is differentiated once, not once for each run of samples.
            leaves = {name: value.detach().requires_grad_() for name, value in maps.items()}
            total = sum(self._add(leaves, *part, share / self.size) for part in parts)
            if self.prior is not None and math.isfinite(total):
                cost = self.prior(leaves)
                total += float(cost.detach())
                cost.backward()
            gradients = [leaf.grad if leaf.grad is not None else torch.zeros_like(leaf) for leaf in leaves.values()]
            torch.autograd.backward(list(maps.values()), gradients)
        return total

    def _add(self, maps: dict[str, Tensor], rows: Tensor, values: Tensor, weight: Tensor, share: float) -> float:
        loss = self.objective.squares(self.seen.predicted(maps, rows), values, weight).sum() * share
        value = float(loss.detach())
        if math.isfinite(value):  # look-ups in places that are none may end the process
            loss.backward()
        return value
