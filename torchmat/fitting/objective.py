"""Objectives: what a fit that steps makes small, by name or as a user's own residual."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import RangeError, check_option, message
from torchmat.fitting.training import Training
from torchmat.repeatable import one_thread
from torchmat.solvers import Solver

Residual = Callable[[Tensor, Tensor, Tensor], Tensor]
LINEAR, DISPLAY = "linear", "display"
OBJECTIVES = (LINEAR, DISPLAY)
DISPLAY_POWER = 1 / 2.2
_DARKEST = 0.01  # of the mean value: differences below that no display shows
OUTSTANDING = 10  # times the usual texel: brighter ones count as that bright where one number stands for all


def check_objective(where: str, asked: object, more: tuple[str, ...] = ()) -> None:
    """Raise RangeError, with the choices, unless `asked` is the name of an objective or a callable."""
    if not callable(asked):
        own = "a callable residual(predicted, target, weight)"
        check_option(where, "objective", asked, dict.fromkeys((*more, *OBJECTIVES, own)))


def describe_objective(asked: str | Residual) -> str:
    """Return an objective as reports hold it: its name, or where a callable stands."""
    if isinstance(asked, str):
        return asked
    return f"{getattr(asked, '__module__', None)}.{getattr(asked, '__qualname__', type(asked).__qualname__)}"


def power(base: Tensor, exponent: float) -> Tensor:
    """Return base ^ exponent, to the same bits on any number of threads."""
    # torch's own power rounds otherwise in what remains of a thread's share; exp and log do not.
    return (base.log() * exponent).exp()


def shown(values: Tensor, darkest: float) -> Tensor:
    """Return what a display makes of values, ``(x + darkest) ^ (1 / 2.2)``; negative ones are black."""
    return power(values.clamp(min=0) + darkest, DISPLAY_POWER)


class Objective:
    """Squared residuals of one objective, for data of one `level` (`mean_value`), its unit.

    "linear" is predicted - target; "display" the same after the display's root, where a step in the dark counts as much
    as one in the light. Both count as their samples do. A callable residual(predicted, target, weight) gets values
    [k, 3, H, W] and what they count, [k, 1, H, W] or one that broadcasts, and returns residuals whose squares are
    summed; what has no weight must not count.
    """

    def __init__(self, asked: str | Residual, level: float) -> None:
        self.asked, self.level = asked, level
        self.darkest = _DARKEST * level

    @property
    def unit(self) -> float:
        """The size of a squared residual."""
        return self.level ** (2 * DISPLAY_POWER) if self.asked == DISPLAY else self.level**2

    def squares(self, predicted: Tensor, target: Tensor, weight: Tensor) -> Tensor:
        """Return squared residuals, weighted; gradients pass through."""
        if self.asked == LINEAR:
            return weight * (predicted - target).square()
        if self.asked == DISPLAY:
            return weight * (shown(predicted, self.darkest) - shown(target, self.darkest)).square()
        assert not isinstance(self.asked, str)
        found = self.asked(predicted, target, weight)
        if not isinstance(found, Tensor) or not found.is_floating_point():
            fact = f"it returns {found.dtype if isinstance(found, Tensor) else type(found).__name__}"
            raise RangeError(message("fit", "objective", "return a tensor of residuals", fact))
        if predicted.requires_grad and not found.requires_grad:
            step = "Compute it with torch from `predicted`, without detach or no_grad."
            raise RangeError(message("fit", "objective", "have a gradient", "what it returns has none", step))
        return found.square()


    def residuals(self, predicted: Tensor, target: Tensor, weight: Tensor) -> Tensor:
        """Return the residuals whose squares `squares` returns, with their signs; derivatives pass through `predicted`."""
        if self.asked == LINEAR:
            return weight.sqrt() * (predicted - target)
        if self.asked == DISPLAY:
            return weight.sqrt() * (shown(predicted, self.darkest) - shown(target, self.darkest))
        assert not isinstance(self.asked, str)
        return self.asked(predicted, target, weight)


def white_of(level: float) -> float:
    """Return the value shown as white for data of this mean: 1 by convention, or of another unit ten times the mean."""
    return 1.0 if 0.01 < level < 10 else 10 * level


def mean_value(training: Training) -> float:
    """Return the mean of the training samples: the unit of a fit."""
    btf, every = training.btf, bool(training.used.all())
    total = torch.zeros(btf.height, btf.width, dtype=torch.float64)
    for block in btf.blocks(None if every else training.used, training.dtype):
        images = block.images if every else block.images[training.used[block.samples.start : block.samples.stop]]
        total += images.mean(dim=1, dtype=torch.float64).sum(dim=0)
    each = total / max(int(training.used.sum()), 1)
    each = each if btf.mask is None else each[btf.mask]
    if not each.numel():
        return 1e-12
    usual = each[each > 0].median() if bool((each > 0).any()) else each.max()
    with one_thread():
        # One texel a million times as bright as the cloth must not decide what is dark.
        return max(float(each.clamp(max=OUTSTANDING * usual).mean()), 1e-12)


def described(options: dict[str, Any]) -> dict[str, Any]:
    """Return a fit's options as JSON holds them: solver and objective by name, or the settings beside it."""
    found = dict(options)
    if isinstance(found.get("solver"), Solver):
        found["solver"] = found["solver"].described()
    if "objective" in found:
        found["objective"] = describe_objective(found["objective"])
    return found
