"""A material built part by part in the automatic choice: short fits say which parts pay.

Parts depend on each other, so no one order of trying is right for all data: what was nearly worth having when it was
tried is tried again beside what was kept after it, and what was hardly worth having may go again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from torchmat.fitting.choice.candidate import Option, fit_rung
from torchmat.fitting.choice.ladder import ladder_of, named, rung_of_parts
from torchmat.fitting.choice.shrink import total_bytes
from torchmat.fitting.recipe import Ladder, Part, Recipe, Rung
from torchmat.fitting.relief.surface import Surface, bring_onto
from torchmat.fitting.relief.window import Window
from torchmat.fitting.training import Fitted, Training
from torchmat.progress import working

if TYPE_CHECKING:
    from torchmat.fitting.choice.climb import Climb

EFFORT = 0.08  # of a whole fit: enough to say what a part is worth
_NEARLY_DB, _AGAIN = 0.03, 2  # gained by what is tried again, and how many are
_HARDLY_DB, _BACK = 0.5, 2  # gained by what may go again, and how many may


class _Tried(NamedTuple):
    """A part, what it gained when it was tried, and how many were kept before."""

    part: Part
    gain: float
    after: int


class PartsClimb:
    """The climb from the fewest parts, each candidate fitted to samples that are brought onto the surface once.

    The height stays where it is: moving it takes half the time of a short fit, and a whole fit does so.
    """

    def __init__(self, climb: Climb, recipe: Recipe, height: Tensor | None) -> None:
        self.climb, self.recipe, self.height = climb, recipe, height
        self.surface = _surface(replace(climb.part, progress=False), height)
        self.kept: list[_Tried] = []
        self.best = self.pilot((), None, "")

    def choose(self) -> Rung:
        """Return the material with the parts that pay."""
        left = self._forward()
        self._again(left)
        self._back()
        return self.rung(self._parts)

    @property
    def ladder(self) -> Ladder:
        """The ladder that is climbed."""
        return ladder_of(self.recipe)

    @property
    def _parts(self) -> tuple[Part, ...]:
        return tuple(one.part for one in self.kept)

    @property
    def _lobes(self) -> int:
        return max((1, *(part.lobes for part in self._parts)))

    def rung(self, parts: tuple[Part, ...], **more: float) -> Rung:
        """Return the material with these parts, which are named in the order of the ladder."""
        options = {**self.ladder.bare, **more}
        parts = tuple(part for part in self.ladder.parts if part in parts)
        for part in parts:
            options |= part.options
        return rung_of_parts(self.recipe, options, tuple(part.name for part in parts))

    def pilot(self, parts: tuple[Part, ...], before: Option | None, by: str, fewer: bool = False) -> Option:
        """Fit for a short time; note what that brings against `before`, which has a part less or, `fewer`, one more."""
        start, rung = self.climb.watch.seconds, self.rung(parts, effort=EFFORT)
        with working(f"trying {named(rung, self.height)}", self.climb.training.progress):
            fitted = self._fitted(rung)
        return self.climb.tried_shortly(rung, fitted, self.height, start, before, by, fewer)

    def whole(self, rung: Rung) -> Fitted:
        """Return the whole fit of a rung, on a relief with the height moving unless it was given."""
        if self.height is not None:
            return fit_rung(self.climb.part, rung, self.height)
        return self._fitted(rung)

    def _fitted(self, rung: Rung) -> Fitted:
        assert self.recipe.on_relief is not None
        found = self.recipe.on_relief(self.surface, self.height, **rung.settings)
        assert found is not None  # what is built part by part takes no other way
        return found.settled(self.surface.training.btf.mask)

    def _too_large(self, part: Part) -> bool:
        material = self.best.fitted.material
        more = part.bytes + max(0, part.lobes - self._lobes) * self.ladder.bytes_of_lobe(material)
        return self.climb.too_large(named(self.rung((*self._parts, part)), self.height), total_bytes(material) + more)

    def _try(self, part: Part) -> float:
        """Try one more part, keep it if it pays, and return what it gained."""
        found = self.pilot((*self._parts, part), self.best, f"by {part.name}")
        gain = self.climb.gain(self.best, found)
        if self.climb.pays(self.best, found):
            self.kept.append(_Tried(part, gain, len(self.kept)))
            self.best = found
        return gain

    def _forward(self) -> list[_Tried]:
        """Try each part in order, and return what was left."""
        left: list[_Tried] = []
        for part in self.ladder.parts:
            if self.climb.watch.spent:
                break
            after = len(self.kept)
            if part.lobes <= self._lobes + 1 and not self._too_large(part):
                gain = self._try(part)
                left += [_Tried(part, gain, after)] if len(self.kept) == after else []
        return left

    def _again(self, left: list[_Tried]) -> None:
        """Try once more what gained something before others were kept, the most first."""
        near = [one for one in left if one.gain >= _NEARLY_DB and one.after < len(self.kept)]
        for one in sorted(near, key=lambda one: -one.gain)[:_AGAIN]:
            if not self.climb.watch.spent and one.part.lobes != self._lobes:
                self._try(one.part)

    def _back(self) -> None:
        """Leave out again what gained little and is not missed, the least first."""
        weak = [one for one in self.kept[:-1] if one.gain < _HARDLY_DB and one.part.lobes == 0]
        for one in sorted(weak, key=lambda one: one.gain)[:_BACK]:
            if self.climb.watch.spent:
                break
            rest = [other for other in self.kept if other is not one]
            found = self.pilot(tuple(other.part for other in rest), self.best, f"without {one.part.name}", True)
            if not self.climb.pays(found, self.best):
                self.kept, self.best = rest, found


def _surface(training: Training, height: Tensor | None) -> Surface:
    """Return the samples on a surface; as a window that is the whole it is one whose height does not move."""
    btf = training.btf
    level = torch.zeros(1, btf.height, btf.width, dtype=training.dtype) if height is None else height
    return bring_onto(training, level, window=Window(0, 0, btf.height, btf.width))
