"""Maps as unbounded parameters: what a descent may change freely, and how it becomes a map within its range again.

The one place where that is decided, from what a map's spec says: values with a lower bound are logarithms, those between
two bounds logits, others multiples of what is usual; a unit normal is its slopes, a rotation its angle, and weights that
sum to 1 are exponentials over their sum. Sigmoid, softmax and power of torch round otherwise in what remains of a
thread's share; exp and log do not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor, nn

from torchmat import safe
from torchmat.geometry import normals_from_slopes, slopes_from_normals
from torchmat.models.storage import MapSpec
from torchmat.repeatable import one_thread

_LEAST = 1e-4  # of a map's usual size, or of its range: from a bound itself a logarithm never comes back
_SMALLEST = 0.1  # of the usual size of constants: none is so small that it cannot move
# Relative to the solver's rate: slopes are small numbers; tables and weights see many samples a step and can go faster.
_SLOPES, _QUICK = 0.3, 2.0


def map_of(spec: MapSpec, parameter: Tensor, scale: Tensor | None = None) -> Tensor:
    """Return the map that a parameter stands for; gradients pass through. `scale` is that of a value without bounds."""
    if spec.kind == "normal":
        return normals_from_slopes(parameter)
    if spec.kind == "rotation":
        return torch.cat((torch.cos(parameter), torch.sin(parameter)))
    if spec.kind == "weights":
        weight = (parameter - parameter.detach().amax(dim=0)).exp()
        return weight / weight.sum(dim=0)
    if spec.low is None:
        return parameter if scale is None else parameter * scale
    if spec.high is None:
        return spec.low + parameter.exp() if spec.low else parameter.exp()
    return spec.low + (spec.high - spec.low) / (1 + (-parameter).exp())


def parameter_of(spec: MapSpec, value: Tensor, scale: Tensor | None = None, known: Tensor | None = None) -> Tensor:
    """Return the parameter that stands for a map, whose values are moved off the ends of their range.

    `known` are those of its values that say what is usual, None for all.
    """
    if spec.kind == "normal":
        return slopes_from_normals(safe.normalise(value)).clone()
    if spec.kind == "rotation":
        return torch.atan2(value[1:], value[:1])
    if spec.kind == "weights":
        return value.clamp(min=_LEAST).log()
    if spec.low is None:
        return value.clone() if scale is None else value / scale
    if spec.high is None:
        return (value - spec.low).clamp(min=_LEAST * usual_size(value if known is None else known)).log()
    return torch.logit(((value - spec.low) / (spec.high - spec.low)).clamp(_LEAST, 1 - _LEAST))


def relative_rate(spec: MapSpec) -> float:
    """Return how fast a map's parameter may go, relative to those of other maps."""
    if spec.kind == "normal":
        return _SLOPES
    table = not spec.per_texel and not spec.constant and spec.low is not None and spec.high is None
    return _QUICK if table or spec.kind == "weights" else 1.0


def usual_size(value: Tensor) -> float:
    """Return the root of the mean square of a map, 1 for one that is 0 everywhere."""
    with one_thread():
        return float(value.double().square().mean().sqrt()) or 1.0


def is_free(spec: MapSpec) -> bool:
    """Return whether a descent may change the map: not which sample was measured where, and no index."""
    return not spec.index and not spec.fixed


class Unbounded:
    """The free ones of some maps as parameters, leaves that gradients reach.

    `specs` say what the `maps` are; those in `fixed` stay as they are, with those that never are free (`is_free`).
    `rates` are how fast each parameter may go, relative to the others. What is usual is that of the texels of an object's
    `mask`, bool [H, W], None for all.
    """

    def __init__(
        self, specs: Iterable[MapSpec], maps: Mapping[str, Tensor] | nn.ParameterDict, fixed: Iterable[str] = (),
        mask: Tensor | None = None,
    ) -> None:
        fixed = set(fixed)
        self.specs = {spec.name: spec for spec in specs if is_free(spec) and spec.name not in fixed}
        values = {name: maps[name].detach() for name in self.specs}
        known = {name: _inside(self.specs[name], value, mask) for name, value in values.items()}
        self._scales = {name: _scale_of(self.specs[name], value) for name, value in known.items()}
        self.parameters = [
            parameter_of(spec, values[name], self._scales[name], known[name]).requires_grad_() for name, spec in self.specs.items()
        ]

    @property
    def names(self) -> list[str]:
        """The free maps."""
        return list(self.specs)

    @property
    def rates(self) -> list[float]:
        """How fast each parameter may go, relative to the others."""
        return [relative_rate(spec) for spec in self.specs.values()]

    def maps(self) -> dict[str, Tensor]:
        """Return the maps that the parameters stand for now; gradients pass through."""
        return {
            name: map_of(spec, value, self._scales[name])
            for (name, spec), value in zip(self.specs.items(), self.parameters, strict=True)
        }

    def made(self) -> dict[str, Tensor]:
        """Return the maps as they stand, as tensors of their own."""
        with torch.no_grad():
            return {name: value.detach().clone() for name, value in self.maps().items()}


def _inside(spec: MapSpec, value: Tensor, mask: Tensor | None) -> Tensor:
    """Return the values of a map on an object, all of them without a mask and of what all texels share."""
    shared = spec.constant or not spec.per_texel
    return value if mask is None or shared or not bool(mask.any()) else value[:, mask]


def _scale_of(spec: MapSpec, value: Tensor) -> Tensor | None:
    """Return what the parameter of a value without bounds is multiplied with."""
    if spec.kind != "value" or spec.low is not None:
        return None
    usual = usual_size(value)
    # Constants have units of their own each; the values of a map have one.
    return value.abs().clamp(min=_SMALLEST * usual) if spec.constant else torch.tensor(usual, dtype=value.dtype)
