"""Which parts a distribution material has: specular maps by short runs, the rest by what the nearly whole fit shows.

A part that a short run from the start leaves out may be the one that the whole fit needs: reflectance that grows towards
grazing shows when everything else is right already. So the fit goes through its first rounds with all parts that are not
decided, a tenth of the samples kept back from it. Then each part is taken out, what it did is given to those that are left as
far as they can hold it, and both ways go on for as many steps. The better one is what the fit goes on from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.fitting.models.distribution.parameters import EXPONENT, Parts
from torchmat.models.parabolic import DENSE, EVEN, respaced, texel_places
from torchmat.progress import whole
from torchmat.repeatable import one_thread
from torchmat.solvers import Minibatch

if TYPE_CHECKING:
    from torchmat.fitting.models.distribution.fit import DistributionFit

_PILOT = 300  # steps of a short run
_SHARP = 0.3  # roughness of highlights from which on evenly spaced texels of specular maps hold all there is
_GAIN_DB = 0.08  # what one more part must bring
_MOST_LOBES = 3
_PILOTS_SHARE = 0.08  # of a limit of seconds, for each pilot
_TRIAL, _SHORTEST = 100, 40  # steps with and without a part, of a hurried fit no fewer than what is left takes to settle
_KEPT_BACK, _MEASURED = 10, 200  # one sample in so many says what a part brings; at most so many
_ANGLES = 16  # of texels, which an even map is the mean over
_FEWEST = 20  # samples that anything is decided by
PRUNED = ("rotation", "fresnel")  # in the order in which they are taken out
SPACING = "spacing"  # of the specular maps' texels, dense or even, which is decided before them
Raw = dict[str, Tensor]


class Choice:
    """The choice of parts in one fit: `parts` so far, what was `tried`, and which samples a fit may see meanwhile."""

    def __init__(self, fit: DistributionFit) -> None:
        self.fit, training = fit, fit.surface.training
        given, count = fit.options, len(training.btf)
        asked = {name: getattr(given, name) for name in ("fresnel", "rotation", "tilt")}
        lobes = 1 if given.lobes == "auto" else given.lobes
        decides = count >= _FEWEST and lobes > 0
        self.open = [name for name in PRUNED if asked[name] == "auto" and decides]
        on = {name: asked[name] is True or name in self.open for name in PRUNED}
        tilt = asked["tilt"] is True or given.denominator == "tilt"
        self.parts = Parts(
            lobes, **on, tilt=tilt, normal=given.normal, specular_mask=given.specular_mask, masking=given.denominator == "smith",
            spacing=EVEN if given.specular_spacing == "auto" else given.specular_spacing,
        )
        self.undecided = decides and given.specular_spacing == "auto"  # how the texels of specular maps lie
        self.trials: list[Callable[[Parts], Parts]] = []
        if decides and asked["tilt"] == "auto":
            self.trials.append(lambda parts: replace(parts, tilt=True))
        if decides and given.lobes == "auto":
            self.trials += [partial(_of_lobes, lobes) for lobes in range(2, _MOST_LOBES + 1)]
        self.tried: list[dict[str, Any]] = []
        order = torch.randperm(count, generator=torch.Generator().manual_seed(training.seed))
        back = max(1, count // _KEPT_BACK)
        self.back, self.rest = order[:back], order[back:]

    @property
    def samples(self) -> Tensor:
        """The samples that a fit may see: all but those kept back while anything is to be decided."""
        return self.rest if self.open else torch.arange(len(self.fit.surface.training.btf))

    def start(self, starts: dict[str, Tensor]) -> tuple[Raw | None, int]:
        """Choose what is chosen before the fit, by short runs with one more part each.

        Returns where the run that was best has come to, and by how many steps; None where nothing is chosen so.
        """
        if self.undecided and float(starts["width"].min()) < _SHARP:
            self.parts = replace(self.parts, spacing=DENSE)
            self.open.insert(0, SPACING)
        if not self.trials:
            return None, 0
        steps = self._steps(_PILOT)
        with whole("choosing parts", (len(self.trials) + 1) * steps, "fitting", show=self.fit.surface.training.progress) as bar:
            raw, best = self._pilot(starts, self.parts, steps)
            self.tried.append({"lobes": self.parts.lobes, "tilt": self.parts.tilt, "psnr_db": best, "kept": True})
            for trial in self.trials:
                rival = trial(self.parts)
                if rival == self.parts:
                    bar.advance(steps)
                    continue
                other, found = self._pilot(starts, rival, steps)
                kept = found > best + _GAIN_DB
                self.tried.append({"lobes": rival.lobes, "tilt": rival.tilt, "psnr_db": found, "kept": kept})
                if kept:
                    self.parts, best, raw = rival, found, other
        return raw, steps

    def prune(self, raw: Raw) -> tuple[Raw, int]:
        """Return the parameters without the parts that bring too little, and how many steps they went on by."""
        steps, taken, watch = max(_SHORTEST, self._steps(_TRIAL)), 0, self.fit.surface.training.watch
        names = [name for name in self.open if not watch.spent]
        with whole("choosing parts", 2 * steps * len(names), "fitting", show=self.fit.surface.training.progress):
            for name in names:
                parts = replace(self.parts, **({SPACING: EVEN} if name == SPACING else {name: False}))
                ways = (raw, self.parts), (without(name, raw, self._grazing(raw)), parts)
                until = watch.seconds + (watch.limit - watch.seconds) * _PILOTS_SHARE
                for values, which in ways:
                    self.fit.solve(values, which, Minibatch(steps, self.fit.rate * 2 / 3), self.rest, until, None)
                found = [self._agreement(values, which) for values, which in ways]
                # A display clips highlights, which the second figure hardly sees anything but.
                gains = [sum(db) / 2 for db in found]
                kept = not gains[0] <= gains[1] + _GAIN_DB
                told = {"part": name, "psnr_db": found[0][0], "without": found[1][0]}
                self.tried.append({**told, "relative_db": found[0][1], "relative_without": found[1][1], "kept": kept})
                raw, self.parts = ways[0] if kept else ways[1]
                taken += steps
        self.open = []
        return raw, taken

    def _steps(self, usual: int) -> int:
        return max(1, round(usual * min(1.0, self.fit.options.effort)))

    def _pilot(self, starts: dict[str, Tensor], parts: Parts, steps: int) -> tuple[Raw, float]:
        """Return where a short run comes to, and its dB on samples that it did not see."""
        watch = self.fit.surface.training.watch
        raw = self.fit.begin(starts, parts)
        # No pilot is noted: the curve is that of the fit.
        self.fit.solve(raw, parts, Minibatch(steps, self.fit.rate), self.rest, watch.seconds + watch.limit * _PILOTS_SHARE, None)
        return raw, self._agreement(raw, parts)[0]

    def _agreement(self, raw: Raw, parts: Parts) -> tuple[float, float]:
        """Return how well samples that were kept back are told, in dB: after the display root, and of linear values."""
        surface = self.fit.surface
        return surface.agreement_db(self.back[:_MEASURED], self.fit.level, lambda rows: self.fit.predict(raw, parts, surface, rows))

    def _grazing(self, raw: Raw) -> float:
        """Return the mean over the samples of Schlick's rise towards grazing."""
        btf = self.fit.surface.training.btf
        apart = 1 - (btf.light + btf.view).double().norm(dim=1) / 2
        return float(apart.clamp(min=0).pow(self.fit.exponent(raw)).mean())


def _of_lobes(lobes: int, parts: Parts) -> Parts:
    """Return parts with one lobe more, where that makes so many; else the same."""
    return replace(parts, lobes=lobes) if parts.lobes == lobes - 1 else parts


def without(name: str, raw: Raw, grazing: float) -> Raw:
    """Return parameters without a part, whose share the others take over as far as they can; `grazing` is Schlick's mean rise."""
    if name == SPACING:
        return {key: respaced(value.detach(), DENSE, EVEN) if key == "specular" else value.detach().clone() for key, value in raw.items()}
    gone = (name, EXPONENT) if name == "fresnel" else (name,)
    left = {key: value.detach().clone() for key, value in raw.items() if key not in gone}
    part = raw[name].detach()
    if name == "fresnel":
        r0 = torch.sigmoid(part)
        usual = (r0 + (1 - r0) * grazing).log()
        if "specular_mask" in left:
            left["specular_mask"] += usual
        else:
            left["specular"] += usual.mean()
    else:
        left["specular"] = _evened(left["specular"], part)
        if "masking" in left:
            left["masking"] = (2 * left["masking"]).exp().mean().sqrt().log().expand(2).clone()
    return left


def _evened(log_specular: Tensor, angle: Tensor) -> Tensor:
    """Return specular maps [C, S, S] (logarithms) as texels of no direction show them: the mean over `angle` of the texels."""
    sorted_angles = angle.flatten().sort().values
    some = sorted_angles[torch.linspace(0, len(sorted_angles) - 1, _ANGLES).round().long()]
    dtype = log_specular.dtype
    right, up = texel_places(log_specular.shape[-1], dtype)
    cosine, sine = torch.cos(some)[:, None, None], torch.sin(some)[:, None, None]
    # A texel turned by an angle looks its half vector up turned back by it; rows run downward.
    grid = torch.stack((cosine * right + sine * up, sine * right - cosine * up), dim=-1)
    with one_thread():
        turned = functional.grid_sample(
            log_specular.exp()[None].expand(_ANGLES, -1, -1, -1), grid, mode="bilinear", padding_mode="border", align_corners=False,
        )
        return turned.mean(dim=0).clamp(min=torch.finfo(dtype).tiny).log()
