"""The models that come with the package, registered; and a model's options, resolved and checked."""

from __future__ import annotations

import math
import types
import typing
from typing import Any

from torchmat.errors import RangeError, check_known_keys, check_option, message
from torchmat.fitting.models.distribution.recipe import DISTRIBUTION
from torchmat.fitting.models.linear import HSH, LAMBERT, LPTM, PTM, TEXTURE
from torchmat.fitting.models.microfacet.recipe import MICROFACET
from torchmat.fitting.models.neural import NEURAL
from torchmat.fitting.models.pca import LOCAL_PCA, PCA
from torchmat.fitting.models.phong_srf import PHONG_SRF
from torchmat.fitting.models.rbf.recipe import RBF
from torchmat.fitting.models.shading_map import SHADING_MAP
from torchmat.fitting.models.spheres.to_btf import SPHERE_IMAGES
from torchmat.fitting.recipe import AUTO, RECIPES, recipe_of, register
from torchmat.solvers import as_solver

for _recipe in (
    TEXTURE, LAMBERT, LPTM, PTM, HSH, PHONG_SRF, PCA, LOCAL_PCA, RBF, SPHERE_IMAGES, SHADING_MAP, DISTRIBUTION, NEURAL, MICROFACET,
):
    register(_recipe)


def default_options(model: str) -> dict[str, Any]:
    """Return the options of a model and their defaults: the keyword arguments of its fit function."""
    check_option("fit", "model", model, (*RECIPES, AUTO))
    return {} if model == AUTO else recipe_of(model).options


def resolve_options(model: str, given: dict[str, Any]) -> dict[str, Any]:
    """Return all options of `model` with those `given`, the solver as an object.

    Raises RangeError, with the nearest name, for unknown ones.
    """
    defaults = default_options(model)
    check_known_keys(f"fit {model}", given, defaults)
    kinds = {} if model == AUTO else recipe_of(model).kinds
    for name, value in given.items():
        if name not in ("solver", "objective"):
            check_kind(f"fit {model}", name, value, kinds[name])
    found = {**defaults, **given}
    if found:  # the choice among models has none
        recipe_of(model).solver_of(found)
        recipe = recipe_of(model)
        found["solver"] = as_solver(f"fit {model}", found["solver"], recipe.all_solvers)
        if found["solver"].name not in recipe.solvers:
            found |= {name: value for name, value in recipe.stepping.items() if name not in given}
    return found


_KINDS = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}


def check_kind(where: str, name: str, value: object, kind: Any) -> None:
    """Raise RangeError unless `value` is of a kind: a type, or a union of types and literal words.

    Whole numbers serve as numbers, booleans do not. No option of a model has a meaning below 0, or where it is no number.
    """
    one_of = kind_parts(kind)
    kinds = tuple(part for part in one_of if isinstance(part, type))
    if isinstance(value, str) and value in one_of:
        return
    accepted = (*kinds, *([int] if float in kinds else []))
    if not isinstance(value, accepted) or (isinstance(value, bool) and bool not in kinds):
        raise RangeError(message(where, name, f"be {described_kind(kind)}", f"it is {value!r}"))
    if isinstance(value, int | float) and not 0 <= value < math.inf:
        raise RangeError(message(where, name, "be at least 0 and finite", f"it is {value}"))


def described_kind(kind: Any) -> str:
    """Return a kind in words: "a whole number, or 'auto'"."""
    return ", or ".join(_KINDS.get(part, part.__name__) if isinstance(part, type) else repr(part) for part in kind_parts(kind))


def kind_parts(kind: Any) -> tuple[Any, ...]:
    """Return the types and literal words that a kind is a union of."""
    if typing.get_origin(kind) is typing.Literal:
        return typing.get_args(kind)
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return tuple(part for one in typing.get_args(kind) for part in kind_parts(one))
    return (kind,)
