"""Maps as unbounded parameters: what a solver may change freely, and how it becomes a map within its range again."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchmat import safe
from torchmat.models import Material
from torchmat.models.storage import MapSpec
from torchmat.repeatable import one_thread

_LEAST = 1e-3  # of a map's mean, or of its range: from a bound itself a logarithm never comes back
_SMALLEST = 0.1  # of the usual size of constants: none is so small that it cannot move
_GIVEN = ("directions",)  # what was measured and not what is to be found
_UNIT = ("normal", "rotation")


class Unbounded:
    """The free maps of a material as parameters: logarithms, logits, or multiples of what the map usually is.

    `names` are the maps that are free: floats that say nothing of which sample was measured where, and no indices.
    """

    def __init__(self, material: Material, fixed: Sequence[str] = ()) -> None:
        self.material = material
        kept = (*_GIVEN, *fixed)
        self._ways = {spec.name: _Way(spec, material.maps[spec.name].detach()) for spec in material.own_specs()
                      if not spec.index and spec.name not in kept}
        self.names = list(self._ways)
        self.parameters = [way.start.clone().requires_grad_() for way in self._ways.values()]

    def maps(self) -> dict[str, Tensor]:
        """Return the maps that the parameters stand for now; gradients pass through."""
        return {name: way.map_of(value) for (name, way), value in zip(self._ways.items(), self.parameters, strict=True)}

    def made(self) -> Material:
        """Return the material as it stands."""
        with torch.no_grad():
            return self.material.with_maps(**{name: value.detach().clone() for name, value in self.maps().items()})


class _Way:
    """How one map is parametrised."""

    def __init__(self, spec: MapSpec, value: Tensor) -> None:
        self.low, self.high, self.unit = spec.low, spec.high, spec.name in _UNIT
        with one_thread():
            usual = float(value.double().square().mean().sqrt()) or 1.0
        if self.unit:
            self.start = value
        elif self.low is None:
            # Constants have units of their own each; the values of a map have one.
            self.scale = value.abs().clamp(min=_SMALLEST * usual) if spec.constant else torch.tensor(usual, dtype=value.dtype)
            self.start = value / self.scale
        elif self.high is None:
            self.start = (value - self.low).clamp(min=_LEAST * usual).log()
        else:
            share = ((value - self.low) / (self.high - self.low)).clamp(_LEAST, 1 - _LEAST)
            self.start = torch.logit(share)

    def map_of(self, parameter: Tensor) -> Tensor:
        """Return the map that a parameter stands for."""
        if self.unit:
            return safe.normalise(parameter)
        if self.low is None:
            return parameter * self.scale
        if self.high is None:
            return self.low + parameter.exp()
        # torch's sigmoid rounds otherwise in what remains of a thread's share; exp does not.
        return self.low + (self.high - self.low) / (1 + (-parameter).exp())
