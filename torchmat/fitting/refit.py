"""Refit of an edited distribution material: some maps stay as they were painted, the others follow the BTF.

The same Adam loop as the fit's (Liao 2011 names this refinement by hand, section 5.3), started from the material's own
maps. Maps that are kept are no unknowns: the shading reads the very tensors that the result holds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchmat.btf import Btf, Split, split_samples
from torchmat.errors import RangeError, ShapeError, check_option, check_positive, message
from torchmat.fitting.evaluate import evaluate
from torchmat.fitting.models.distribution.fit import _RATE, _ROUNDS, _Fit
from torchmat.fitting.models.distribution.options import DistributionOptions
from torchmat.fitting.models.distribution.parameters import Parts, maps_of
from torchmat.fitting.models.distribution.start import mean_value
from torchmat.fitting.relief.surface import Surface, bring_onto
from torchmat.fitting.training import make_training
from torchmat.geometry import normals_from_slopes, slopes_from_height, slopes_from_normals
from torchmat.models import Distribution, Material
from torchmat.solvers.stop_reasons import NOT_FINITE, STEP_LIMIT

_UNFITTED = ("tilt",)  # the whole material's curve: what is painted on some texels must not bend it
_LEAST = 1e-5  # of the mean value: from black itself a logarithm never comes back
_LEAST_SHARE = 1e-4  # of a weight or reflectance in 0..1, alike
_SUM_ERROR = 0.02  # of index weights: more than 8-bit codes of 12 maps are off by
_CHECKED = 512  # training samples on which the new maps must be the better ones


@dataclass(frozen=True)
class Refit:
    """What a refit gives back: the material, and `report`.

    The report holds `held_out_before` and `held_out_after` (as in a fit's report; None without held-out samples),
    `train_before` and `train_after`, `kept` (names of maps), `improved`, `stop_reason`, `seconds`, `samples` and `seed`.
    """

    material: Distribution
    report: dict[str, Any]


def refit(
    btf: Btf, material: Material, keep: Sequence[str] = (), *, effort: float = 1.0, holdout: float = 0.2,
    holdout_by: str = "pair", seed: int = 0, progress: bool | None = None,
) -> Refit:
    """Fit the maps of a distribution material that are not in `keep` anew, starting from what they hold.

    Kept maps have the same bits in the result; `tilt` is always kept. `effort` multiplies the number of steps, as in
    the fit. `holdout`, `holdout_by` and `seed` choose the samples that are measured and never fitted: give those of the
    first fit, or it has seen them. When the new maps are no better on the training samples, the old ones are returned.

    Raises RangeError for another model, unknown names or nothing to fit, ShapeError when the sizes differ.
    """
    kept = _check(btf, material, keep, effort)
    start = time.perf_counter()
    split = split_samples(btf, holdout, holdout_by, seed)
    training = make_training(btf, split.train, seed, material.tiles, material.dtype, progress)
    with torch.no_grad():
        flat = torch.zeros(1, btf.height, btf.width, dtype=material.dtype)
        height = material.maps["height"].detach() if material.has_relief else flat
        found, reason = _Refit(bring_onto(training, height), material, kept, effort).run_again()
    seconds = time.perf_counter() - start
    report: dict[str, Any] = {"kept": kept, "samples": len(btf), "seed": seed, "stop_reason": reason, "seconds": seconds}
    before, after = (_measured(one, btf, split, progress) for one in (material, found))
    improved = after["train"]["psnr_db"] > before["train"]["psnr_db"]
    found, after = (found, after) if improved else (material, before)
    for part in ("train", "held_out"):
        report |= {f"{part}_before": before[part], f"{part}_after": after[part]}
    return Refit(found, report | {"improved": improved})


def _measured(material: Distribution, btf: Btf, split: Split, progress: bool | None) -> dict[str, Any]:
    held_out = evaluate(material, btf, split.held_out, None, progress).report if len(split.held_out) else None
    return {"train": evaluate(material, btf, split.train, _CHECKED, progress).report, "held_out": held_out}


def _check(btf: Btf, material: Material, keep: Sequence[str], effort: float) -> list[str]:
    """Return the names of the maps that stay, in the material's order; raise what `refit` says."""
    if not isinstance(material, Distribution):
        step = "Fit the BTF again; only the distribution material can be refitted in parts."
        raise RangeError(message("refit", "material", "be a distribution material", f"it is {material.name}", step))
    check_positive("refit", "effort", effort)
    if isinstance(keep, str):
        raise RangeError(message("refit", "keep", "be a list of names", f"it is {keep!r}", f"Give ({keep!r},)."))
    names = [spec.name for spec in material.specs()]
    for name in keep:
        check_option("refit", "keep", name, names)
    kept = [name for name in names if name in keep or name in _UNFITTED]
    if len(kept) == len(names):
        fact = f"all of {', '.join(names)} are kept"
        raise RangeError(message("refit", "keep", "leave a map to fit", fact, "Keep fewer."))
    if material.size != (btf.height, btf.width):
        fact = f"it is {material.size[0]} x {material.size[1]}"
        step = "Resample the material with `resized`, or load the BTF in its size."
        raise ShapeError(message("refit", "material", f"be {btf.height} x {btf.width} as the images", fact, step))
    if "index" in names and "index" not in kept:
        _check_weights(material.maps["index"].detach())
    return kept


def _check_weights(index: Tensor) -> None:
    off = (index.sum(dim=0) - 1).abs() > _SUM_ERROR
    if bool(off.any()):
        first = tuple(off.nonzero()[0].tolist())
        fact = f"{int(off.sum())} of {off.numel()} texels' do not, first at {first}"
        step = "Keep the index, or bring it to that with replace_map."
        raise RangeError(message("refit", "index", "have weights that sum to 1", fact, step))


class _Refit(_Fit):
    """A fit that starts from a material and knows some of its maps."""

    def __init__(self, surface: Surface, material: Distribution, kept: list[str], effort: float) -> None:
        height = material.maps["height"].detach() if material.has_relief else None
        super().__init__(surface, height, DistributionOptions(effort=effort, storage=material.storage))
        self.material, self.kept = material, kept
        self.level = mean_value(surface)
        self._set_height()

    def run_again(self) -> tuple[Distribution, str]:
        """Return the material with new maps, and why the last round stopped."""
        raw, reason = self._raw(), STEP_LIMIT
        moves = self.height is not None and "height" not in self.kept
        parts = Parts(self.material.options["lobes"], False, False)  # not read here: the material says what it has
        for number, steps in enumerate(_ROUNDS[1:] if moves else _ROUNDS[2:]):
            if number > 0 or not raw:
                self._move_height(raw, parts)
            if raw:
                steps, rows = max(1, round(steps * self.options.effort)), torch.arange(len(self.surface.training.btf))
                watch = self.surface.training.watch
                found = self._solve(raw, parts, "minibatch", steps, _RATE * 2 / 3, rows, math.inf, watch)
                reason = found.reason
            if reason == NOT_FINITE:
                break
        return self._result(raw), reason

    def _raw(self) -> dict[str, Tensor]:
        """Return the unbounded parameters of the maps to fit: the inverse of the fit's own parametrisation."""
        least, found = _LEAST * self.level, {}
        for name, parameter in self.material.maps.items():
            value = parameter.detach()
            if name in self.kept or name == "height":
                continue
            if name == "normal":
                found["slopes"] = slopes_from_normals(self.template.maps["normal"]).clone()
            elif name == "rotation":
                found[name] = torch.atan2(value[1:], value[:1])
            elif name == "fresnel":
                found[name] = torch.logit(value.clamp(_LEAST_SHARE, 1 - _LEAST_SHARE))
            else:
                share = {"index": _LEAST_SHARE, "specular_mask": _LEAST_SHARE}.get(name, least)
                found[name] = value.clamp(min=share).log()
        return found

    def _set_height(self) -> None:
        """Keep what the material is on the surface, with the normals of the present height."""
        material = self.material if self.height is None else self.material.with_maps(height=self.height)
        self.template = material.surface()

    def _move_height(self, raw: dict[str, Tensor], parts: Parts) -> None:
        slopes = raw["slopes"] if "slopes" in raw else slopes_from_normals(self.template.maps["normal"])
        super()._move_height(raw | {"slopes": slopes}, parts)
        self._set_height()

    def _predict(self, raw: dict[str, Tensor], parts: Parts, surface: Surface, rows: Tensor) -> Tensor:
        btf, dtype = surface.training.btf, surface.training.dtype
        light, view = (d[rows][:, :, None, None].to(dtype) for d in (btf.light, btf.view))
        maps = maps_of(raw)
        ambient = maps.pop("ambient", None)
        shaded = self.template.sharing({**self.template.maps, **maps}).value(light, view)
        if self.height is None:
            return shaded
        if ambient is None:
            ambient = self.material.maps["ambient"] if "ambient" in self.material.maps else torch.zeros((), dtype=dtype)
        return shaded * surface.lit[btf.light_index[rows]] + ambient

    def _result(self, raw: dict[str, Tensor]) -> Distribution:
        maps = maps_of(raw)
        if self.height is not None:
            maps["height"] = self.height
            if "slopes" in raw:
                own = slopes_from_height(self.height, tiles=self.material.tiles)
                maps["normal"] = normals_from_slopes(raw["slopes"] - own)
        return self.material.with_maps(**{name: value.detach() for name, value in maps.items()})
