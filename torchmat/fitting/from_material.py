"""Fits that go on from a material: every map that is free descends from what it is, over the relief that it has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchmat.btf import Btf
from torchmat.errors import RangeError, ShapeError, check_known_keys, check_option, message
from torchmat.fitting.models.any_model import Seen, figures_of, run_descent
from torchmat.fitting.objective import (
    DISPLAY, DISPLAY_POWER, LINEAR, OBJECTIVES, Objective, Residual, check_objective, mean_value, power,
)
from torchmat.fitting.recipe import RECIPES, with_setting
from torchmat.fitting.recipes import check_kind
from torchmat.fitting.relief.refine import refine_height
from torchmat.fitting.relief.surface import Surface, bring_onto
from torchmat.fitting.training import Fitted, Training
from torchmat.geometry import slopes_from_normals
from torchmat.models import Material
from torchmat.models.relief_maps import AMBIENT, RELIEF_MAPS
from torchmat.models.unbounded import Unbounded, is_free
from torchmat.solvers import DESCENTS, Minibatch, Stepping, as_solver
from torchmat.solvers.stop_reasons import DIVERGED, NOT_FINITE, STEP_LIMIT

_HEIGHT, _AMBIENT = "height", "ambient"
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


class _SeenOnSurface(Seen):
    """Samples on the surface of a height, where a texel's light may be shaded and other texels add to it."""

    def __init__(self, surface: Surface, bare: Material, ambient: Tensor) -> None:
        super().__init__(surface.training, bare)
        self.surface, self.ambient = surface, ambient

    def predicted(self, maps: dict[str, Tensor], rows: Tensor) -> Tensor:
        own = {name: value for name, value in maps.items() if name != _AMBIENT}
        lit = self.surface.lit[self.surface.training.btf.light_index[rows]]
        return super().predicted(own, rows) * lit + maps.get(_AMBIENT, self.ambient)


class Descending:
    """A material whose maps, but those in `kept`, descend from what they are; and its height, if it is not kept.

    On a relief the samples are brought onto the surface, and the unknowns are the maps of that (`Material.surface`): a
    normal is the whole one, that of the height included, until the material is made.
    """

    def __init__(self, training: Training, material: Material, kept: Sequence[str], objective: str | Residual) -> None:
        self.training = training = replace(training, relief=material.relief)
        self.material, self.kept, self.objective = material, kept, objective
        self.surface = bring_onto(training, self._height) if material.has_relief else None
        bare = material.surface()
        specs, values = list(bare.own_specs()), dict(bare.maps.items())
        if _AMBIENT in material.maps:
            specs, values = [*specs, AMBIENT], {**values, _AMBIENT: material.maps[_AMBIENT]}
        free = [name for name in material.maps if name not in (*kept, _HEIGHT)]
        self.unknowns = Unbounded(specs, values, set(values) - set(free), training.btf.mask)
        self._see()

    @property
    def _height(self) -> Tensor:
        return self.material.maps[_HEIGHT].detach()

    @property
    def moves_height(self) -> bool:
        """Whether the height is an unknown too."""
        return self.material.has_relief and _HEIGHT not in self.kept

    def _see(self) -> None:
        bare = self.material.surface()
        own = bare.sharing({name: value.detach() for name, value in bare.maps.items()})
        if self.surface is None:
            self.seen = Seen(self.training, own)
        else:
            none = torch.zeros((), dtype=self.material.dtype)
            ambient = self.material.maps[_AMBIENT].detach() if _AMBIENT in self.material.maps else none
            self.seen = _SeenOnSurface(self.surface, own, ambient)

    def made(self) -> Material:
        """Return the material as it stands; maps that are kept are the very ones that it had."""
        found = self.unknowns.made()
        own = self.material.from_surface({name: value for name, value in found.items() if name != _AMBIENT})
        return self.material.with_maps(**own, **{name: found[name] for name in (_AMBIENT,) if name in found})

    def run(self, solver: Stepping, rounds: Sequence[float]) -> Fitted:
        """Descend in rounds that take their share of the solver's steps, moving a height that is free between them."""
        history: list[tuple[float, float]] = []
        figures: dict[str, Any] = {}
        reason, filled = STEP_LIMIT, solver.filled()
        assert filled.steps is not None
        for number, share in enumerate(rounds):
            if self.moves_height and (number > 0 or not self.unknowns.names):
                self.move_height()
            if self.unknowns.names:
                part = replace(filled, steps=max(1, round(filled.steps * share)))
                found = run_descent(part, self.seen.training, self.unknowns, self.seen, self.objective, self.made)
                history, reason = history + found.history, found.reason
                taken = figures.get("steps", 0) + found.steps
                figures = {**figures_of(filled, found), "steps": taken}
            if reason in (NOT_FINITE, DIVERGED) or self.training.watch.spent:
                break
        return Fitted(self.made(), reason, None, figures, history=history)

    def move_height(self) -> None:
        """Bring the height to where the present appearance wants it, and the samples onto it."""
        surface, maps = self.surface, self.unknowns.made()
        assert surface is not None
        level = mean_value(surface.training)
        # The size of a residual by which outlying samples are told is that of values as a display shows them.
        white, darkest = (1.0 if 0.01 < level < 10 else 10 * level), Objective(LINEAR, level).darkest

        def steepness(values: Tensor) -> Tensor:
            return power(values.clamp(min=0) + darkest, DISPLAY_POWER - 1) * (DISPLAY_POWER * white**-DISPLAY_POWER)

        def predict(run: slice) -> Tensor:
            return self.seen.predicted(maps, torch.arange(run.start, run.stop))

        normal = {**self.seen.material.maps, **maps}.get("normal")
        slopes = surface.slopes if normal is None else slopes_from_normals(normal)
        height = refine_height(surface, self._height, slopes, predict, steepness)
        self.material = self.material.with_maps(height=height)
        self.surface = bring_onto(surface.source, height, into=surface)
        self._see()
