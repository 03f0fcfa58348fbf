"""Fits that go on from a material: every map that is free descends from what it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from torchmat.btf import Btf
from torchmat.errors import RangeError, ShapeError, check_known_keys, check_option, message
from torchmat.fitting.models.any_model import DESCENTS, descend
from torchmat.fitting.recipes import check_kind
from torchmat.fitting.relief.surface import bring_onto, without_shadow
from torchmat.fitting.training import Fitted, Training
from torchmat.models import Material
from torchmat.models.relief_maps import RELIEF_MAPS

_RELIEF = tuple(one.name for one in RELIEF_MAPS)


@dataclass(frozen=True)
class Descent:
    """How a material is fitted on: by which `solver`, so many `steps` at this `rate` (0: the usual), what it `keep`s."""

    solver: str = "minibatch"
    steps: int = 0
    rate: float = 0.0
    keep: tuple[str, ...] = ()


def descent_of(btf: Btf, material: Material, options: dict[str, Any]) -> Descent:
    """Return the Descent that `fit`'s keywords ask for; raises RangeError or ShapeError when it cannot be made."""
    where = "fit a material"
    check_known_keys(where, options, ("solver", "steps", "rate", "keep"))
    keep = options.get("keep", ())
    if isinstance(keep, str):
        raise RangeError(message(where, "keep", "be a list of names", f"it is {keep!r}", f"Give ({keep!r},)."))
    found = Descent(**{**options, "keep": tuple(keep)})
    check_option(where, "solver", found.solver, DESCENTS)
    check_kind(where, "steps", found.steps, int)
    check_kind(where, "rate", found.rate, float)
    names = [spec.name for spec in material.specs()]
    for name in found.keep:
        check_option(where, "keep", name, names)
    if len(kept_names(material, found.keep)) == len(names):
        fact = f"all of {', '.join(names)} are kept"
        step = "Keep fewer; a height and its ambient light always stay as they are."
        raise RangeError(message(where, "keep", "leave a map to fit", fact, step))
    if material.size != (btf.height, btf.width):
        fact = f"it is {material.size[0]} x {material.size[1]}"
        step = "Bring it to that with torchmat.models.edit.resized, or load the BTF in its size."
        raise ShapeError(message(where, "material", f"be {btf.height} x {btf.width} as the images", fact, step))
    return found


def fit_from(training: Training, material: Material, how: Descent) -> Fitted:
    """Fit the free maps of a material to the training samples, flat or on the relief that it has.

    On a relief the samples are brought onto its height, which stays, and its ambient light and shadow are taken off
    them: what is fitted is what one texel does with its light. A normal map
    that refines the height's stays too: `refit` moves both. Best-so-far parameters come back, never the last.
    """
    keep = [name for name in how.keep if name not in _RELIEF]
    settings = {"keep": keep, "rate": how.rate or None, "steps": how.steps or None}
    if not material.has_relief:
        return descend(training, Fitted(material), how.solver, **settings)
    maps = {name: value.detach() for name, value in material.maps.items()}
    surface = bring_onto(training, maps["height"])
    ambient = maps["ambient"] if "ambient" in maps else maps["height"].new_zeros(3, *material.size)
    bare = material.surface()
    own = {name: value.detach() for name, value in bare.maps.items()}
    flat = type(material)(own, **bare.settings(own), **bare.options)
    settings["keep"] = [name for name in own if name in (*keep, *_of_the_height(material, bare))]
    fitted = descend(without_shadow(surface, ambient), Fitted(flat), how.solver, **settings)
    free = [name for name in own if name not in settings["keep"]]
    return fitted.with_material(material.with_maps(**{name: fitted.material.maps[name].detach() for name in free}))


def _of_the_height(material: Material, bare: Material) -> list[str]:
    """Return the maps of its `bare` surface that are not the material's own: normals that hold the height's."""
    return [name for name, value in bare.maps.items() if name not in material.maps or value is not material.maps[name]]


def kept_names(material: Material, keep: Sequence[str]) -> list[str]:
    """Return the maps that a fit from a material leaves to the bit, in the material's order."""
    fixed = (*keep, *_RELIEF, *(_of_the_height(material, material.surface()) if material.has_relief else ()))
    return [spec.name for spec in material.specs() if spec.name in fixed]
