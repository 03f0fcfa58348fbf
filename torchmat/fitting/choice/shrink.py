"""Smaller textures for a finished material: each map's error against its size, then the sizes of all together.

Squared errors of different maps very nearly add up. So each map is stored smaller by itself, step by step, until that
alone costs more than there is to spare; the cheapest combination of steps whose errors fit is found from these numbers,
and measured as a whole before it is believed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice, takewhile
from typing import Any, NamedTuple

from torchmat.models import Material
from torchmat.models.resample import ANY_SIZE
from torchmat.models.storage import STORAGES, MapSpec, StoredAs

SPECULAR_SIDES = (32, 24, 16, 12, 8)
_HALVINGS = (2, 4, 8, 16)
_LEAST_SIDE = 4  # texels; what is as smooth as that is a number or nearly
TRIES, _MORE_TRIES = 8, 6  # combinations that are measured, and maps then made smaller one by one
_FREE = 0.005  # of the error: what shrinking may cost where nothing asks for it
_HOPEFUL = 0.5  # of what there is to spare: a map that costs more at half its size is no number
_CLOSE = 0.02  # of the error: differences below are not looked for
_COARSE, _DEEP = "png8", "png16"

Cost = Callable[[Material], float]


class Step(NamedTuple):
    """One way to store a map: the bytes a texel that it saves against the whole, and what it adds to the cost.

    `alone` is the material that was measured, of which nothing else is stored in another way.
    """

    map: str
    name: str
    stored: StoredAs | None = None
    saved: float = 0.0
    added: float = 0.0
    alone: Material | None = None


Steps = tuple[Step, ...]  # one of each map


@dataclass(frozen=True)
class Shrunk:
    """A material with its maps stored as small as they may be, its cost as exported, and `steps`: what was measured."""

    material: Material
    cost: float
    steps: list[dict[str, Any]] = field(default_factory=list)


def total_bytes(material: Material, texels: int | None = None) -> float:
    """Return bytes a texel, with a texel's share in what all `texels` (those of the material) share."""
    return material.bytes_per_texel + material.shared_bytes / (texels or material.texels)


def shrink(
    material: Material, cost_of: Cost, most_cost: float | None = None, most_bytes: float = math.inf,
    rival: float = math.inf, as_it_is: Cost | None = None,
) -> Shrunk:
    """Return `material` in the fewest bytes whose cost is at most `most_cost`, and bytes a texel at most `most_bytes`.

    `cost_of` measures a material as exported, `as_it_is` without export: no more bits can be worth more than that. Where
    both cannot be had the bytes count; what has more cost than is wanted as it stands, or wants none in particular,
    saves only the bytes that buy nothing. When it shows on the way that no fewer than `rival` bytes will do, the
    material comes back as it is.
    """
    work = _Shrinking(material, cost_of)
    deep = work.deep_steps(as_it_is)
    best = work.cost + sum(min(0.0, step.added) for step in deep)
    limit = most_cost if most_cost is not None and best <= most_cost else work.cost * (1 + _FREE)
    fronts = work.fronts(deep, math.inf if work.bytes > most_bytes else limit - best, rival)
    tried = [step for front in fronts or work.unfinished for step in front[1:]]
    found = Shrunk(material, work.cost)
    if fronts is not None:
        found = work.within_cost(fronts, limit) or found
        if total_bytes(found.material) > most_bytes:
            found = work.within_bytes(fronts, work.bytes - most_bytes)
    return replace(found, steps=[work.told(step) for step in tried])


def shrink_steps(
    material: Material, cost_of: Cost, most_cost: float = math.inf, rival: float = math.inf
) -> list[list[Step]]:
    """Return the steps of each map, as it is first: all that a full search has to combine.

    What is more than `most_cost` with one map alone stored so is left out; there are none at all when even the smallest
    of what is left together take more than `rival` bytes.
    """
    work = _Shrinking(material, cost_of)
    deep = work.deep_steps(None)
    best = work.cost + sum(min(0.0, step.added) for step in deep)
    return work.fronts(deep, most_cost - best, rival) or []


class _Shrinking:
    """The work on one material: `cost` and `bytes` are those of the whole."""

    def __init__(self, material: Material, cost_of: Cost) -> None:
        self.material, self.cost_of = material, cost_of
        self.cost, self.bytes = cost_of(material), total_bytes(material)
        self.unfinished: list[list[Step]] = []

    def attempt(self, name: str, called: str, stored: StoredAs) -> Step:
        """Measure the material with one map stored in another way."""
        found = self.material.stored_at({name: stored})
        return Step(name, called, stored, self.bytes - total_bytes(found), self.cost_of(found) - self.cost, found)

    def told(self, step: Step) -> dict[str, Any]:
        """Return a step as the report has it: bytes and cost of the material with that map alone stored so."""
        size = self.bytes - step.saved
        return {"map": step.map, "stored": step.name, "bytes": size, "cost": self.cost + step.added, "alone": step.alone}

    def deep_steps(self, as_it_is: Cost | None) -> list[Step]:
        """Return the steps to 16 bits, if 8 lose anything worth speaking of."""
        textures = self.material.textures()
        used = {one.spec.name: one.storage for one in textures if one.spec.per_texel and not one.spec.index}
        coarse = [name for name, storage in used.items() if STORAGES[storage].levels == 255]
        deep = StoredAs(storage=_DEEP)
        if not coarse or (as_it_is is not None and self.cost - as_it_is(self.material) < _CLOSE * self.cost):
            return []
        gain = self.cost - self.cost_of(self.material.stored_at(dict.fromkeys(coarse, deep)))
        return [self.attempt(name, "16 bit", deep) for name in coarse] if gain >= _CLOSE * self.cost else []

    def fronts(self, deep: list[Step], reach: float, rival: float) -> list[list[Step]] | None:
        """Return the steps of each map, as it is first; None when `rival` bytes are seen to be out of reach.

        A step alone adds no more than `reach` to the cost. The largest maps come first: they decide.
        """
        left = {spec.name: self.material.bytes_of(spec) / self.material.texels for spec in self.material.specs()}
        fronts, least = [], self.bytes
        for spec in sorted(self.material.specs(), key=lambda spec: -left[spec.name]):
            steps = self._steps_of(spec, reach)
            fronts.append([Step(spec.name, "whole"), *(step for step in deep if step.map == spec.name), *steps])
            least -= max((step.saved for step in steps), default=0.0)
            left[spec.name] = 0.0
            if least - sum(left.values()) > rival:
                self.unfinished = fronts
                return None
        return fronts

    def _steps_of(self, spec: MapSpec, reach: float) -> list[Step]:
        """Return the steps of one map, from large to small, as far as one alone adds no more than `reach`."""
        if spec.constant or spec.index:
            return []
        attempt = partial(self.attempt, spec.name)
        if not spec.per_texel:
            side = self.material.maps[spec.name].shape[-1] if spec.name in ANY_SIZE else 0
            return _as_far_as(reach, (attempt(f"side {s}", StoredAs((s, s))) for s in SPECULAR_SIDES if s < side))
        if spec.name == "height":  # one number would be no relief
            return [step for depth in (_DEEP, _COARSE) for step in _as_far_as(reach, self._halved(spec, depth))]
        halved = self._halved(spec, None)
        first = _as_far_as(reach, islice(halved, 1))
        if not first and max(self.material.size) > _LEAST_SIDE:
            return []
        numbers = []
        if all(step.added <= _HOPEFUL * reach for step in first):
            numbers = _as_far_as(reach, iter([attempt("number", StoredAs((1, 1)))]))
        if numbers and numbers[0].added <= _FREE * self.cost:
            return [*first, *numbers]
        return [*first, *_as_far_as(reach, halved), *numbers]

    def _halved(self, spec: MapSpec, depth: str | None) -> Iterator[Step]:
        """Yield a map in a half, a quarter ... of its size, and before that in 8 bits, if that is the depth."""
        rows, columns = self.material.size
        if depth == _COARSE:
            yield self.attempt(spec.name, "8 bit", StoredAs(storage=depth))
        for part in _HALVINGS:
            size = max(1, round(rows / part)), max(1, round(columns / part))
            if max(size) < _LEAST_SIDE:
                return
            called = f"{size[0]} x {size[1]}{', 8 bit' if depth == _COARSE else ''}"
            yield self.attempt(spec.name, called, StoredAs(size, depth))

    def stored(self, steps: Steps) -> Material:
        """Return the material with these steps taken."""
        taken = [step for step in steps if step.alone is not None]
        if len(taken) < 2:
            return next((step.alone for step in steps if step.alone is not None), self.material)
        return self.material.stored_at({step.map: step.stored for step in taken})

    def within_cost(self, fronts: list[list[Step]], limit: float) -> Shrunk | None:
        """Return the cheapest combination whose measured cost is within the limit; None if none that was measured is.

        What a combination was said to add, and what it does add, give the next guess of what may be said to be added,
        between the largest that was within and the smallest that was not.
        """
        spare = limit - self.cost
        start = self._best_alone(fronts, spare)
        best = None if start is None else self._as_far_as_known(start)
        allowed, low, high, tried = spare, 0.0, math.inf, set()
        for _ in range(TRIES):
            chosen = _combined(fronts, partial(_saved_within, allowed))
            if chosen is None or chosen in tried:
                break
            tried.add(chosen)
            found, said = self.stored(chosen), sum(step.added for step in chosen)
            known = sum(step.alone is not None for step in chosen) < 2  # one alone has been measured
            cost = self.cost + said if known else self.cost_of(found)
            if cost <= limit and (best is None or total_bytes(found) < total_bytes(best.material)):
                start, best = chosen, Shrunk(found, cost)
            if 0 <= limit - cost < _CLOSE * limit:
                break
            low, high = (max(low, said), high) if cost <= limit else (low, min(high, said))
            guess = said * spare / (cost - self.cost) if said > 0 and cost > self.cost else allowed + limit - cost
            allowed = guess if low < guess < high else (low + high) / 2 if high < math.inf else 2 * guess
        return None if best is None or start is None else self._further(fronts, start, best, limit)

    def _further(self, fronts: list[list[Step]], chosen: Steps, best: Shrunk, limit: float) -> Shrunk:
        """Go on from a combination map by map, as long as the measured cost is within the limit.

        What saves most for what it adds by itself comes first; after each step all are ranked anew, those too that were
        too much before.
        """
        tried: set[Steps] = set()
        for _ in range(_MORE_TRIES):
            if limit - best.cost < _CLOSE * limit:
                break
            ways = [way for way in self._smaller(fronts, chosen) if way not in tried]
            if not ways:
                break
            tried.add(ways[0])
            found = self.stored(ways[0])
            cost = self.cost_of(found)
            if cost <= limit:
                chosen, best = ways[0], Shrunk(found, cost)
        return best

    def _smaller(self, fronts: list[list[Step]], chosen: Steps) -> list[Steps]:
        """Return the combinations with one map stored smaller, those first that save most for what that map adds."""
        ways = []
        for place, (front, now) in enumerate(zip(fronts, chosen, strict=True)):
            for step in front:
                if step.saved > now.saved:
                    worth = (step.saved - now.saved) / max(step.added - now.added, 1e-6 * self.cost + 1e-30)
                    ways.append((worth, (*chosen[:place], step, *chosen[place + 1 :])))
        return [way for _, way in sorted(ways, key=lambda one: -one[0])]

    def _as_far_as_known(self, chosen: Steps) -> Shrunk:
        """Return a combination of at most one step, which has been measured already."""
        return Shrunk(self.stored(chosen), self.cost + sum(step.added for step in chosen))

    def _best_alone(self, fronts: list[list[Step]], spare: float) -> Steps | None:
        """Return the combination of the one map stored smaller that saves most, all else whole."""
        every = [(step, place) for place, front in enumerate(fronts) for step in front if step.added <= spare]
        if not every:
            return None
        step, place = max(every, key=lambda one: one[0].saved)
        return tuple(step if number == place else front[0] for number, front in enumerate(fronts))

    def within_bytes(self, fronts: list[list[Step]], save: float) -> Shrunk:
        """Return what costs least of all that saves so many bytes a texel, or what saves most."""
        chosen = _combined(fronts, lambda saved, added: added if saved >= save - 1e-9 else math.inf)
        found = self.stored(chosen or _combined(fronts, partial(_saved_within, math.inf)) or ())
        return Shrunk(found, self.cost_of(found))


def _saved_within(most: float, saved: float, added: float) -> float:
    return -saved if added <= most else math.inf


def _as_far_as(reach: float, steps: Iterator[Step]) -> list[Step]:
    return list(takewhile(lambda step: step.added <= reach, steps))


def _combined(fronts: list[list[Step]], worth: Callable[[float, float], float]) -> Steps | None:
    """Return the combination of one step a map for which `worth` (bytes saved, cost added) is least; None if infinite.

    Combinations that another beats in both are dropped as maps are added, so that few are left of very many.
    """
    kept: list[tuple[float, float, Steps]] = [(0.0, 0.0, ())]
    for front in fronts:
        every = [(saved + s.saved, added + s.added, (*steps, s)) for saved, added, steps in kept for s in front]
        every.sort(key=lambda one: (-one[0], one[1]))
        kept, least = [], math.inf
        for one in every:
            if one[1] < least:
                kept.append(one)
                least = one[1]
    best = min(kept, key=lambda one: worth(one[0], one[1]))
    return None if worth(best[0], best[1]) == math.inf else best[2]
