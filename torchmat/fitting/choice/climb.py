"""The climb of the automatic choice: from cheap to dear, fitted to part of the samples and measured on the rest."""

from __future__ import annotations

import math
from dataclasses import replace
from weakref import WeakKeyDictionary

from torch import Tensor

from torchmat.errors import FitError
from torchmat.fitting.choice.candidate import Option, fit_flat_rung, fit_rung
from torchmat.fitting.choice.decisions import Decisions, gain_db
from torchmat.fitting.choice.examine import Examiner, of_some_texels
from torchmat.fitting.choice.kept_back import keep_back
from torchmat.fitting.choice.ladder import RELIEF_BYTES, all_rungs, ladder_of, named
from torchmat.fitting.choice.measured import MARGIN, Measured, wanted_cost
from torchmat.fitting.choice.parts import PartsClimb
from torchmat.fitting.choice.shrink import shrink, total_bytes
from torchmat.fitting.recipe import Recipe, Rung, recipe_of
from torchmat.fitting.relief.surface import ambient, bring_onto, without_shadow
from torchmat.fitting.training import Fitted, Training
from torchmat.fitting.wanted import Target
from torchmat.models import Material
from torchmat.progress import working

SPENT = "the seconds are spent"
_PAYS_DB = 0.08  # what one more part must bring
_DB_SAVES = 0.15  # of the bytes, by one dB more: half of what was measured at least (0.3 to 0.5)
_NOTHING = 0.005  # of the error: what leaving out an idle part may cost
# A guess at the share of its bytes that a candidate can do with, to skip what is too large; some could do with less
# (0.22 to 0.46 of them at 25 dB), so what is skipped may, rarely, have been the smallest.
_SHRINKS_TO = 1 / 3
_SHORT_SAVES = 0.95  # of the bytes of a whole fit: a short one that takes hardly fewer is not worth having
_UNSURE = 0.1  # of the error wanted: what some texels may say too much


class Climb:
    """Candidates so far, and what is wanted of them."""

    def __init__(self, training: Training, target: Target) -> None:
        self.training, self.target, self.watch = training, target, training.watch
        wanted = wanted_cost(target)
        self.limit = None if wanted is None else wanted * (1 - MARGIN)
        self.most_bytes = math.inf if target.bytes is None else target.bytes
        back = keep_back(training)
        used = training.used.clone()
        used[back.rows] = False
        self.part = replace(training, used=used if bool(used.any()) else training.used)
        self.examiner = Examiner(training, back)
        thin = of_some_texels(training)
        self.thin = None if thin is None else replace(self.part, btf=thin.btf)
        self._thin_examiner = self.examiner if thin is None else Examiner(thin, back)
        self.log = Decisions(lambda: self.watch.seconds)
        self.options: list[Option] = []
        self._bytes: WeakKeyDictionary[Material, float] = WeakKeyDictionary()

    def flat(self) -> None:
        """Try the closed forms on a flat surface: of many texels on some, then on all if it may be chosen.

        A texel's maps depend on that texel alone, so some say nearly all there is to say.
        """
        fits: dict[tuple, Fitted] = {}
        for rung in all_rungs():
            if rung.last or self._cannot_pay(rung) or self._comes_too_late(rung):
                continue
            start, key = self.watch.seconds, (rung.model, *sorted(rung.options.items()))
            if key not in fits:
                with working(f"trying {rung.name}", self.training.progress):
                    fits[key] = fit_flat_rung(self.thin or self.part, rung)
            self._consider(rung, fits[key], start, None, self.thin is not None)

    def relief(self, height: Tensor) -> None:
        """Try the closed forms on a relief, all on samples that are brought onto it once."""
        surface, bare, shadowed = bring_onto(replace(self.part, progress=False), height), None, None
        # What fits shadow itself comes first, from samples that need no second copy.
        flat = [rung for rung in all_rungs() if not (rung.stored or rung.late or rung.last)]
        rungs = sorted(flat, key=lambda rung: recipe_of(rung.model).on_relief is None)
        for rung in rungs:
            if self._cannot_pay(rung, height):
                continue
            start = self.watch.seconds
            with working(f"trying {named(rung, height)}", self.training.progress):
                own = recipe_of(rung.model).on_relief
                if own is not None:
                    found = own(surface, height, **rung.settings)
                    assert found is not None  # rungs are what it takes
                    fitted = found.settled(surface.training.btf.mask)
                else:
                    if bare is None:
                        shadowed = ambient(surface)
                        bare = without_shadow(surface, shadowed)
                    fitted = fit_flat_rung(bare, rung)
                    fitted = replace(fitted, material=fitted.material.on_relief(height, shadowed))
            self._consider(rung, fitted, start, height)

    def by_parts(self, recipe: Recipe, height: Tensor | None) -> None:
        """Try a material that is built part by part in short fits, then a whole fit of what pays."""
        parts = PartsClimb(self, recipe, height)
        rung = parts.choose()
        if self.watch.spent:
            self.log.skip(f"the whole fit of {named(rung, height)}", SPENT)
            return
        start = self.watch.seconds
        with working(f"fitting {named(rung, height)}", self.training.progress):
            fitted = parts.whole(rung)
        whole = self._consider(rung, fitted, start, height)
        if self.limit is not None and self.meets(whole):  # it is truer, if it takes no fewer bytes
            few = _SHORT_SAVES * self.bytes_of(whole)
            self.options = [one for one in self.options if not one.short or self.bytes_of(one) < few]

    def finished(self, option: Option, done: Fitted, start: float) -> None:
        """Take a candidate after its finish, on the pictures, as one more."""
        self._consider(option.rung, done, start, option.height, name=f"{option.name}, finished")

    def at_last(self, rung: Rung, height: Tensor | None) -> None:
        """Try a candidate that is tried after all others."""
        if self._cannot_pay(rung, height):
            return
        start = self.watch.seconds
        try:
            with working(f"trying {named(rung, height)}", self.training.progress):
                fitted = fit_rung(self.part, rung, height)
        except FitError as error:  # more components than few samples determine
            self.log.skip(named(rung, height), str(error))
            return
        self._consider(rung, fitted, start, height)

    def gain(self, before: Option, after: Option) -> float:
        """Return by how many dB one candidate is truer than another, both stored in full."""
        return gain_db(before.cost_in_full, after.cost_in_full)

    def pays(self, before: Option, after: Option) -> bool:
        """Return whether one more part is worth having: fewer bytes where the target is met, else enough of a gain.

        How small a short fit can be stored is a matter of chance by a tenth; what it gains tells too.
        """
        gain = self.gain(before, after)
        if self.limit is None or not self.meets(before):
            return gain >= _PAYS_DB
        fewer = math.log(self.bytes_of(before) / self.bytes_of(after))
        return self.meets(after) and fewer + _DB_SAVES * gain > 0

    def tried_shortly(
        self, rung: Rung, fitted: Fitted, height: Tensor | None, start: float, before: Option | None, by: str,
        fewer: bool = False,
    ) -> Option:
        """Measure a short fit and note what it brings `by` something; store it smaller if it meets the target.

        `fewer` says that it has a part less than what was `before`, not one more.
        """
        option, measured = self._measured(Option(rung, fitted, fitted.material, math.inf, height, short=True))
        small = self.shrunk(option) if self.limit is not None and self._within_reach(option) else option
        why = "a short fit"
        if before is not None:
            why += f": {self.gain(before, option):+.2f} dB {by}"
        if small.shrunk is not None and self.meets(small):
            why += f", meets the target in {self.bytes_of(small):.2f} bytes"
        kept = before is None or (not self.pays(small, before) if fewer else self.pays(before, small))
        self._note(option, measured, start, kept, why)
        self.options.append(small)
        return small

    def meets(self, option: Option) -> bool:
        """Return whether a candidate is what is wanted."""
        fits = self.bytes_of(option) <= self.most_bytes
        return fits and (self.limit is None or option.cost <= self.limit)

    def rank(self, option: Option) -> tuple[float, ...]:
        """Return what is least for the candidate to choose."""
        size = self.bytes_of(option)
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

    def bytes_of(self, option: Option) -> float:
        """Return the bytes a texel of a candidate, with a texel's share in what all of them share."""
        material = option.material
        if material not in self._bytes:
            self._bytes[material] = total_bytes(material, self.training.btf.height * self.training.btf.width)
        return self._bytes[material]

    def cost_of(self, material: Material) -> float:
        """Return the error of a material as exported, as one that adds up."""
        return self.examiner.measure(material).cost(self.target)

    def as_it_is(self, material: Material) -> float:
        """Return the error of a material that no texture has to hold."""
        return self.examiner.measure_as_it_is(material).cost(self.target)

    def shrunk(self, option: Option) -> Option:
        """Return a candidate stored as small as may be."""
        rival = self.bytes_of(self.best) if self.met else math.inf
        found = shrink(option.material, self.cost_of, self.limit, self.most_bytes, rival, self.as_it_is)
        option = replace(option, material=found.material, cost=found.cost, shrunk=found)
        return option if recipe_of(option.rung.model).ladder is None else self._without_idle_parts(option)

    def _without_idle_parts(self, option: Option) -> Option:
        """Leave out the parts that shrinking made one number, if that costs nothing that matters."""
        bare = ladder_of(recipe_of(option.rung.model)).without_idle_parts(option.material)
        if bare.maps.keys() == option.material.maps.keys():
            return option
        cost = self.cost_of(bare)
        bound = option.cost * (1 + _NOTHING) if self.limit is None or option.cost > self.limit else self.limit
        return replace(option, material=bare, cost=cost) if cost <= bound else option

    def whole(self, option: Option) -> Option:
        """Return a candidate that was fitted to some texels fitted to all of them; what they share stays as it is."""
        if not option.thin:
            return option
        with working(f"fitting {option.name}", self.training.progress):
            fitted = fit_flat_rung(self.knowing(self.part, option), option.rung)
        return self._measured(replace(option, fitted=fitted, thin=False))[0]

    def knowing(self, training: Training, option: Option) -> Training:
        """Return `training` with what some texels of a candidate have said that all of them share."""
        if self.thin is None or option.height is not None:
            return training
        return replace(training, shared=option.fitted.shared)

    def _examiner_of(self, option: Option) -> Examiner:
        return self._thin_examiner if option.thin else self.examiner

    def _measured(self, option: Option) -> tuple[Option, Measured]:
        """Return a fitted candidate as it would be delivered, unless stored smaller, and its errors."""
        option = replace(option, material=option.fitted.material.stored_at(option.rung.stored))
        measured = self._examiner_of(option).measure(option.material)
        cost = measured.cost(self.target)
        return replace(option, cost=cost, cost_in_full=cost), measured

    def _consider(
        self, rung: Rung, fitted: Fitted, start: float, height: Tensor | None = None, thin: bool = False, name: str | None = None
    ) -> Option:
        """Measure a candidate, store it smaller if it may be chosen, and note what it brings, under its `name` or another."""
        option, measured = self._measured(Option(rung, fitted, fitted.material, math.inf, height, thin=thin))
        before = self.rank(self.best) if self.options else (math.inf,)
        if thin and self._may_be_chosen(option, before):
            option = self.whole(option)
            measured = self.examiner.measure(option.material)
        small = self.shrunk(option) if not option.thin and self._may_be_chosen(option, before) else option
        self.options.append(small)
        kept = self.rank(small) < before
        self._note(option, measured, start, kept, self._why(measured, small, kept), name)
        return small

    def _may_be_chosen(self, option: Option, before: tuple[float, ...]) -> bool:
        """Return whether a candidate is worth storing smaller, or has to be before it can be chosen."""
        if self.limit is not None:
            return self._within_reach(option)
        return self.bytes_of(option) > self.most_bytes and (1.0, option.cost) < before

    def _within_reach(self, option: Option) -> bool:
        """Return whether a candidate meets the wanted error, in 8 bits or in more; of some texels: about."""
        assert self.limit is not None
        limit = self.limit * (1 + _UNSURE * option.thin)
        if option.cost <= limit:
            return True
        if option.material.stored:  # numbers: no depth makes them more
            return False
        return self._examiner_of(option).measure_as_it_is(option.material).cost(self.target) <= limit

    def _why(self, measured: Measured, small: Option, kept: bool) -> str:
        if self.limit is None:
            return "the truest so far" if kept else "no truer than what was kept"
        if not self.meets(small):
            return measured.gap_text(self.target) or "takes too many bytes"
        return f"meets the target, in {self.bytes_of(small):.2f} bytes{'' if kept else ': others take fewer'}"

    def _note(self, option: Option, measured: Measured, start: float, kept: bool, why: str, name: str | None = None) -> None:
        seconds = self.watch.seconds - start
        self.log.tried(name or option.name, self.bytes_of(option), measured, option.cost, seconds, kept, why)

    def _cannot_pay(self, rung: Rung, height: Tensor | None = None) -> bool:
        """Return whether a candidate need not be fitted, and note why."""
        if self.options and self.watch.spent:
            self.log.skip(named(rung, height), SPENT)
            return True
        return self.too_large(named(rung, height), rung.bytes + (0 if height is None else RELIEF_BYTES))

    def _comes_too_late(self, rung: Rung) -> bool:
        """Return whether a candidate that takes seconds is left out because something cheaper has what is wanted."""
        if rung.late and self.met:
            self.log.skip(rung.name, "what takes less time meets the target")
        return rung.late and self.met

    def too_large(self, name: str, size: float) -> bool:
        """Return whether a candidate of so many bytes in full would hardly be the smallest, and note it."""
        least = _SHRINKS_TO * size
        if not self.met or least < self.bytes_of(self.best):
            return False
        found = self.bytes_of(self.best)
        self.log.skip(name, f"would hardly take less than {least:.2f} bytes, and {found:.2f} meet the target")
        return True
