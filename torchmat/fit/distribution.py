"""Fit of the distribution material: starts from what is known, then all maps together by Adam on surface samples.

The residual is taken after ``(x + e) ^ (1 / 2.2)``: to the eye, and to 8-bit pictures, a step in the dark counts as
much as one in the light, and a highlight a thousand times brighter than the cloth counts 23 times as much - neither lost
nor all that matters. Between rounds of Adam the height moves to where the appearance found so far wants it.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import RangeError, check_option, message
from torchmat.fit.distribution_maps import BLOCK_VALUES, OUTSTANDING, Parts, anisotropy, maps_of, raw_maps, sample_runs
from torchmat.fit.refine import refine_height
from torchmat.fit.surface import Surface, bring_onto
from torchmat.fit.training import Fitted, Training
from torchmat.geometry import normals_from_slopes, photometric_stereo, slopes_from_height, slopes_from_normals
from torchmat.models import Distribution
from torchmat.models.storage import STORAGES
from torchmat.progress import progress
from torchmat.repeatable import one_thread

STEP_LIMIT, NOT_FINITE, DIVERGED = "step limit", "not finite", "diverged"
AUTO = ("auto", "yes", "no")
_DISPLAY = 1 / 2.2
_DARKEST = 0.01  # of the mean value: differences below that no display shows
_BATCH_VALUES, _FEWEST_IMAGES = 49152, 4  # texels x images of one step
_RATE = 0.06
# Relative to that: slopes are small numbers; tables and indices see many samples a step and can move faster.
_RATES = {"slopes": 0.3, "specular": 2.0, "index": 2.0}
_ROUNDS = (600, 500, 900)  # steps before, between and after the moves of the height
_PILOT = 300
_GAIN_DB = 0.08  # what one more part must bring in a pilot run
_MOST_LOBES = 3
_SNAPSHOT = 100
_WORSE = 8  # times the lowest error so far: no batch is that much harder than the rest


def fit_distribution(
    training: Training, *, lobes: int = 0, fresnel: str = "auto", rotation: str = "auto", specular_size: int = 48,
    effort: float = 1.0, storage: str = "png8",
) -> Fitted:
    """Fit the distribution material to a flat surface.

    `lobes` is the number K of specular maps, 0 lets the data choose up to 3; `fresnel` and `rotation` "auto", "yes" or
    "no": a part is kept if a short pilot run on part of the samples gains 0.08 dB by it on the rest. `specular_size` is
    the side of the specular maps, `effort` multiplies the number of steps.
    """
    flat = torch.zeros(1, training.btf.height, training.btf.width, dtype=training.dtype)
    surface = bring_onto(training, flat)
    return _Fit(surface, None, lobes, fresnel, rotation, specular_size, effort, storage).run()


def fit_distribution_on_relief(
    surface: Surface, height: Tensor, *, lobes: int = 0, fresnel: str = "auto", rotation: str = "auto",
    specular_size: int = 48, effort: float = 1.0, storage: str = "png8",
) -> Fitted:
    """Fit the distribution material over a relief, and refine its height along the way."""
    return _Fit(surface, height, lobes, fresnel, rotation, specular_size, effort, storage).run()


def _power(base: Tensor, exponent: float) -> Tensor:
    # torch's own power rounds otherwise in what remains of a thread's share; exp and log do not.
    return (base.log() * exponent).exp()


def _shown(values: Tensor, darkest: float) -> Tensor:
    return _power(values.clamp(min=0) + darkest, _DISPLAY)


@dataclass
class _Fit:
    """One fit in progress."""

    surface: Surface
    height: Tensor | None
    lobes: int
    fresnel: str
    rotation: str
    specular_size: int
    effort: float
    storage: str
    history: list[tuple[float, float]] = field(default_factory=list)
    templates: dict[Parts, Distribution] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = "fit distribution"
        check_option(where, "fresnel", self.fresnel, AUTO)
        check_option(where, "rotation", self.rotation, AUTO)
        check_option(where, "storage", self.storage, STORAGES)
        if self.lobes < 0 or self.lobes > 12:
            raise RangeError(message(where, "lobes", "lie in 0 (automatic) to 12", f"it is {self.lobes}"))
        if not 4 <= self.specular_size <= 1024:
            raise RangeError(message(where, "specular_size", "lie in 4 to 1024", f"it is {self.specular_size}"))
        if not 0 < self.effort < math.inf:
            raise RangeError(message(where, "effort", "be positive and finite", f"it is {self.effort}"))

    def run(self) -> Fitted:
        training = self.surface.training
        self.start = time.perf_counter()
        self.level = self._mean_value()
        starts = self._starts()
        parts, pilots = self._choose(starts)
        raw = raw_maps(starts, parts, self.specular_size, training)
        reason, taken = STEP_LIMIT, 0
        rounds = _ROUNDS if self.height is not None else (sum(_ROUNDS),)
        for number, steps in enumerate(rounds):
            if number > 0:
                self._move_height(raw, parts)
            steps = max(1, round(steps * self.effort))
            taken += steps
            rate = _RATE if number == 0 else _RATE * 2 / 3
            reason = self._optimise(raw, parts, self.surface, steps, rate, range(len(training.btf)), self.history)
            if reason != STEP_LIMIT:
                break
        material = self._material(raw, parts)
        figures = {"parts": parts.names, "lobes": parts.lobes, "pilots": pilots, "adam_steps": taken}
        return Fitted(material, reason, None, figures, history=self.history)

    def _mean_value(self) -> float:
        btf = self.surface.training.btf
        total = torch.zeros(btf.height, btf.width, dtype=torch.float64)
        for block in btf.blocks(None, self.surface.training.dtype):
            total += block.images.mean(dim=1, dtype=torch.float64).sum(dim=0)
        each = total / max(len(btf), 1)
        usual = each[each > 0].median() if bool((each > 0).any()) else each.max()
        with one_thread():
            # One texel a million times as bright as the cloth must not decide what is dark.
            return max(float(each.clamp(max=OUTSTANDING * usual).mean()), 1e-12)

    @property
    def darkest(self) -> float:
        """The value added before the root."""
        return _DARKEST * self.level

    def _starts(self) -> dict[str, Tensor]:
        """Return what is known of each texel before the fit: mean colour, slopes, direction of anisotropy, features."""
        training = self.surface.training
        btf, dtype = training.btf, training.dtype
        mean, weight = torch.zeros(3, btf.height, btf.width, dtype=dtype), torch.zeros(1, btf.height, btf.width, dtype=dtype)
        for run in sample_runs(btf):
            values, valid = self.surface.values(run)
            mean += (values * valid).sum(dim=0)
            weight += valid.sum(dim=0)
        mean = mean / weight.clamp(min=1e-6)
        slopes = self._start_slopes()
        starts = {"mean": mean.clamp(min=1e-3 * self.level), "slopes": slopes}
        return starts | anisotropy(self.surface, starts["mean"], slopes)

    def _start_slopes(self) -> Tensor:
        """Return slopes by photometric stereo from the most frontal view, or else those of the height."""
        source = self.surface.source
        btf, dtype = source.btf, source.dtype
        rows = (source.used & (btf.view_index == int(btf.view_index[source.used].min()))).nonzero()[:, 0]
        light = btf.light[rows].to(dtype)
        given = torch.zeros(2, btf.height, btf.width, dtype=dtype)
        if self.height is not None:
            given = slopes_from_height(self.height, tiles=source.tiles)
        spread = torch.linalg.eigvalsh((light.T @ light).double())
        if len(rows) < 6 or float(spread[0]) < 1e-2 * float(spread[-1]):
            return given
        with one_thread():
            found = photometric_stereo(btf.images(rows, dtype), light, btf.weights(rows))
        return torch.where(found.confidence > 0, slopes_from_normals(found.normal), given)

    def _choose(self, starts: dict[str, Tensor]) -> tuple[Parts, list[dict[str, Any]]]:
        """Climb from one lobe alone: keep what pays in pilot runs."""
        parts = Parts(max(1, self.lobes), self.fresnel == "yes", self.rotation == "yes")
        trials = []
        if self.fresnel == "auto":
            trials.append(lambda p: replace(p, fresnel=True))
        if self.rotation == "auto":
            trials.append(lambda p: replace(p, rotation=True))
        if self.lobes == 0:
            trials += [lambda p, k=k: replace(p, lobes=k) if p.lobes == k - 1 else p for k in range(2, _MOST_LOBES + 1)]
        if not trials or len(self.surface.training.btf) < 20:
            return parts, []
        best = self._pilot(starts, parts)
        log = [{"parts": parts.names, "lobes": parts.lobes, "psnr_db": best, "kept": True}]
        for trial in progress(trials, "choosing parts", show=self.surface.training.progress):
            rival = trial(parts)
            if rival == parts:
                continue
            found = self._pilot(starts, rival)
            kept = found > best + _GAIN_DB
            log.append({"parts": rival.names, "lobes": rival.lobes, "psnr_db": found, "kept": kept})
            if kept:
                parts, best = rival, found
        return parts, log

    def _pilot(self, starts: dict[str, Tensor], parts: Parts) -> float:
        """Return the PSNR of a short run on nine tenths of the samples, measured on the rest after the display root."""
        training = self.surface.training
        btf = training.btf
        generator = torch.Generator().manual_seed(training.seed)
        order = torch.randperm(len(btf), generator=generator)
        back = order[: max(1, len(btf) // 10)]
        raw = raw_maps(starts, parts, self.specular_size, training)
        self._optimise(raw, parts, self.surface, max(1, round(_PILOT * min(1, self.effort))), _RATE, order[len(back):].tolist(), [])
        error, count = torch.zeros(btf.height, btf.width, dtype=torch.float64), 0.0
        for rows in back[:200].split(max(1, BLOCK_VALUES // (3 * btf.height * btf.width))):
            values, valid = self.surface.values(rows)
            predicted = self._predict(raw, parts, self.surface, rows)
            gap = _shown(predicted / self._white, 0).clamp(max=1) - _shown(values / self._white, 0).clamp(max=1)
            error += (gap.square() * valid).sum(dim=(0, 1)).double()
            count += float(valid.sum()) * 3
        return -10 * math.log10(max(float(error.sum()) / max(count, 1), 1e-12))

    @property
    def _white(self) -> float:
        """The value shown as white: 1 by convention, or for data of another unit ten times its mean."""
        return 1.0 if 0.01 < self.level < 10 else 10 * self.level

    def _predict(self, raw: dict[str, Tensor], parts: Parts, surface: Surface, rows: Tensor) -> Tensor:
        btf, dtype = surface.training.btf, surface.training.dtype
        light, view = (d[rows][:, :, None, None].to(dtype) for d in (btf.light, btf.view))
        maps = maps_of(raw)
        ambient = maps.pop("ambient")
        shaded = self._flat(maps, parts).value(light, view)
        return shaded if self.height is None else shaded * surface.lit[btf.light_index[rows]] + ambient

    def _flat(self, maps: dict[str, Tensor], parts: Parts) -> Distribution:
        if parts not in self.templates:
            found = {name: value.detach() for name, value in maps.items()}
            self.templates[parts] = Distribution(found, lobes=parts.lobes, parts=parts.names)
        # Not checked again at each step: maps that are no longer finite show in the error.
        return self.templates[parts].sharing(maps)

    def _optimise(
        self, raw: dict[str, Tensor], parts: Parts, surface: Surface, steps: int, rate: float, rows: Any,
        history: list[tuple[float, float]],
    ) -> str:
        """Run Adam for `steps` on random images among `rows`, all texels at once; the rate falls along half a cosine."""
        training = surface.training
        texels = training.btf.height * training.btf.width
        images = min(len(rows), max(_FEWEST_IMAGES, _BATCH_VALUES // texels))
        rows = torch.as_tensor(list(rows))
        groups = [{"params": [value.requires_grad_()], "lr": 0.0, "rate": rate * _RATES.get(name, 1.0)} for name, value in raw.items()]
        solver = torch.optim.Adam(groups, betas=(0.9, 0.99))
        generator = torch.Generator().manual_seed(training.seed)
        order, place = rows[torch.randperm(len(rows), generator=generator)], 0
        kept, lowest, running, reason = {}, math.inf, None, STEP_LIMIT
        for step in progress(range(steps + 1), "fitting all maps", show=training.progress if steps > _PILOT else False):
            if step < steps:  # once more at the end: the last step is judged as well
                if place + images > len(order):
                    order, place = rows[torch.randperm(len(rows), generator=generator)], 0
                batch, place = order[place : place + images], place + images
            share = min(1.0, (step + 1) / 20) * (0.03 + 0.97 * 0.5 * (1 + math.cos(math.pi * step / steps)))
            for group in solver.param_groups:
                group["lr"] = group["rate"] * share
            values, valid = surface.values(batch)
            with torch.enable_grad():
                gap = _shown(self._predict(raw, parts, surface, batch), self.darkest) - _shown(values, self.darkest)
                loss = (gap.square() * valid).mean() / self.level ** (2 * _DISPLAY)
            now = float(loss.detach())
            if not math.isfinite(now):
                reason = NOT_FINITE
                break
            running = now if running is None else 0.98 * running + 0.02 * now
            if step > 0 and (step % _SNAPSHOT == 0 or step == steps):
                history.append((time.perf_counter() - self.start, running))
            if step % _SNAPSHOT == 0 and running < lowest:
                kept, lowest = {name: value.detach().clone() for name, value in raw.items()}, running
            if step < steps:
                solver.zero_grad()
                loss.backward()
                solver.step()
        if reason == STEP_LIMIT and running > _WORSE * lowest:
            reason = DIVERGED
        for name, value in raw.items():
            value.requires_grad_(False)
            if reason != STEP_LIMIT and name in kept:
                value.copy_(kept[name])
        return reason

    def _move_height(self, raw: dict[str, Tensor], parts: Parts) -> None:
        surface, texels = self.surface, torch.arange(len(self.surface.training.btf))

        def steepness(values: Tensor) -> Tensor:
            return _power(values.clamp(min=0) + self.darkest, _DISPLAY - 1) * (_DISPLAY * self._white**-_DISPLAY)

        self.height = refine_height(
            surface, self.height, raw["slopes"], lambda run: self._predict(raw, parts, surface, texels[run]), steepness
        )
        self.surface = bring_onto(surface.source, self.height, into=surface)

    def _material(self, raw: dict[str, Tensor], parts: Parts) -> Distribution:
        maps = maps_of(raw)
        ambient = maps.pop("ambient")
        most = maps["specular_mask"].max().clamp(min=torch.finfo(maps["specular_mask"].dtype).tiny)
        maps |= {"specular_mask": maps["specular_mask"] / most, "specular": maps["specular"] * most}
        tiles = self.surface.training.tiles
        if self.height is not None:
            own = slopes_from_height(self.height, tiles=tiles)
            maps |= {"normal": normals_from_slopes(raw["slopes"] - own), "height": self.height, "ambient": ambient}
        return Distribution(
            {name: value.detach() for name, value in maps.items()}, lobes=parts.lobes, parts=parts.names,
            storage=self.storage, tiles=tiles,
        )
