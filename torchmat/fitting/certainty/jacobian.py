"""What a residual changes by as a map does: forward derivatives of all texels at once, one pass for each way.

Texels do not mix, so one tangent serves all of them; and three ways that each change one colour alone share a pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.autograd import forward_ad

from torchmat.fitting.certainty.observed import Observed, Some
from torchmat.fitting.certainty.ways import RGB, Way, free_specs, ways_of
from torchmat.solvers.levenberg_marquardt import load_forward_rules

_STEP = 1e-4  # of the natural range: where torch has no forward rule, differences in double precision are as good
_PROBES = 6  # samples that show which colours a way changes


@dataclass(frozen=True)
class Pass:
    """Ways that are differentiated at once: of each its number and the colours that it changes."""

    way: Way
    numbers: tuple[int, ...]
    colours: tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Jacobian:
    """The derivatives of residuals after `ways`; `colours` says of each which of the three it changes."""

    ways: tuple[Way, ...]
    colours: tuple[tuple[int, ...], ...]
    passes: tuple[Pass, ...]

    def strip(self, rows: slice) -> Jacobian:
        """Return the same for some rows of texels."""
        ways = tuple(_strip(way, rows) for way in self.ways)
        return Jacobian(ways, self.colours, tuple(Pass(_strip(one.way, rows), one.numbers, one.colours) for one in self.passes))

    def of(self, observed: Observed, some: Some) -> Tensor:
        """Return d residual / d way, [k, 3, way, h, w], at some samples."""
        found = some.target.new_zeros(*some.target.shape[:2], len(self.ways), *some.target.shape[2:])
        for one in self.passes:
            change = derivative(observed, some, one.way)
            for number, colours in zip(one.numbers, one.colours, strict=True):
                for colour in colours:
                    found[:, colour, number] = change[:, colour]
        return found


def jacobian_of(observed: Observed) -> Jacobian:
    """Return the derivatives of a material's residuals after all that each of its texels has of its own."""
    ways = [way for spec in free_specs(observed.material) for way in _ways(observed, spec)]
    count = len(observed.btf)
    some = observed.some(torch.linspace(0, count - 1, min(_PROBES, count)).round().long().unique())
    colours = []
    for way in ways:
        changed = (derivative(observed, some, way) != 0).transpose(0, 1).flatten(1).any(dim=1)
        colours.append(tuple(changed.nonzero()[:, 0].tolist()))
    return Jacobian(tuple(ways), tuple(colours), tuple(_passes(ways, colours)))


def _ways(observed: Observed, spec) -> list[Way]:
    return ways_of(spec, observed.flat.maps[spec.name]) if spec.name in observed.flat.maps else []


def _passes(ways: list[Way], colours: list[tuple[int, ...]]) -> list[Pass]:
    """Return ways in as few passes as their colours allow: red, green and blue of one texture in one."""
    passes, number = [], 0
    while number < len(ways):
        three = ways[number : number + RGB]
        texture = [way.single for way in three] == [0, 1, 2] and len({way.name for way in three}) == 1
        if texture and all(colours[number + colour] == (colour,) for colour in range(RGB)):
            together = Way(three[0].name, torch.stack([way.tangent for way in three]).sum(dim=0), three[0].span)
            passes.append(Pass(together, tuple(range(number, number + RGB)), ((0,), (1,), (2,))))
            number += RGB
        else:
            # What changed nothing that was looked at may change something else.
            passes.append(Pass(ways[number], (number,), (colours[number] or (0, 1, 2),)))
            number += 1
    return passes


def derivative(observed: Observed, some: Some, way: Way) -> Tensor:
    """Return d residual / d way, [k, 3, h, w], at some samples."""
    maps = dict(observed.flat.maps.items())
    value = maps[way.name]
    tangent = way.tangent.expand_as(value).contiguous()
    load_forward_rules()
    try:
        with torch.no_grad(), forward_ad.dual_level():
            moved = {**maps, way.name: forward_ad.make_dual(value, tangent)}
            change = forward_ad.unpack_dual(observed.residual(moved, some)).tangent
            return torch.zeros_like(some.target) if change is None else change.clone()
    except NotImplementedError:
        return _by_differences(observed, some, way, tangent)


def _by_differences(observed: Observed, some: Some, way: Way, tangent: Tensor) -> Tensor:
    maps = {name: one.double() for name, one in observed.flat.maps.items()}
    step = _STEP * way.span * tangent.double()
    with torch.no_grad():
        ahead, behind = (observed.residual({**maps, way.name: maps[way.name] + one}, some) for one in (step, -step))
    return ((ahead - behind) / (2 * _STEP * way.span)).to(some.target.dtype)


def _strip(way: Way, rows: slice) -> Way:
    tangent = way.tangent if way.tangent.shape[-2:] == (1, 1) else way.tangent[..., rows, :]
    return Way(way.name, tangent, way.span, way.single)
