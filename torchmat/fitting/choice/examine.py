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
from torchmat.fitting.choice.kept_back import KeptBack
from torchmat.fitting.choice.measured import Measured
from torchmat.fitting.training import Training
from torchmat.metrics import log_encode, psnr, relative
from torchmat.models import Material
from torchmat.models.fine_relief import FineRays
from torchmat.models.relief_maps import Rays, rays, shade_along
from torchmat.repeatable import one_thread

_VALUES = 1_000_000  # of a batch, as in an evaluation
_TEXELS, _FEW = 4096, 1024  # of a flat material that are looked at, and about those that are enough for a first look
_FEWEST_KEPT, _MOST_KEPT = 3, 12  # heights whose rays are remembered: all that shrinking tries
_KEPT_RAYS = 8_000_000  # of all of them


class _Batch(NamedTuple):
    light: Tensor
    view: Tensor
    target: Tensor
    shown: Tensor
    valid: Tensor
    clipped: Tensor
    weight: Tensor

    def directions(self, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        """Return light and view in a material's precision."""
        return self.light.to(dtype), self.view.to(dtype)


class Examiner:
    """Measures materials, as exported, on samples of the training's BTF, each of which counts as many as it stands for."""

    def __init__(self, training: Training, kept: KeptBack) -> None:
        self._btf, self._kept = training.btf, kept
        self.samples, self.highlights_from = len(kept.rows), kept.highlights_from
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
        sums, bound = torch.zeros(7, dtype=torch.float64), self.highlights_from
        with torch.no_grad():
            if material.has_relief:
                batches = self._all_texels()
                met = self._followed(material, batches)
                for batch, along in zip(batches, met, strict=True):
                    sums += _sums(shade_along(material, *batch.directions(material.dtype), along), batch, bound)
            else:
                small = material if self._texels is None else _texels_of(material, self._texels)
                for batch in self._some_texels():
                    sums += _sums(small.shade(*batch.directions(material.dtype)), batch, bound)
        squared, energy, shown, log, count, missed, bright = sums.tolist()
        error, count = relative(squared, energy), max(count, 1.0)
        return Measured(
            psnr(shown / count), math.inf if error is None else error, psnr(log / count),
            missed / bright if bright > 0 else None,
        )

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
        size = max(1, _VALUES // (3 * btf.height * btf.width))
        for part, weight in zip(self._kept.rows.split(size), self._kept.weight.split(size), strict=True):
            target, valid = btf.images(part), btf.valid(part)
            clipped = btf.saturated(part, target)
            if texels is not None:  # before all else: what is left is few
                target, valid, clipped = (_chosen(each, texels) for each in (target, valid, clipped))
            planes = [target, display(target), valid.expand_as(target), clipped, weight[:, None, None, None].to(target.dtype)]
            directions = list(btf.directions(part, torch.float32))
            if texels is not None:
                directions = [d if d.shape[-2:] == (1, 1) else _chosen(d, texels) for d in directions]
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


def _sums(predicted: Tensor, batch: _Batch, bound: float | None) -> Tensor:
    """Return sums over a batch [7], as `metrics` defines them, and those over highlights.

    Squared error, energy, squared error on a display and of logarithms, count; squared error and energy where images or
    prediction reach `bound`: what shines where nothing should is as wrong as what does not.
    """
    predicted = predicted.to(batch.target.dtype)
    predicted = torch.where(batch.clipped, torch.minimum(predicted, batch.target), predicted)
    gap, zero = predicted - batch.target, torch.zeros(())
    logarithms = log_encode(predicted) - log_encode(batch.target)
    parts = [gap, batch.target, display(predicted) - batch.shown, logarithms]
    valid = [batch.valid] * 4
    if bound is not None:
        valid += [batch.valid & (torch.maximum(predicted, batch.target) >= bound), batch.valid & (batch.target >= bound)]
        parts += [gap, batch.target]
    with one_thread():
        found = [_total(torch.where(seen, part, zero).square(), batch) for part, seen in zip(parts, valid, strict=True)]
        found += [torch.zeros((), dtype=torch.float64)] * (6 - len(found))
        return torch.stack([*found[:4], _total(batch.valid, batch), *found[4:]])


def _total(values: Tensor, batch: _Batch) -> Tensor:
    """Return the sum of values [k, 3, H, W], each sample's as often as it counts."""
    return (values.sum(dim=(1, 2, 3), dtype=torch.float64) * batch.weight[:, 0, 0, 0]).sum()


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
