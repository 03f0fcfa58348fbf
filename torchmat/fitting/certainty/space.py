"""The space in which a fit's residuals lie: linear light, the codes of a screen, or what an objective makes of values."""

from __future__ import annotations

from torch import Tensor

from torchmat.fitting.models.linear import encoded
from torchmat.fitting.objective import DISPLAY, LINEAR, OBJECTIVES, Objective, Residual, describe_objective, mean_value
from torchmat.fitting.recipe import RECIPES
from torchmat.fitting.training import Training
from torchmat.models import Material


class Space:
    """What a fit made small: the squares of `residual`.

    Of a model whose maps sum to codes of a screen (`Material.in_codes`) predictions are such codes, unless an `objective` is
    named; else the objective decides, where none is named that of the model's recipe.
    """

    def __init__(self, material: Material, training: Training, objective: str | Residual | None = None) -> None:
        self.codes = objective is None and material.in_codes() is not None
        asked: str | Residual = LINEAR if material.name not in RECIPES else RECIPES[material.name].objective
        asked = asked if objective is None else objective
        # A model's own objective under a name of its own is a root of the values too.
        asked = DISPLAY if isinstance(asked, str) and asked not in OBJECTIVES else asked
        self._objective = Objective(asked, 1.0 if asked == LINEAR else mean_value(training))
        self.name = "srgb" if self.codes else describe_objective(asked)

    def residual(self, predicted: Tensor, target: Tensor, weight: Tensor) -> Tensor:
        """Return weighted residuals [k, 3, H, W]; derivatives pass through `predicted`."""
        if self.codes:
            return weight.sqrt() * (predicted - encoded(target))
        return self._objective.residuals(predicted, target, weight)


def is_linear(material: Material) -> bool:
    """Return whether the value of a material is linear in all maps that each texel has of its own."""
    return all(spec.linear for spec in material.own_specs() if spec.per_texel and not spec.constant and not spec.index)
