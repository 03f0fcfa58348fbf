"""AnalyticBrdf: one of the formulas with its numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Self

import torch
from torch import Tensor

from torchmat.brdf.analytic import ANALYTIC
from torchmat.brdf.base import Brdf
from torchmat.brdf.lobe import COLOURS, Lobe
from torchmat.errors import RangeError, ShapeError, check_finite, check_known_keys, check_option, message

_DEFAULTS = {"diffuse": 0.5, "specular": 0.04, "exponent": 50.0, "roughness": 0.3, "axis": 0.0}


class AnalyticBrdf(Brdf):
    """A formula of ANALYTIC: ``AnalyticBrdf("ggx", diffuse=(0.2, 0.1, 0.1), specular=0.04, roughness=0.3)``.

    `diffuse` and `specular` are one number or three (defaults 0.5 and 0.04); `exponent` (50) or `roughness` (0.3) the
    width of the lobe, itself and not its logarithm. Anisotropic formulas take it `_along` and `_across` too, and the
    angle `axis` (0) of the tangent in radians. `parameters` [P] is the tensor that the formula is given. Raises
    RangeError for a name or number that is not allowed.
    """

    reciprocal = True

    def __init__(self, name: str, *, dtype: torch.dtype = torch.float32, **numbers: float | Sequence[float]) -> None:
        check_option("AnalyticBrdf", "name", name, ANALYTIC)
        check_known_keys(f"AnalyticBrdf {name}", numbers, _keywords(ANALYTIC[name]))
        values = [_number(name, label, numbers) for label in ANALYTIC[name].names]
        self._set(name, torch.tensor(values, dtype=dtype))

    @classmethod
    def from_parameters(cls, name: str, parameters: Tensor) -> Self:
        """Return the BRDF of a tensor [..., P] as ANALYTIC orders it, kept as it is: gradients flow back to it.

        Leading dimensions broadcast with those of the directions. Raises ShapeError or RangeError when it does not
        fit the formula.
        """
        check_option("AnalyticBrdf", "name", name, ANALYTIC)
        made = cls.__new__(cls)
        made._set(name, parameters)
        return made

    def _set(self, name: str, parameters: Tensor) -> None:
        self.name = name
        self.lobe = ANALYTIC[name]
        if parameters.ndim < 1 or parameters.shape[-1] != len(self.lobe.names):
            requirement = f"be [..., {len(self.lobe.names)}]: {', '.join(self.lobe.names)}"
            raise ShapeError(message(name, "parameters", requirement, f"it is {tuple(parameters.shape)}"))
        _check_bounds(name, self.lobe, parameters.detach())
        self.parameters = parameters
        self.dtype = parameters.dtype
        # Without an axis, or as wide along it as across.
        sides = parameters.detach()[..., 6:8]
        self.isotropic = self.lobe.axis is None or bool((sides[..., 0] == sides[..., 1]).all())

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        """Return ``pi * f_r * cos(light)`` of the formula, [..., 3, h, w]."""
        return self.lobe.evaluate(self.parameters, light, view)


def _keywords(lobe: Lobe) -> list[str]:
    """Return the keywords of a formula: colours without channel, widths without "log_" and also without direction."""
    found: dict[str, None] = {}
    for name in lobe.names:
        plain = name.removeprefix("log_")
        if name in COLOURS:
            plain = name.removesuffix(name[-2:])
        stem = plain.removesuffix("_along").removesuffix("_across")
        found |= {stem: None, plain: None}
    return list(found)


def _number(where: str, label: str, numbers: dict[str, float | Sequence[float]]) -> float:
    """Return the parameter `label` from the keywords."""
    if label in COLOURS:
        colour, channel = label.rsplit("_", 1)
        given = numbers.get(colour, _DEFAULTS[colour])
        parts = _as_numbers(where, colour, given)
        if len(parts) not in (1, 3):
            raise ShapeError(message(where, colour, "be one number or three", f"it has {len(parts)}"))
        return (parts * 3)["rgb".index(channel)] if len(parts) == 1 else parts["rgb".index(channel)]
    plain = label.removeprefix("log_")
    stem = plain.removesuffix("_along").removesuffix("_across")
    values = _as_numbers(where, plain, numbers.get(plain, numbers.get(stem, _DEFAULTS[stem])))
    if len(values) != 1:
        raise ShapeError(message(where, plain, "be one number", f"it has {len(values)}"))
    value = values[0]
    if plain == label:
        return value
    if not value > 0:
        raise RangeError(message(where, plain, "be positive", f"it is {value:g}"))
    return math.log(value)


def _as_numbers(where: str, label: str, given: object) -> list[float]:
    """Return one or more numbers as a list; raises RangeError for what is none."""
    try:
        return torch.as_tensor(given, dtype=torch.float64).reshape(-1).tolist()
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        raise RangeError(message(where, label, "be numbers", f"it is {given!r}: {error}")) from error


def _check_bounds(where: str, lobe: Lobe, parameters: Tensor) -> None:
    check_finite(where, "parameters", parameters)
    # A logarithm in float32 may lie a rounding error beyond the bound that it was made from.
    slack = 1e-6
    for place, (label, low, high) in enumerate(zip(lobe.names, lobe.low, lobe.high, strict=True)):
        values = parameters[..., place]
        outside = (values < low - slack * abs(low)) | (values > high + slack * abs(high))
        if not bool(outside.any()):
            continue
        first = values[outside].detach().flatten()[0].double()
        if label.startswith("log_"):  # of a logarithm above 709 Python's own exponential has no value
            label, low, high, first = label.removeprefix("log_"), math.exp(low), math.exp(high), first.exp()
        raise RangeError(message(where, label, f"lie in [{low:.6g}, {high:.6g}]", f"it is {first:.6g}"))
