"""The climb of the automatic choice: from cheap to dear, fitted to part of the samples and measured on the rest."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from torchmat.fit.decisions import Decisions, gain_db
from torchmat.fit.examine import Examiner, Measured, keep_back, wanted_cost
from torchmat.fit.ladder import (
    CLOSED_FORMS, RELIEF_BYTES, Rung, bare_distribution, distribution_parts, distribution_rung,
)
from torchmat.fit.linear import fit_lambert_on_relief
from torchmat.fit.on_relief import fit_on_relief
from torchmat.fit.registry import FITTERS
from torchmat.fit.shrink import Shrunk, shrink, total_bytes
from torchmat.fit.surface import ambient, bring_onto, without_shadow
from torchmat.fit.target import Target
from torchmat.fit.training import Fitted, Training
from torchmat.models import Distribution, Material
from torchmat.models.edit import without_idle_parts
from torchmat.progress import working

SPENT = "the seconds are spent"
# Of the error, by which the samples kept back must be better than wanted: 0.22 dB. It is no bound: held-out samples were
# measured from 0.4 dB below those kept back (13 images) to 1.0 dB above them (128, with a few bright highlights).
MARGIN = 0.05
_PAYS_DB = 0.08  # what one more part must bring
_NOTHING = 0.005  # of the error: what leaving out an idle part may cost
# A guess at the share of its bytes that a candidate can do with, to skip what is too large; some could do with less
# (0.22 to 0.46 of them at 25 dB), so what is skipped may, rarely, have been the smallest.
_SHRINKS_TO = 1 / 3
_PILOT_EFFORT = 0.15  # of a whole fit of the distribution material


@dataclass(frozen=True)
class Option:
    """A candidate, fitted to part of the samples: `material` as it would be delivered, and its cost on the others."""

    rung: Rung
    fitted: Fitted
    material: Material
    cost: float
    height: Tensor | None = None
    shrunk: Shrunk | None = None

    @property
    def name(self) -> str:
        """What the log calls it."""
        return named(self.rung, self.height)


def named(rung: Rung, height: Tensor | None) -> str:
    """Return the name of a candidate, flat or on a relief."""
    return rung.name if height is None else f"{rung.name} on relief"


class Climb:
    """Candidates so far, and what is wanted of them."""

    def __init__(self, training: Training, target: Target) -> None:
        self.training, self.target, self.watch = training, target, training.watch
        wanted = wanted_cost(target)
        self.limit = None if wanted is None else wanted * (1 - MARGIN)
        self.most_bytes = math.inf if target.bytes is None else target.bytes
        back = keep_back(training)
        used = training.used.clone()
        used[back] = False
        self.part = replace(training, used=used if bool(used.any()) else training.used)
        self.examiner = Examiner(training, back)
        self.log = Decisions(lambda: self.watch.seconds)
        self.options: list[Option] = []

    @property
    def pilot_effort(self) -> float:
        """The share of a whole fit of the distribution material that says what a part is worth."""
        return _PILOT_EFFORT

    def flat(self) -> None:
        """Try the closed forms on a flat surface."""
        fits: dict[tuple, Fitted] = {}
        for rung in CLOSED_FORMS:
            if self._cannot_pay(rung):
                continue
            start, key = self.watch.seconds, (rung.model, *sorted(rung.options.items()))
            if key not in fits:
                with working(f"trying {rung.name}", self.training.progress):
                    fits[key] = _flat(self.part, rung)
            self._consider(rung, fits[key], start)

    def relief(self, height: Tensor) -> None:
        """Try the closed forms on a relief, all on samples that are brought onto it once."""
        surface, bare, shadowed = bring_onto(replace(self.part, progress=False), height), None, None
        # Lambert comes first: the others need samples without shadow, which take the place of those with it.
        rungs = sorted((rung for rung in CLOSED_FORMS if not rung.stored), key=lambda rung: rung.model != "lambert")
        for rung in rungs:
            if self._cannot_pay(rung, height):
                continue
            start = self.watch.seconds
            with working(f"trying {named(rung, height)}", self.training.progress):
                if rung.model == "lambert":
                    fitted = fit_lambert_on_relief(surface, height, storage="png8")
                else:
                    if bare is None:
                        shadowed = ambient(surface)
                        bare = without_shadow(surface, shadowed)
                    fitted = _flat(bare, rung)
                    fitted = replace(fitted, material=fitted.material.on_relief(height, shadowed))
            self._consider(rung, fitted, start, height)

    def distribution(self, height: Tensor | None) -> None:
        """Try the distribution material: part by part in short fits, then a whole fit of what pays."""
        options, names = bare_distribution(), ()
        best = self._pilot(options, names, height, None)
        for name, more in distribution_parts():
            if self.watch.spent:
                break
            if more.get("lobes", 0) <= options["lobes"] + 1:
                found = self._pilot({**options, **more}, (*names, name), height, best)
                if self._pays(best, found):
                    options, names, best = {**options, **more}, (*names, name), found
        if self.watch.spent:
            self.log.skip(f"the whole fit of {best.name}", SPENT)
            return
        start, rung = self.watch.seconds, distribution_rung(options, names)
        with working(f"fitting {named(rung, height)}", self.training.progress):
            fitted = fit_rung(self.part, rung, height)
        self._consider(rung, fitted, start, height)

    def _pays(self, before: Option, after: Option) -> bool:
        """Return whether one more part is worth having: fewer bytes where the target is met, else enough of a gain."""
        if self.limit is not None and self.meets(before):
            return self.rank(after) < self.rank(before)
        return gain_db(before.cost, after.cost) >= _PAYS_DB

    def _pilot(
        self, options: dict[str, Any], names: tuple[str, ...], height: Tensor | None, before: Option | None
    ) -> Option:
        """Fit for a short time and note what it brings; what meets the target is stored as small as may be."""
        start, rung = self.watch.seconds, distribution_rung({**options, "effort": self.pilot_effort}, names)
        with working(f"trying {named(rung, height)}", self.training.progress):
            fitted = fit_rung(self.part, rung, height)
        option = Option(rung, fitted, fitted.material, math.inf, height)
        measured = self.examiner.measure(option.material)
        option = replace(option, cost=measured.cost(self.target))
        small = self.shrunk(option) if self.limit is not None and self._within_reach(option) else option
        why = "a short fit"
        if before is not None:
            why += f": {gain_db(before.cost, option.cost):+.2f} dB by its last part"
        if small.shrunk is not None:
            why += f", meets the target in {total_bytes(small.material):.2f} bytes"
        self._note(option, measured, start, before is None or self._pays(before, small), why)
        self.options.append(small)
        return small

    def meets(self, option: Option) -> bool:
        """Return whether a candidate is what is wanted."""
        fits = total_bytes(option.material) <= self.most_bytes
        return fits and (self.limit is None or option.cost <= self.limit)

    def rank(self, option: Option) -> tuple[float, ...]:
        """Return what is least for the candidate to choose."""
        size = total_bytes(option.material)
        if self.limit is not None and self.meets(option):
            return 0.0, size, option.cost
        return 1.0 + (size > self.most_bytes), option.cost, size

    @property
    def best(self) -> Option:
        """The candidate to choose."""
        return min(self.options, key=self.rank)

    @property
    def met(self) -> bool:
        """Whether an error is wanted and a candidate has it."""
        return self.limit is not None and any(self.meets(option) for option in self.options)

    def cost_of(self, material: Material) -> float:
        """Return the error of a material as exported, as one that adds up."""
        return self.examiner.measure(material).cost(self.target)

    def shrunk(self, option: Option) -> Option:
        """Return a candidate stored as small as may be."""
        rival = total_bytes(self.best.material) if self.met else math.inf
        found = shrink(option.material, self.cost_of, self.limit, self.most_bytes, rival)
        option = replace(option, material=found.material, cost=found.cost, shrunk=found)
        return self._without_idle_parts(option) if isinstance(found.material, Distribution) else option

    def _without_idle_parts(self, option: Option) -> Option:
        """Leave out the parts that shrinking made one number, if that costs nothing that matters."""
        bare = without_idle_parts(option.material)
        if bare.maps.keys() == option.material.maps.keys():
            return option
        cost = self.cost_of(bare)
        bound = option.cost * (1 + _NOTHING) if self.limit is None or option.cost > self.limit else self.limit
        return replace(option, material=bare, cost=cost) if cost <= bound else option

    def _consider(self, rung: Rung, fitted: Fitted, start: float, height: Tensor | None = None) -> Option:
        """Measure a candidate, store it smaller if it may be chosen, and note what it brings."""
        option = Option(rung, fitted, fitted.material.stored_at(rung.stored), math.inf, height)
        measured = self.examiner.measure(option.material)
        option = replace(option, cost=measured.cost(self.target))
        before = self.rank(self.best) if self.options else (math.inf,)
        small = self.shrunk(option) if self._may_be_chosen(option, before) else option
        self.options.append(small)
        kept = self.rank(small) < before
        self._note(option, measured, start, kept, self._why(option, small, kept))
        return small

    def _may_be_chosen(self, option: Option, before: tuple[float, ...]) -> bool:
        """Return whether a candidate is worth storing smaller, or has to be before it can be chosen."""
        if self.limit is not None:
            return self._within_reach(option)
        return total_bytes(option.material) > self.most_bytes and (1.0, option.cost) < before

    def _within_reach(self, option: Option) -> bool:
        """Return whether a candidate meets the wanted error, in 8 bits or in more."""
        if option.cost <= self.limit:
            return True
        return self.examiner.measure_as_it_is(option.material).cost(self.target) <= self.limit

    def _why(self, option: Option, small: Option, kept: bool) -> str:
        if self.limit is None:
            return "the truest so far" if kept else "no truer than what was kept"
        if not self.meets(small):
            gap = gain_db(option.cost, self.limit)
            return f"misses the target by {gap:.2f} dB" if gap > 0 else "takes too many bytes"
        return f"meets the target, in {total_bytes(small.material):.2f} bytes{'' if kept else ': others take fewer'}"

    def _note(self, option: Option, measured: Measured, start: float, kept: bool, why: str) -> None:
        seconds = self.watch.seconds - start
        self.log.tried(option.name, total_bytes(option.material), measured, option.cost, seconds, kept, why)

    def _cannot_pay(self, rung: Rung, height: Tensor | None = None) -> bool:
        """Return whether a candidate need not be fitted, and note why."""
        if self.options and self.watch.spent:
            self.log.skip(named(rung, height), SPENT)
            return True
        least = _SHRINKS_TO * (rung.bytes + (0 if height is None else RELIEF_BYTES))
        if not self.met or least < total_bytes(self.best.material):
            return False
        found = total_bytes(self.best.material)
        why = f"would hardly take less than {least:.2f} bytes, and {found:.2f} meet the target"
        self.log.skip(named(rung, height), why)
        return True


def _flat(training: Training, rung: Rung) -> Fitted:
    fitted = FITTERS[rung.model](replace(training, progress=False), **rung.settings)
    return replace(fitted, material=fitted.material.repeating(training.tiles))


def fit_rung(training: Training, rung: Rung, height: Tensor | None) -> Fitted:
    """Fit one candidate, flat or on a relief."""
    if height is None:
        return _flat(training, rung)
    return fit_on_relief(replace(training, progress=False), rung.model, rung.settings, height)
