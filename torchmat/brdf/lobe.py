"""Lobe: a reflectance formula with its parameters, as fits and renders both want it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

LOG_EXPONENT_RANGE = (math.log(1e-3), math.log(1e5))
COLOURS = ("diffuse_r", "diffuse_g", "diffuse_b", "specular_r", "specular_g", "specular_b")


class Lobe(NamedTuple):
    """Names and bounds of the P parameters, starting points for a fit, and the function.

    `evaluate(parameters [..., P], light, view)` takes planes [..., 3, h, w] and returns [..., 3, h, w]; parameters
    without leading dimensions serve every image. `jacobian`, where a formula is at hand, gives [..., 3, P] for
    directions [..., 3, 1, 1]; None leaves it to differentiation. `axis` is the number of the parameter that is the
    angle of a line, the same after half a turn.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    starts: tuple[tuple[float, ...], ...]
    evaluate: Callable[[Tensor, Tensor, Tensor], Tensor]
    jacobian: Callable[[Tensor, Tensor, Tensor], Tensor] | None = None
    axis: int | None = None


def column(parameters: Tensor, first: int, count: int = 1) -> Tensor:
    """Return parameters [..., count] from `first` on as planes [..., count, 1, 1]."""
    return parameters[..., first : first + count, None, None]
