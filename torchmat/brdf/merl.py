"""MerlBrdf: isotropic reflectance in a table over half and difference angles, as in the MERL database.

Matusik, Pfister, Brand & McMillan 2003, "A data-driven reflectance model"; the bins are those of the database's own
`BRDFRead.cpp`: polar half angle by its square root, so that the highlight is finely sampled, polar difference angle
evenly, azimuth of the difference over half a turn, because light and view may change places.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchmat import safe
from torchmat.brdf.base import Brdf
from torchmat.brdf.half_difference import from_half_difference, to_half_difference
from torchmat.errors import RangeError, ShapeError, check_finite, check_option, message

MERL_RESOLUTION = (90, 90, 180)


class MerlBrdf(Brdf):
    """A table [3 or 1, half polar, difference polar, difference azimuth] of ``f_r`` in 1/sr, not negative.

    Any resolution will do; MERL's is 90 x 90 x 180. One channel means grey. The value is differentiable in the table
    and the directions. `interpolation` "linear" takes the entries for the centres of their bins and blends the eight
    around a point: across the ends of the azimuth; beyond the first and last centre of the polar angles the entry goes
    on. Where the azimuth is undefined (light = view, half = normal) the mean over it is taken, faded in over the first
    half bin, so that the value is continuous. "nearest" takes the bin that a point lies in, as the database's own code
    does: a staircase. `missing` [half, difference, azimuth] marks entries that were not measured, if any; what they
    hold was filled in. Raises ShapeError or RangeError when the table is not of that kind.
    """

    name = "merl"
    reciprocal = True

    def __init__(self, table: Tensor, *, interpolation: str = "linear", missing: Tensor | None = None) -> None:
        check_option(self.name, "interpolation", interpolation, ("linear", "nearest"))
        if table.ndim != 4 or table.shape[0] not in (1, 3) or 0 in table.shape:
            requirement = "be [3, half, difference, azimuth] or [1, ...]"
            raise ShapeError(message(self.name, "table", requirement, f"it is {tuple(table.shape)}"))
        if missing is not None and missing.shape != table.shape[1:]:
            fact = f"it is {tuple(missing.shape)}"
            raise ShapeError(message(self.name, "missing", f"be {tuple(table.shape[1:])}", fact))
        check_finite(self.name, "table", table.detach())
        negative = int((table.detach() < 0).sum())
        if negative:
            step = "Fill missing entries first (fill_missing)."
            raise RangeError(message(self.name, "table", "be at least 0", f"{negative} entries are negative", step))
        self.table = table
        self.interpolation = interpolation
        self.missing = missing
        self.dtype = table.dtype

    @property
    def resolution(self) -> tuple[int, int, int]:
        """Bins of the half polar, difference polar and difference azimuth angle."""
        half, difference, azimuth = self.table.shape[1:]
        return half, difference, azimuth

    @property
    def missing_count(self) -> int:
        """Number of entries that were not measured."""
        return 0 if self.missing is None else int(self.missing.sum())

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        """Return ``pi * f_r * cos(light)``, [..., 3, h, w]."""
        half, difference, azimuth = self.resolution
        half_polar, difference_polar, turned = to_half_difference(light, view)
        places = (
            half * safe.sqrt(half_polar * (2 / math.pi)), difference * difference_polar * (2 / math.pi),
            azimuth * turned / math.pi,
        )
        found = self._linear(*places) if self.interpolation == "linear" else self._nearest(*places)
        found = found.expand(3, *found.shape[1:]).movedim(0, -3)
        return found * (math.pi * light[..., 2:3, :, :])

    def _take(self, half: Tensor, difference: Tensor, azimuth: Tensor) -> Tensor:
        """Return the entries at whole numbers of bins as [channel, ...]."""
        _, differences, azimuths = self.resolution
        flat = self.table.flatten(1)
        index = ((half * differences + difference) * azimuths + azimuth).flatten()
        # `gather`, because the way back through plain indexing adds in an order that depends on the threads.
        return flat.gather(1, index.expand(len(flat), -1)).unflatten(1, half.shape)

    def _nearest(self, half: Tensor, difference: Tensor, azimuth: Tensor) -> Tensor:
        halves, differences, azimuths = self.resolution
        return self._take(
            half.long().clamp(max=halves - 1), difference.long().clamp(max=differences - 1), azimuth.long() % azimuths
        )

    def _linear(self, half: Tensor, difference: Tensor, azimuth: Tensor) -> Tensor:
        halves, differences, azimuths = self.resolution
        first, second, third = _around(half, halves), _around(difference, differences), _around(azimuth)
        blended = torch.zeros((), dtype=self.table.dtype)
        for row, row_weight in first:
            for column, column_weight in second:
                for layer, layer_weight in third:
                    weight = row_weight * column_weight * layer_weight
                    blended = blended + weight * self._take(row, column, layer % azimuths)
        # At the poles the azimuth means nothing: there the mean over it, rising to the table within half a bin.
        upright = self.table[:, 0].mean(dim=-1)
        together = self.table[:, :, 0].mean(dim=-1)
        blended = _fade(half, _line(upright, second), blended)
        return _fade(difference, _line(together, first), blended)


def _around(place: Tensor, count: int | None = None) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Return the bins on both sides of `place`, each with its weight; with a `count`, bins stop at the ends."""
    place = place - 0.5
    lower = place.detach().floor()
    share = place - lower
    below, above = lower.long(), lower.long() + 1
    if count is not None:
        below, above = below.clamp(0, count - 1), above.clamp(0, count - 1)
    return (below, 1 - share), (above, share)


def _line(values: Tensor, around: tuple[tuple[Tensor, Tensor], ...]) -> Tensor:
    """Return the blend of values [channel, n] at the bins and weights of `around`."""
    total = torch.zeros((), dtype=values.dtype)
    for number, weight in around:
        found = values.gather(1, number.flatten().expand(len(values), -1)).unflatten(1, number.shape)
        total = total + weight * found
    return total


def _fade(place: Tensor, at_pole: Tensor, beside: Tensor) -> Tensor:
    """Blend from the value at a pole, where `place` is 0, to the one beside it at half a bin."""
    share = (2 * place).clamp(max=1)
    return at_pole + share * (beside - at_pole)


def bin_centres(resolution: tuple[int, int, int], dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor, Tensor]:
    """Return the half polar [h], difference polar [d] and difference azimuth [a] angles at the centres of the bins."""
    half, difference, azimuth = ((torch.arange(count, dtype=dtype) + 0.5) / count for count in resolution)
    return half**2 * (math.pi / 2), difference * (math.pi / 2), azimuth * math.pi


def fill_missing(table: Tensor, missing: Tensor) -> Tensor:
    """Return `table` [channel, half, difference, azimuth] with the entries of `missing` [half, ...] filled in.

    Each takes the nearest entry that is there along the difference polar angle (the lower of two as near): what is
    missing lies below the horizon or just above it, and interpolation there leans on it. Where none is there at all,
    the nearest along the half polar angle, then along the azimuth; 0 when the whole table is missing.
    """
    filled, missing = table.clone(), missing.clone()
    for dim in (1, 0, 2):
        if not bool(missing.any()):
            break
        count = missing.shape[dim]
        line = torch.arange(count).reshape([-1 if k == dim else 1 for k in range(3)]).expand(missing.shape)
        below = torch.where(missing, -count, line).cummax(dim).values
        above = torch.where(missing, 3 * count, line).flip(dim).cummin(dim).values.flip(dim)
        source = torch.where(line - below <= above - line, below, above)
        reached = missing & (source >= 0) & (source < count)
        source = torch.where(reached, source, line)
        for channel in filled:
            channel.copy_(channel.gather(dim, source))
        missing &= ~reached
    return torch.where(missing, torch.zeros((), dtype=table.dtype), filled)


def tabulate(
    brdf: Brdf, resolution: tuple[int, int, int] = MERL_RESOLUTION, dtype: torch.dtype | None = None
) -> MerlBrdf:
    """Return the table of an isotropic `brdf` at the centres of the bins, in `dtype` or its own precision.

    The table cannot tell light from view, so a BRDF that does is averaged over both orders. Bins whose light or view
    lies below the horizon are missing, and filled. Raises RangeError for an anisotropic BRDF or a resolution below 1.
    """
    if not brdf.isotropic:
        step = "Use the BRDF itself."
        raise RangeError(message("tabulate", "brdf", "be isotropic", f"{brdf.name} is not", step))
    if len(resolution) != 3 or min(resolution) < 1:
        raise RangeError(message("tabulate", "resolution", "be three numbers >= 1", f"it is {resolution}"))
    half, difference, azimuth = bin_centres(resolution)
    table = torch.empty(3, *resolution, dtype=dtype or brdf.dtype)
    missing = torch.empty(*resolution, dtype=torch.bool)
    with torch.no_grad():
        for row, angle in enumerate(half):  # row by row: all directions at once would take ten times the table
            light, view = from_half_difference(angle, difference[:, None], azimuth[None])
            missing[row] = (light[2] <= 0) | (view[2] <= 0)
            light, view = light.to(brdf.dtype), view.to(brdf.dtype)
            both = brdf.reflectance(light, view)
            if not brdf.reciprocal:
                both = (both + brdf.reflectance(view, light)) / 2
            table[:, row] = both.to(table.dtype)
    return MerlBrdf(fill_missing(table, missing), missing=missing)
