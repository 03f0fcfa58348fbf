"""The coefficients of an RTI model as the 8-bit codes that all of its files hold, and the material that they are.

The sums lie in the codes of a screen (`space="srgb"`), of which 1 is white. Each channel of a map has a range of its own,
``value = low + code / 255 * (high - low)``; files differ in how they write it, and in the order of the terms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from typing import Any

import torch
from torch import Tensor

from torchmat.models import Hsh, Lptm, Material, Ptm
from torchmat.models.linear import SRGB

_LEVELS = 255
_NARROWEST = 2.0**-8  # of a range, as a share of its values: readers subtract in single precision
_COLOURS = 3  # channels of an lptm's chroma, which come first

# Where the harmonics of RTI programs stand among ours, which run from sine to cosine within a band, and which of them have
# the other sign (Gautron et al. 2004 as RTIBuilder has it).
HARMONICS = (0, 3, 2, 1, 8, 7, 6, 5, 4, 15, 14, 13, 12, 11, 10, 9)
NEGATIVE = (4, 8, 10, 14)  # of the programs' order


@dataclass(frozen=True)
class Coefficients:
    """Codes of an RTI model.

    `model` is "ptm", "lptm" or "hsh"; `codes` [channels, H, W], uint8, lie in the order of the material's maps, row 0 the top;
    `low` and `high` [channels], float64, are what code 0 and code 255 stand for, in whichever order.
    """

    model: str
    codes: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def values(self) -> Tensor:
        """Return the coefficients [channels, H, W], float32."""
        found = np.empty(self.codes.shape, np.float32)
        for channel, codes in enumerate(self.codes):
            levels = np.linspace(self.low[channel], self.high[channel], _LEVELS + 1).astype(np.float32)
            found[channel] = levels[codes]
        return torch.from_numpy(found)

    def material(self) -> Material:
        """Return the material, which will be written with these codes again."""
        values = self.values()
        pairs = [[float(low), float(high)] for low, high in zip(self.low, self.high, strict=True)]
        settings: dict[str, Any] = {"space": SRGB, "code_range": pairs, "storage": "float"}
        if self.model == "ptm":
            return Ptm({"polynomial": values}, **settings)
        if self.model == "lptm":
            return Lptm({"chroma": values[:_COLOURS], "luminance": values[_COLOURS:]}, **settings)
        return Hsh({"harmonic": values}, terms=len(values) // 3, **settings)


Ranges = tuple[np.ndarray, np.ndarray]


def coefficients_of(
    material: Material, shared: bool = False, adjusted: Callable[[np.ndarray, np.ndarray], Ranges] | None = None
) -> Coefficients:
    """Return the codes of a `ptm`, `lptm` or `hsh` in codes of a screen.

    The ranges are those of the values, or, of what was read from codes and has not left them, the ones it was read with; so
    are the codes then. With `shared` the three colours of a term have one range. The chroma of an `lptm` becomes at most 1,
    its luminance so much more: their product is the same. `adjusted` makes of the ranges those that a format can write.
    """
    values, ranges = _values(material), _known_ranges(material, shared)
    if ranges is None:
        values = _bounded_chroma(values) if material.name == "lptm" else values
        ranges = _ranges(values, material.name, shared)
    low, high = ranges if adjusted is None else adjusted(*ranges)
    codes = np.empty(values.shape, np.uint8)
    for channel, plane in enumerate(values):
        share = (plane.double().numpy() - low[channel]) / (high[channel] - low[channel])
        codes[channel] = np.clip(np.rint(share * _LEVELS), 0, _LEVELS)
    return Coefficients(material.name, codes, low, high)


def _values(material: Material) -> Tensor:
    return torch.cat([material.maps[spec.name].detach() for spec in material.own_specs()])


def _bounded_chroma(values: Tensor) -> Tensor:
    peak = values[:_COLOURS].amax(dim=0, keepdim=True)
    peak = torch.where(peak > 0, peak, torch.ones_like(peak))
    return torch.cat((values[:_COLOURS] / peak, values[_COLOURS:] * peak))


def _known_ranges(material: Material, shared: bool) -> Ranges | None:
    """Return the ranges that a material was read with; None where there are none, or its values have left them."""
    pairs = material.options.get("code_range")
    if pairs is None:
        return None
    low, high = np.array(pairs, np.float64).T
    ends = np.minimum(low, high), np.maximum(low, high)
    flat = _values(material).double().flatten(1)
    found = flat.amin(dim=1).numpy(), flat.amax(dim=1).numpy()
    step = (ends[1] - ends[0]) / (2 * _LEVELS)
    if not (step > 0).all() or (found[0] < ends[0] - step).any() or (found[1] > ends[1] + step).any():
        return None
    if material.name == "lptm":
        return (low, high) if (low[:_COLOURS] == 0).all() and (high[:_COLOURS] == 1).all() else None
    alike = all((end.reshape(-1, 3) == end.reshape(-1, 3)[:, :1]).all() for end in (low, high))
    return (low, high) if alike or not shared else None


def _ranges(values: Tensor, model: str, shared: bool) -> Ranges:
    flat = values.double().flatten(1)
    low, high = flat.amin(dim=1).numpy(), flat.amax(dim=1).numpy()
    if shared and model != "lptm":
        low = low.reshape(-1, 3).min(axis=1).repeat(3)
        high = high.reshape(-1, 3).max(axis=1).repeat(3)
    if model == "lptm":
        low[:_COLOURS], high[:_COLOURS] = 0, 1
    least = np.maximum(_NARROWEST * np.maximum(abs(low), abs(high)), 1e-6)
    return low, low + np.maximum(high - low, least)


def harmonics_in_files(terms: int) -> tuple[np.ndarray, np.ndarray]:
    """Return which channel of ours stands at each place [3 terms] of an RTI program's harmonics, and with which sign."""
    place = np.repeat(np.array(HARMONICS[:terms]) * 3, 3) + np.tile(np.arange(3), terms)
    sign = np.where(np.isin(np.arange(terms), NEGATIVE), -1.0, 1.0).repeat(3)
    return place, sign


def arranged(model: str, planes: np.ndarray, low: np.ndarray, high: np.ndarray, place: np.ndarray, sign: np.ndarray) -> Coefficients:
    """Return the coefficients of `planes` that stand in a file's order: plane k is our channel `place[k]`, times `sign[k]`."""
    back = np.argsort(place)
    return Coefficients(model, np.ascontiguousarray(planes[back]), (sign * low)[back], (sign * high)[back])
