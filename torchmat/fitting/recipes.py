"""Which function fits which model, and which options it takes."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable
from typing import Any

from torchmat.errors import RangeError, check_known_keys, check_option, message
from torchmat.fitting.models.any_model import DESCENTS, fit_by_descent
from torchmat.fitting.models.distribution.fit import fit_distribution
from torchmat.fitting.models.distribution.options import DISTRIBUTION_SOLVERS
from torchmat.fitting.models.linear import fit_hsh, fit_lambert, fit_lptm, fit_ptm, fit_texture
from torchmat.fitting.models.neural import fit_neural
from torchmat.fitting.models.pca import fit_local_pca, fit_pca
from torchmat.fitting.models.phong_srf import fit_phong_srf
from torchmat.fitting.models.shading_map import fit_shading_map
from torchmat.fitting.models.spheres.to_btf import fit_sphere_images_to_btf
from torchmat.fitting.training import Fitted, Training

_OWN_ROADS: dict[str, Callable[..., Fitted]] = {
    "texture": fit_texture,
    "lambert": fit_lambert,
    "ptm": fit_ptm,
    "lptm": fit_lptm,
    "hsh": fit_hsh,
    "phong_srf": fit_phong_srf,
    "pca": fit_pca,
    "local_pca": fit_local_pca,
    "distribution": fit_distribution,
    "shading_map": fit_shading_map,
    "sphere_images": fit_sphere_images_to_btf,
    "neural": fit_neural,
}

# The first is the default: the fastest road to the model's error that was measured.
SOLVERS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("texture", "lambert", "ptm", "lptm", "hsh", "sphere_images"), ("closed_form", *DESCENTS)),
    "phong_srf": ("lm", "varpro", *DESCENTS),
    "distribution": DISTRIBUTION_SOLVERS,
    # Their tables hold a number for each measured sample: a start that has them all is a factorisation, the answer itself.
    "pca": ("closed_form",), "local_pca": ("closed_form",),
    # Slices are sorted by the brightness that the BRDF gives: moving it deals the samples out anew, which has no slope.
    "shading_map": ("closed_form",),
    "neural": ("minibatch",),
}
_OWN_OBJECTIVES = ("distribution",)  # their functions know all their solvers


def _by_any_solver(model: str, own: Callable[..., Fitted]) -> Callable[..., Fitted]:
    """Return the fit function of a model with `solver` among its options."""
    choices = SOLVERS[model]
    takes_it = "solver" in inspect.signature(own).parameters

    @functools.wraps(own)
    def fit(training: Training, *, solver: str = choices[0], **options: Any) -> Fitted:
        check_option(f"fit {model}", "solver", solver, choices)
        if solver in DESCENTS and solver != choices[0]:
            return fit_by_descent(training, own, solver, options)
        return own(training, **options, **({"solver": solver} if takes_it else {}))

    return fit


FITTERS: dict[str, Callable[..., Fitted]] = {
    model: own if model in _OWN_OBJECTIVES else _by_any_solver(model, own) for model, own in _OWN_ROADS.items()
}


AUTO = "auto"  # not a model: the choice among them


def default_options(model: str) -> dict[str, object]:
    """Return the options of a model and their defaults: the keyword arguments of its fit function."""
    check_option("fit", "model", model, (*FITTERS, AUTO))
    if model == AUTO:
        return {}
    parameters = inspect.signature(FITTERS[model]).parameters.values()
    own = {p.name: p.default for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY}
    return {**own, "solver": SOLVERS[model][0]}


def resolve_options(model: str, given: dict[str, object]) -> dict[str, object]:
    """Return all options of `model` with those `given`; raises RangeError, with the nearest name, for unknown ones."""
    defaults = default_options(model)
    check_known_keys(f"fit {model}", given, defaults)
    for name, value in given.items():
        _check_kind(f"fit {model}", name, value, type(defaults[name]))
    if "solver" in given:
        check_option(f"fit {model}", "solver", given["solver"], SOLVERS[model])
    return {**defaults, **given}


def _check_kind(where: str, name: str, value: object, kind: type) -> None:
    """Raise RangeError unless `value` is of the default's kind; whole numbers serve as numbers, booleans do not.

    No option of a model has a meaning below 0, or where it is no number.
    """
    accepted = (int, float) if kind is float else kind
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        names = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
        raise RangeError(message(where, name, f"be {names.get(kind, kind.__name__)}", f"it is {value!r}"))
    if kind in (int, float) and not 0 <= value < math.inf:
        raise RangeError(message(where, name, "be at least 0 and finite", f"it is {value}"))
