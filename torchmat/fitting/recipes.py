"""The models that come with the package, registered; and a model's options, resolved and checked."""

from __future__ import annotations

import math

from torchmat.errors import RangeError, check_known_keys, check_option, message
from torchmat.fitting.models.distribution.recipe import DISTRIBUTION
from torchmat.fitting.models.linear import HSH, LAMBERT, LPTM, PTM, TEXTURE
from torchmat.fitting.models.neural import NEURAL
from torchmat.fitting.models.pca import LOCAL_PCA, PCA
from torchmat.fitting.models.phong_srf import PHONG_SRF
from torchmat.fitting.models.shading_map import SHADING_MAP
from torchmat.fitting.models.spheres.to_btf import SPHERE_IMAGES
from torchmat.fitting.recipe import AUTO, RECIPES, recipe_of, register

for _recipe in (
    TEXTURE, LAMBERT, LPTM, PTM, HSH, PHONG_SRF, PCA, LOCAL_PCA, SPHERE_IMAGES, SHADING_MAP, DISTRIBUTION, NEURAL,
):
    register(_recipe)


def default_options(model: str) -> dict[str, object]:
    """Return the options of a model and their defaults: the keyword arguments of its fit function."""
    check_option("fit", "model", model, (*RECIPES, AUTO))
    return {} if model == AUTO else recipe_of(model).options


def resolve_options(model: str, given: dict[str, object]) -> dict[str, object]:
    """Return all options of `model` with those `given`; raises RangeError, with the nearest name, for unknown ones."""
    defaults = default_options(model)
    check_known_keys(f"fit {model}", given, defaults)
    for name, value in given.items():
        check_kind(f"fit {model}", name, value, type(defaults[name]))
    if "solver" in given:
        check_option(f"fit {model}", "solver", given["solver"], recipe_of(model).all_solvers)
    return {**defaults, **given}


def check_kind(where: str, name: str, value: object, kind: type) -> None:
    """Raise RangeError unless `value` is of the default's kind; whole numbers serve as numbers, booleans do not.

    No option of a model has a meaning below 0, or where it is no number.
    """
    accepted = (int, float) if kind is float else kind
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        names = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
        raise RangeError(message(where, name, f"be {names.get(kind, kind.__name__)}", f"it is {value!r}"))
    if kind in (int, float) and not 0 <= value < math.inf:
        raise RangeError(message(where, name, "be at least 0 and finite", f"it is {value}"))
