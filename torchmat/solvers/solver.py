"""Solvers as objects: what may be asked for, with its settings, and how those that step run on an objective."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from torchmat.errors import RangeError, check_known_keys, check_option, message
from torchmat.solvers.clock import Watch
from torchmat.solvers.descent import Descent, Objective, adam, lbfgs, minibatch


_MOST = 1e30  # of any setting: beyond, float32 overflows


@dataclass
class Problem:
    """What a solver that steps is given.

    `parameters` are changed in place; `objective` (rows, or None for all samples) returns its value and leaves its
    gradient in them. `rates` [parameter] are relative to the solver's own. `draw` gives all samples in a random order,
    of which `batch` are taken at a time, and `eps` is the gradient that counts as none: both are Minibatch's. `until`,
    `watch`, `made` and `show` are those of `solvers.descent`.
    """

    parameters: Sequence[Tensor]
    objective: Objective
    rates: Sequence[float]
    draw: Callable[[torch.Generator], Tensor]
    batch: int
    seed: int = 0
    eps: float = 1e-8
    until: float = math.inf
    watch: Watch | None = None
    made: Callable[[], Any] | None = None
    show: bool | None = False

    @property
    def _told(self) -> dict[str, Any]:
        return {"until": self.until, "watch": self.watch, "made": self.made, "show": self.show}


@dataclass(frozen=True)
class Solver:
    """A way to find a model's numbers. Settings that are None are left to the model that is fitted."""

    name: ClassVar[str] = ""
    usual: ClassVar[Mapping[str, Any]] = {}

    def __post_init__(self) -> None:
        for name, value in self.given.items():
            whole, where = name in ("steps", "batch"), type(self).__name__
            kind = int if whole else (int, float)
            if not isinstance(value, kind) or isinstance(value, bool) or not 0 < value <= _MOST:
                requirement = "be a whole number of at least 1" if whole else f"be a positive number of at most {_MOST:g}"
                raise RangeError(message(where, name, requirement, f"it is {value!r}", "None leaves it to the model."))

    @property
    def given(self) -> dict[str, Any]:
        """The settings that are not left to the model."""
        return {name: value for name, value in vars(self).items() if value is not None}

    def filled(self, **usual: Any) -> Self:
        """Return the solver with settings for what is None: those given here, or else what is usual of the solver."""
        known = {field.name for field in dataclasses.fields(self)} - set(self.given)
        found = {**self.usual, **{name: value for name, value in usual.items() if value is not None}}
        return dataclasses.replace(self, **{name: value for name, value in found.items() if name in known})

    def described(self) -> str | dict[str, Any]:
        """Return the solver as reports and configs hold it: its name, with settings a table."""
        return {"name": self.name, **self.given} if self.given else self.name


@dataclass(frozen=True)
class Stepping(Solver):
    """A solver that goes step by step, down from a start: any objective, any parameters."""

    steps: int | None = None

    def descend(self, problem: Problem) -> Descent:
        """Change the problem's parameters to the best that are met; no setting may be None but a tolerance or batch."""
        raise NotImplementedError


@dataclass(frozen=True)
class Adam(Stepping):
    """Adam on all samples at each step, at one rate.

    Args:
        steps: the most, at least 1; None is left to the model.
        rate: length of a step, above 0; None is left to the model.
        tolerance: it stops when nothing falls by this share, above 0; None is 1e-4.
    """

    rate: float | None = None
    tolerance: float | None = None
    name = "adam"
    usual = {"steps": 500, "rate": 0.03}

    def descend(self, problem: Problem) -> Descent:
        assert self.steps is not None and self.rate is not None
        tolerance: dict[str, Any] = {} if self.tolerance is None else {"tolerance": self.tolerance}
        rates = [self.rate * one for one in problem.rates]
        return adam(problem.parameters, problem.objective, rates=rates, steps=self.steps, **tolerance, **problem._told)


@dataclass(frozen=True)
class Minibatch(Stepping):
    """Adam on random samples at each step, at a rate that falls along half a cosine over the steps.

    Args:
        steps: how many, at least 1; None is left to the model.
        rate: length of the first step, above 0; None is left to the model.
        batch: samples of a step, at least 1; None is left to the model.
    """

    rate: float | None = None
    batch: int | None = None
    name = "minibatch"
    usual = {"steps": 1000, "rate": 0.03}

    def descend(self, problem: Problem) -> Descent:
        assert self.steps is not None and self.rate is not None
        rates = [self.rate * one for one in problem.rates]
        return minibatch(
            problem.parameters, problem.objective, problem.draw, rates=rates, steps=self.steps,
            batch=self.batch or problem.batch, seed=problem.seed, eps=problem.eps, **problem._told,
        )


@dataclass(frozen=True)
class LBFGS(Stepping):
    """LBFGS with a strong Wolfe line search on all samples.

    Args:
        steps: the most, at least 1; None is left to the model.
        tolerance: it stops when four steps lower nothing by this share, above 0; None is 1e-5.
    """

    tolerance: float | None = None
    name = "lbfgs"
    usual = {"steps": 200}

    def descend(self, problem: Problem) -> Descent:
        assert self.steps is not None
        tolerance: dict[str, Any] = {} if self.tolerance is None else {"tolerance": self.tolerance}
        return lbfgs(problem.parameters, problem.objective, steps=self.steps, **tolerance, **problem._told)


@dataclass(frozen=True)
class ClosedForm(Solver):
    """Solved at once, as what is linear can be: there is nothing to set."""

    name = "closed_form"


@dataclass(frozen=True)
class LevenbergMarquardt(Solver):
    """Levenberg-Marquardt for the few numbers that all texels share, and the maps in closed form after it.

    Args:
        steps: the most, at least 1; None is 100.
        tolerance: it stops when a step promises or brings less than this share of the cost, above 0; None is 1e-10.
    """

    steps: int | None = None
    tolerance: float | None = None
    name = "lm"
    usual = {"steps": 100, "tolerance": 1e-10}


@dataclass(frozen=True)
class VariableProjection(LevenbergMarquardt):
    """Levenberg-Marquardt for the shared numbers with which the maps, in closed form, leave least (Golub & Pereyra 1973).

    Args:
        steps: the most, at least 1; None is left to the model.
        tolerance: it stops when a step promises or brings less than this share of the cost, above 0; None is left to the
            model.
    """

    name = "varpro"


SOLVERS: dict[str, type[Solver]] = {
    kind.name: kind for kind in (ClosedForm, LevenbergMarquardt, VariableProjection, Adam, Minibatch, LBFGS)
}
DESCENTS = tuple(kind.name for kind in (Adam, Minibatch, LBFGS))


def as_solver(where: str, asked: Any, names: Sequence[str]) -> Solver:
    """Return the Solver that a name, a table with a name and settings, or an object asks for.

    Raises RangeError, with what to give, unless it is one of `names`.
    """
    if isinstance(asked, type) and issubclass(asked, Solver):
        asked = asked()
    if isinstance(asked, Mapping):
        settings = dict(asked)
        kind = SOLVERS[_checked(where, settings.pop("name", None), names)]
        check_known_keys(f"{where} solver {kind.name}", settings, [field.name for field in dataclasses.fields(kind)])
        return kind(**settings)
    if isinstance(asked, Solver):
        _checked(where, asked.name, names)
        return asked
    return SOLVERS[_checked(where, asked, names)]()


def _checked(where: str, name: object, names: Sequence[str]) -> str:
    check_option(where, "solver", name, names)
    return str(name)
