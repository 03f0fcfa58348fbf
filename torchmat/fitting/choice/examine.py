"""Examiner: what a material's textures are worth on samples kept back from the training samples.

One examination follows another, each of a material that differs in little: what the images show is decoded once, rays
are followed once for each height, and of large flat maps an even choice of texels speaks for all.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from torchmat.colour import display
from torchmat.btf import Btf
from torchmat.fitting.training import Training
from torchmat.fitting.wanted import Target
from torchmat.metrics import psnr, relative
from torchmat.models import Material
from torchmat.models.fine_relief import FineRays
from torchmat.models.relief_maps import Rays, rays, shade_along
from torchmat.repeatable import one_thread

_SHARE, _FEWEST, _MOST = 0.1, 16, 128  # of the training samples are kept back
_VALUES = 1_000_000  # of a batch, as in an evaluation
_MOST_VALUES = 40_000_000  # of all samples kept back of a surface whose rays are remembered
_TEXELS, _FEW = 4096, 1024  # of a flat material that are looked at, and about those that are enough for a first look
_FEWEST_KEPT, _MOST_KEPT = 3, 12  # heights whose rays are remembered: all that shrinking tries
_KEPT_RAYS = 8_000_000  # of all of them


class Measured(NamedTuple):
    """Errors on the samples kept back: `psnr_db`, and `relative_error` (infinite where black was missed)."""

    psnr_db: float
    relative_error: float

    def cost(self, target: Target) -> float:
        """Return the error that the target asks for as one that adds up: relative, or the mean square on a display."""
        return self.relative_error if target.error is not None else 10 ** (-self.psnr_db / 10)


def wanted_cost(target: Target) -> float | None:
    """Return the largest cost that meets the target, None where no error is wanted."""
    if target.error is not None:
        return target.error
    return None if target.psnr is None else 10 ** (-target.psnr / 10)


def keep_back(training: Training) -> Tensor:
    """Return the samples [n], ascending, that are kept back: evenly from frontal to grazing ones, by the seed.

    Grazing samples are the hard ones; drawn without regard to that, few samples would say little of all.
    """
    btf = training.btf
    rows = training.used.nonzero()[:, 0]
    if len(rows) < 2:
        return rows
    count = min(_MOST, max(_FEWEST, round(_SHARE * len(rows))), max(1, len(rows) // 5))
    most = max(_FEWEST, _MOST_VALUES // (3 * btf.height * btf.width))
    count = min(count, most)
    grazing = (btf.light[rows, 2] * btf.view[rows, 2]).double()
    order = rows[grazing.argsort(stable=True)]
    ends = torch.linspace(0, len(order), count + 1).round().long()
    generator = torch.Generator().manual_seed(training.seed)
    place = torch.rand(count, generator=generator, dtype=torch.float64)
    return order[ends[:-1] + (place * (ends[1:] - ends[:-1])).long()].sort().values


class _Batch(NamedTuple):
    light: Tensor
    view: Tensor
    target: Tensor
    shown: Tensor
    valid: Tensor
    clipped: Tensor

    def directions(self, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        """Return light and view in a material's precision."""
        return self.light.to(dtype), self.view.to(dtype)


class Examiner:
    """Measures materials, as exported, on samples `rows` of the training's BTF."""

    def __init__(self, training: Training, rows: Tensor) -> None:
        self._btf, self._rows = training.btf, rows
        self.samples = len(rows)
        self._texels = _some_texels(training.btf, training.seed)
        self._whole: list[_Batch] | None = None
        self._part: list[_Batch] | None = None
        self._rays: list[tuple[Tensor, str, list[Rays | FineRays]]] = []
        self._known: WeakKeyDictionary[Material, Measured] = WeakKeyDictionary()

    def measure(self, material: Material) -> Measured:
        """Return the errors of `material` as its textures would bring it back."""
        if material not in self._known:
            self._known[material] = self.measure_as_it_is(material.as_exported())
        return self._known[material]

    def measure_as_it_is(self, material: Material) -> Measured:
        """Return the errors of `material` without export."""
        sums = torch.zeros(4, dtype=torch.float64)
        with torch.no_grad():
            if material.has_relief:
                batches = self._all_texels()
                met = self._followed(material, batches)
                for batch, along in zip(batches, met, strict=True):
                    sums += _sums(shade_along(material, *batch.directions(material.dtype), along), batch)
            else:
                small = material if self._texels is None else _texels_of(material, self._texels)
                for batch in self._some_texels():
                    sums += _sums(small.shade(*batch.directions(material.dtype)), batch)
        squared, energy, display, count = sums.tolist()
        error = relative(squared, energy)
        return Measured(psnr(display / max(count, 1.0)), float("inf") if error is None else error)

    def _all_texels(self) -> list[_Batch]:
        if self._whole is None:
            self._whole = self._read(None)
        return self._whole

    def _some_texels(self) -> list[_Batch]:
        if self._texels is None:
            return self._all_texels()
        if self._part is None:
            self._part = self._read(self._texels)
        return self._part

    def _read(self, texels: Tensor | None) -> list[_Batch]:
        btf, batches = self._btf, []
        for part in self._rows.split(max(1, _VALUES // (3 * btf.height * btf.width))):
            target, valid = btf.images(part), btf.valid(part)
            clipped = btf.saturated(part, target)
            if texels is not None:  # before all else: what is left is few
                target, valid, clipped = (_chosen(each, texels) for each in (target, valid, clipped))
            planes = [target, display(target), valid.expand_as(target), clipped]
            directions = [direction[part][:, :, None, None].float() for direction in (btf.light, btf.view)]
            batches.append(_Batch(*directions, *planes))
        return batches if texels is None else [_Batch(*(torch.cat(planes) for planes in zip(*batches, strict=True)))]

    def _followed(self, material: Material, batches: list[_Batch]) -> list[Rays | FineRays]:
        height, way = material.maps["height"].detach(), material.relief
        for known, followed, met in self._rays:
            if followed == way and known.dtype == height.dtype and torch.equal(known, height):
                return met
        met = [rays(height, *batch.directions(height.dtype), material.tiles, way) for batch in batches]
        kept = _KEPT_RAYS // (self.samples * height.numel())
        kept = min(_MOST_KEPT, max(_FEWEST_KEPT, kept))
        self._rays = [*self._rays[1 - kept :], (height.clone(), way, met)]
        return met


def _sums(predicted: Tensor, batch: _Batch) -> Tensor:
    """Return squared error, energy, squared error on a display, and count [4], as `metrics` defines them."""
    predicted = predicted.to(batch.target.dtype)
    predicted = torch.where(batch.clipped, torch.minimum(predicted, batch.target), predicted)
    gaps = predicted - batch.target, batch.target, display(predicted) - batch.shown
    zero = torch.zeros(())
    with one_thread():
        found = [torch.where(batch.valid, gap, zero).square().sum(dtype=torch.float64) for gap in gaps]
        return torch.stack([*found, batch.valid.sum(dtype=torch.float64)])


def _texels_of(material: Material, texels: Tensor) -> Material:
    """Return a flat material of chosen texels alone, one below the other."""
    maps = {
        spec.name: _chosen(material.maps[spec.name].detach(), texels) if spec.per_texel and not spec.constant
        else material.maps[spec.name] for spec in material.specs()
    }
    return material.sharing(maps)


def _some_texels(btf: Btf, seed: int) -> Tensor | None:
    """Return the numbers of some texels of the object, evenly chosen; None where all are to be looked at."""
    inside = btf.inside
    texels = len(inside)
    if texels <= 2 * _TEXELS:
        return None if btf.mask is None else inside
    generator = torch.Generator().manual_seed(seed)
    ends = torch.linspace(0, texels, _TEXELS + 1).long()
    place = torch.rand(_TEXELS, generator=generator, dtype=torch.float64)
    return inside[ends[:-1] + (place * (ends[1:] - ends[:-1])).long()]


def _chosen(planes: Tensor, texels: Tensor) -> Tensor:
    return planes.flatten(-2)[..., texels][..., None]


def of_some_texels(training: Training) -> Training | None:
    """Return the training of some texels, every so many in rows and columns; None where there are few anyway.

    Every odd number: what repeats, mostly does so every even one.
    """
    btf = training.btf
    texels = btf.height * btf.width
    if texels <= 2 * _TEXELS:
        return None
    step = round(math.sqrt(texels / _FEW)) | 1
    few = btf.window(0, 0, btf.height, btf.width, step)
    return None if few.mask is not None and not bool(few.mask.any()) else replace(training, btf=few)
