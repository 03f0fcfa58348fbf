"""Rungs of the automatic choice, from cheap to dear: closed forms of all models, and materials built part by part."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor

from torchmat.fitting.recipe import RECIPES, Ladder, Recipe, Rung

RELIEF_BYTES = 5  # height and ambient


def named(rung: Rung, height: Tensor | None) -> str:
    """Return the name of a candidate, flat or on a relief."""
    return rung.name if height is None else f"{rung.name} on relief"


def all_rungs() -> list[Rung]:
    """Return the rungs of all registered models, from few bytes to many, those last that take seconds.

    What two of them share is fitted once.
    """
    return sorted((rung for recipe in RECIPES.values() for rung in recipe.rungs), key=lambda rung: (rung.late, rung.bytes))


def last_rungs() -> list[Rung]:
    """Return the rungs that are tried after all others."""
    return [rung for rung in all_rungs() if rung.last]


def built_by_parts() -> list[Recipe]:
    """Return the recipes whose material is built part by part."""
    return [recipe for recipe in RECIPES.values() if recipe.ladder is not None]


def ladder_of(recipe: Recipe) -> Ladder:
    """Return the ladder of a recipe that has one."""
    assert recipe.ladder is not None
    return recipe.ladder


def rung_of_parts(recipe: Recipe, options: Mapping[str, Any], parts: tuple[str, ...] = ()) -> Rung:
    """Return a material with these options, called after its parts."""
    return Rung(" + ".join((recipe.name, *parts)), recipe.name, ladder_of(recipe).bytes, options)
