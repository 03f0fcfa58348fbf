"""Which function fits which model, and which options it takes."""

from __future__ import annotations

import inspect
from collections.abc import Callable

from torchmat.errors import RangeError, check_known_keys, check_option, message
from torchmat.fit.distribution import fit_distribution
from torchmat.fit.linear import fit_hsh, fit_lambert, fit_lptm, fit_ptm, fit_texture
from torchmat.fit.pca import fit_local_pca, fit_pca
from torchmat.fit.phong_srf import fit_phong_srf
from torchmat.fit.shading_map import fit_shading_map
from torchmat.fit.sphere_btf import fit_sphere_images_to_btf
from torchmat.fit.training import Fitted

FITTERS: dict[str, Callable[..., Fitted]] = {
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
}


AUTO = "auto"  # not a model: the choice among them


def default_options(model: str) -> dict[str, object]:
    """Return the options of a model and their defaults: the keyword arguments of its fit function."""
    check_option("fit", "model", model, (*FITTERS, AUTO))
    if model == AUTO:
        return {}
    parameters = inspect.signature(FITTERS[model]).parameters.values()
    return {p.name: p.default for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY}


def resolve_options(model: str, given: dict[str, object]) -> dict[str, object]:
    """Return all options of `model` with those `given`; raises RangeError, with the nearest name, for unknown ones."""
    defaults = default_options(model)
    check_known_keys(f"fit {model}", given, defaults)
    for name, value in given.items():
        _check_kind(f"fit {model}", name, value, type(defaults[name]))
    return {**defaults, **given}


def _check_kind(where: str, name: str, value: object, kind: type) -> None:
    """Raise RangeError unless `value` is of the default's kind; whole numbers serve as numbers, booleans do not."""
    accepted = (int, float) if kind is float else kind
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        names = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
        raise RangeError(message(where, name, f"be {names.get(kind, kind.__name__)}", f"it is {value!r}"))
