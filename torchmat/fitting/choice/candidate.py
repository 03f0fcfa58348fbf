"""A candidate of the automatic choice: a rung, fitted, with its material as it would be delivered."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from torch import Tensor

from torchmat.fitting.choice.ladder import Rung, named
from torchmat.fitting.choice.shrink import Shrunk
from torchmat.fitting.on_relief import fit_flat, fit_on_relief
from torchmat.fitting.training import Fitted, Training
from torchmat.models import Material


@dataclass(frozen=True)
class Option:
    """A candidate, fitted to part of the samples: `material` as it would be delivered, and its cost on the others.

    `cost_in_full` is that before its maps were stored smaller. `thin` says that it was fitted to some of the texels
    alone, `short` that it was not fitted to the end.
    """

    rung: Rung
    fitted: Fitted
    material: Material
    cost: float
    height: Tensor | None = None
    shrunk: Shrunk | None = None
    thin: bool = False
    short: bool = False
    cost_in_full: float = math.inf

    @property
    def name(self) -> str:
        """What the log calls it."""
        return named(self.rung, self.height)


def fit_flat_rung(training: Training, rung: Rung) -> Fitted:
    """Fit one candidate to a flat surface."""
    return fit_flat(replace(training, progress=False), rung.model, rung.settings)


def fit_rung(training: Training, rung: Rung, height: Tensor | None) -> Fitted:
    """Fit one candidate, flat or on a relief."""
    if height is None:
        return fit_flat_rung(training, rung)
    return fit_on_relief(replace(training, progress=False), rung.model, rung.settings, height)
