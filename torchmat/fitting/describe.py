"""What the registered models are, and what their options mean: for help texts and tables."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from textwrap import fill
from typing import Any

from torchmat.docstrings import documented_arguments
from torchmat.fitting.objective import OBJECTIVES
from torchmat.fitting.recipe import RECIPES, Recipe, recipe_of
from torchmat.fitting.recipes import described_kind
from torchmat.models.storage import STORAGES

_WIDTH = 110  # letters of a line
_IN = " " * 6


@dataclass(frozen=True)
class Option:
    """One option of a model: its name, its default, the kind of its values in words, and its meaning."""

    name: str
    default: Any
    kind: str
    meaning: str

    def __str__(self) -> str:
        default = str(self.default).lower() if isinstance(self.default, bool) else self.default
        return f"  {self.name} = {default}  ({self.kind})\n{fill(self.meaning, _WIDTH, initial_indent=_IN, subsequent_indent=_IN)}"


@dataclass(frozen=True)
class ModelDescription:
    """A model: what it is, the bytes that its maps take a texel by default ("" where unknown), solvers and options."""

    name: str
    summary: str
    bytes_per_texel: str
    solvers: tuple[str, ...]
    options: tuple[Option, ...]

    def __str__(self) -> str:
        size = f"{self.bytes_per_texel} bytes a texel by default. " if self.bytes_per_texel else ""
        return "\n".join([f"{self.name}: {self.summary}", f"{size}Options and their defaults:", *map(str, self.options)])


def describe_models() -> list[ModelDescription]:
    """Return what each registered model is, in the order of their registration; `print` one to read it."""
    return [describe_model(name) for name in RECIPES]


def describe_model(name: str) -> ModelDescription:
    """Return what a model is, and of each option its default and meaning; `print` it to read it.

    The summary is the first line of the material's docstring, the meanings are those of the section "Args:" in that of the
    recipe's `fit` or `start`. What `storage`, `solver`, `steps` and `rate` mean for all models is added.

    Args:
        name: a registered model, such as "phong_srf".

    Raises RangeError, with the nearest name, for an unknown one.
    """
    recipe = recipe_of(name)
    common, own = _common(recipe), documented_arguments(recipe.way)
    options = [
        Option(
            option, default, described_kind(recipe.kinds[option]),
            ". ".join(text.rstrip(".") for text in (common.get(option), own.get(option)) if text),
        )
        for option, default in recipe.options.items()
    ]
    summary = (recipe.material.__doc__ or "").strip().partition("\n")[0]
    return ModelDescription(name, summary, recipe.bytes_per_texel, recipe.all_solvers, tuple(options))


def _common(recipe: Recipe) -> dict[str, str]:
    """Return the meaning of the options that all models share."""
    return {
        "storage": f"how textures are stored: {_listed(STORAGES)}; the first two are EXR",
        "solver": f"what finds the maps: {_listed(recipe.all_solvers)}",
        "objective": f"what the fit makes small: {_listed(dict.fromkeys((recipe.objective, *OBJECTIVES)))}; in Python also a "
        "callable residual(predicted, target, weight)",
        "steps": "steps of the solver, at least 0; 0 is the solver's own number",
        "rate": "length of a step of adam and minibatch, at least 0; 0 is the solver's own",
    }


def _listed(names: Iterable[str]) -> str:
    quoted = [f'"{name}"' for name in names]
    return " or ".join([", ".join(quoted[:-1]), quoted[-1]] if len(quoted) > 1 else quoted)
