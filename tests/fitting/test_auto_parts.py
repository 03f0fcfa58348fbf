"""Which parts of the distribution material the automatic choice keeps, on gains that are made up."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from tests.fitting.auto_data import with_parts

from torchmat.fitting.choice import parts
from torchmat.fitting.recipe import RECIPES, Part

A, B, C, TWO, THREE = (
    Part("a", 1, {"a": True}), Part("b", 1, {"b": True}), Part("c", 1, {"c": True}), Part("2 lobes", 2, {"lobes": 2}),
    Part("3 lobes", 1, {"lobes": 3}),
)


class Made:
    """A climb whose short fits reach `decibels` of a set of names; 0.08 dB more is worth a part."""

    def __init__(self, decibels, spent_after=math.inf):
        self.decibels, self.tried, self.spent_after = decibels, [], spent_after

    @property
    def watch(self):
        return SimpleNamespace(spent=len(self.tried) >= self.spent_after)

    def gain(self, before, after):
        return after - before

    def pays(self, before, after):
        return after - before >= 0.08


def kept(monkeypatch, some, decibels, **more):
    with_parts(monkeypatch, some)
    climb = Made(decibels, **more)
    found = parts.PartsClimb.__new__(parts.PartsClimb)
    found.climb, found.recipe, found.height, found.kept = climb, RECIPES["distribution"], None, []

    def pilot(chosen, before, by, fewer=False):
        names = frozenset(part.name for part in chosen)
        climb.tried.append(names)
        return decibels(names)

    monkeypatch.setattr(found, "pilot", pilot, raising=False)
    monkeypatch.setattr(found, "_too_large", lambda part: False, raising=False)
    found.best = pilot((), None, "")
    rung = found.choose()
    return rung, climb.tried


def test_what_pays_is_kept_and_named_in_the_order_of_the_ladder(monkeypatch):
    rung, tried = kept(monkeypatch, [A, B, C], lambda names: 20 + 2 * ("a" in names) + 0.01 * ("b" in names) + ("c" in names))
    assert rung.name == "distribution + a + c" and rung.options["a"] is rung.options["c"] is True and "b" not in rung.options
    assert tried == [frozenset(), {"a"}, {"a", "b"}, {"a", "c"}]


@pytest.mark.parametrize("order", [(A, B, C), (B, A, C), (C, B, A)])
def test_what_needs_another_part_is_found_in_any_order(monkeypatch, order):
    def decibels(names):  # a is worth little without b
        return 20 + 3 * ("b" in names) + 0.05 * ("a" in names) + 1.5 * (names >= {"a", "b"}) + 0.6 * ("c" in names)

    rung, _ = kept(monkeypatch, list(order), decibels)
    assert set(rung.name.split(" + ")[1:]) == {"a", "b", "c"}


@pytest.mark.parametrize("order", [(A, B), (B, A)])
def test_what_another_part_does_as_well_goes_again(monkeypatch, order):
    def decibels(names):  # b alone does all that a does, and more
        return 20 + (3.0 if "b" in names else 0.2 if "a" in names else 0.0)

    rung, tried = kept(monkeypatch, list(order), decibels)
    assert rung.name == "distribution + b" and len(tried) <= 4


def test_what_is_of_no_use_is_not_tried_again(monkeypatch):
    _, tried = kept(monkeypatch, [A, B], lambda names: 20 - 0.1 * ("a" in names) + ("b" in names))
    assert tried == [frozenset(), {"a"}, {"b"}]


def test_three_lobes_come_after_two(monkeypatch):
    rung, tried = kept(monkeypatch, [TWO, THREE], lambda names: 20.0)
    assert rung.options["lobes"] == 1 and tried == [frozenset(), {"2 lobes"}]
    rung, _ = kept(monkeypatch, [TWO, THREE], lambda names: 20 + ("2 lobes" in names) + ("3 lobes" in names))
    assert rung.options["lobes"] == 3


def test_it_ends_when_the_seconds_are_spent(monkeypatch):
    rung, tried = kept(monkeypatch, [A, B, C], lambda names: 20.0 + len(names), spent_after=2)
    assert rung.name == "distribution + a" and len(tried) == 2
