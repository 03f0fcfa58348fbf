"""Fits that go on from a material: every map that is free descends from what it is, over the relief that it has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torchmat.btf import Btf
from torchmat.errors import RangeError, ShapeError, check_known_keys, check_option, message
from torchmat.fitting.descending import Descending
from torchmat.fitting.objective import DISPLAY, LINEAR, OBJECTIVES, Residual, check_objective
from torchmat.fitting.recipe import RECIPES, with_setting
from torchmat.fitting.recipes import check_kind
from torchmat.fitting.training import Fitted, Training
from torchmat.models import Material
from torchmat.models.relief_maps import RELIEF_MAPS
from torchmat.models.unbounded import is_free
from torchmat.solvers import DESCENTS, Minibatch, Stepping, as_solver

_RELIEF = tuple(one.name for one in RELIEF_MAPS)
_SUM_ERROR = 0.02  # of weights: more than 8-bit codes of 12 maps are off by


@dataclass(frozen=True)
class Onward:
    """How a material is fitted on: by which `solver`, to make which `objective` small, and what it `keep`s."""

    solver: Stepping = Minibatch()
    objective: str | Residual = LINEAR
    keep: tuple[str, ...] = ()


def usual_objective(material: Material) -> str:
    """Return what fits of the material's model make small; of a model that is not registered the linear error."""
    recipe = RECIPES.get(material.name)
    if recipe is None or recipe.material is not type(material):
        return LINEAR
    return recipe.objective if recipe.objective in OBJECTIVES else DISPLAY  # of roots, as a network gives them, the nearest


def onward_of(btf: Btf, material: Material, options: Mapping[str, Any], where: str = "fit a material") -> Onward:
    """Return the Onward that keywords ask for; raises RangeError or ShapeError when it cannot be made."""
    check_known_keys(where, options, ("solver", "steps", "rate", "keep", "objective"))
    keep = options.get("keep", ())
    if isinstance(keep, str):
        raise RangeError(message(where, "keep", "be a list of names", f"it is {keep!r}", f"Give ({keep!r},)."))
    usual = usual_objective(material)
    solver, objective = as_solver(where, options.get("solver") or Minibatch(), DESCENTS), options.get("objective") or usual
    check_objective(where, objective)
    for name, kind in (("steps", int), ("rate", float)):
        if options.get(name) is not None:
            check_kind(where, name, options[name], kind)
            solver = with_setting(where, solver, name, options[name]) if options[name] else solver
    names = [spec.name for spec in material.specs()]
    for name in keep:
        check_option(where, "keep", name, names)
    if material.size != (btf.height, btf.width):
        fact = f"it is {material.size[0]} x {material.size[1]}"
        step = "Bring it to that with torchmat.models.edit.resized, or load the BTF in its size."
        raise ShapeError(message(where, "material", f"be {btf.height} x {btf.width} as the images", fact, step))
    assert isinstance(solver, Stepping)  # as all of DESCENTS are
    return Onward(solver, objective, tuple(keep))


def check_free(material: Material, kept: Sequence[str], where: str = "fit a material") -> None:
    """Raise RangeError when nothing is left to fit, or weights that are fitted do not sum to 1."""
    specs = material.specs()
    if len(kept) == len(specs):
        fact = f"all of {', '.join(spec.name for spec in specs)} are kept"
        raise RangeError(message(where, "keep", "leave a map to fit", fact, "Keep fewer."))
    for spec in specs:
        if spec.kind == "weights" and spec.name not in kept:
            off = (material.maps[spec.name].detach().sum(dim=0) - 1).abs() > _SUM_ERROR
            if bool(off.any()):
                fact = f"{int(off.sum())} of {off.numel()} texels' do not, first at {tuple(off.nonzero()[0].tolist())}"
                step = f"Keep the {spec.name}, or bring it to that with replace_map."
                raise RangeError(message(where, spec.name, "have weights that sum to 1", fact, step))


def kept_names(material: Material, keep: Sequence[str], relief: bool = True) -> list[str]:
    """Return the maps that stay to the bit, in the material's order: those that no descent changes among them.

    `relief` says that height and ambient light stay as well.
    """
    always = _RELIEF if relief else ()
    return [spec.name for spec in material.specs() if spec.name in (*keep, *always) or not is_free(spec)]


def fit_from(training: Training, material: Material, how: Onward) -> Fitted:
    """Fit the free maps of a material to the training samples, flat or on the relief that it has, which stays.

    Best-so-far parameters come back, never the last.
    """
    return Descending(training, material, kept_names(material, how.keep), how.objective).run(how.solver, (1.0,))
