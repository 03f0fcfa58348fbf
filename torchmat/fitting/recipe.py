"""Recipe: all that mechanism knows of a model's fit; and the table of them, which other packages may add to."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

from torch import Tensor

from torchmat.btf.near import far_only
from torchmat.errors import RangeError, check_option, message
from torchmat.fitting.geometry import FLAT, GEOMETRIES
from torchmat.fitting.models.any_model import descend, fit_by_descent
from torchmat.fitting.models.centred import fit_centred
from torchmat.fitting.objective import LINEAR, check_objective
from torchmat.fitting.relief.surface import Surface
from torchmat.fitting.shared import Shared
from torchmat.fitting.training import Fitted, Training
from torchmat.models import MATERIALS, Material, register_material
from torchmat.models.storage import StoredAs
from torchmat.solvers import DESCENTS, SOLVERS, Solver, Stepping, as_solver

CENTRED = "centred"
AUTO = "auto"  # not a model: the choice among them


@dataclass(frozen=True)
class Rung:
    """One candidate of the automatic choice: a model with its options, and maps that are stored as numbers.

    `bytes` is what its maps take a texel, in 8 bits. `late` says that its fit takes seconds: it is tried on a flat surface
    alone, and where nothing that takes less has what is wanted. `last` says that it is tried after all others, on the relief
    if that helps: what it finds cannot be painted.
    """

    name: str
    model: str
    bytes: float
    options: Mapping[str, Any] = field(default_factory=dict)
    stored: Mapping[str, StoredAs] = field(default_factory=dict)
    late: bool = False
    last: bool = False

    @property
    def settings(self) -> dict[str, Any]:
        """The options of the fit: 8-bit textures, which some maps may be too good for (`shrink`)."""
        return {**self.options, "storage": "png8"}


@dataclass(frozen=True)
class Part:
    """Something that may be added to a material: bytes a texel of its map, the options that ask for it."""

    name: str
    bytes: float
    options: Mapping[str, Any] = field(hash=False)

    @property
    def lobes(self) -> int:
        """How many lobes it makes, 0 if it is about something else."""
        return self.options.get("lobes", 0)


@dataclass(frozen=True)
class Ladder:
    """A material that the automatic choice builds part by part: `bytes` a texel with the options `bare` alone.

    `parts` in the order of trying; `bytes_of_lobe` gives the bytes a texel of what one more lobe needs besides its map,
    `without_idle_parts` the material without parts that are stored as one number. Its recipe has `on_relief`, which
    takes a height of None for a flat surface.
    """

    bare: Mapping[str, Any]
    parts: tuple[Part, ...]
    bytes: float
    bytes_of_lobe: Callable[[Any], float]
    without_idle_parts: Callable[[Any], Material]


@dataclass(frozen=True)
class Tiling:
    """How a model is fitted tile by tile, and what memory that takes.

    What all texels share is found on at most `sharing_texels` of them. `settle` (options, fitted) then returns options
    that leave nothing to decide, and the fit with tables as tiles take them; `join` returns what changes of all
    tiles' maps, the shared ones among them, where they become one material. `bytes_per_texel` is what a tile's fit takes apart from its
    samples, `kept_mb` what it keeps besides; `holds_samples` says that all samples of a tile are held at once.
    `refused` is why a model cannot be fitted so, with what to do.
    """

    sharing_texels: int = 16384
    settle: Callable[[dict[str, Any], Fitted], tuple[dict[str, Any], Fitted]] | None = None
    join: Callable[[dict[str, Any]], dict[str, Any]] | None = None
    bytes_per_texel: int = 9_000
    kept_mb: float = 0.0
    holds_samples: bool = False
    refused: tuple[str, str] | None = None


@dataclass(frozen=True)
class Recipe:
    """A model's fit and all that relief, tiles, choice, comparison and memory need to know of it.

    Either `fit` or `start` is given. What each option means stands in its docstring, in a section "Args:"
    (`describe_model`).

    Args:
        material: the class, whose `name` is the model's.
        fit: ``fit(training, *, ...) -> Fitted``, the model's own way on a flat surface; its keywords are the model's
            options.
        start: ``start(training, *, ...) -> Material``, maps from which the solvers of all models (adam, minibatch, lbfgs)
            descend.
        solvers: what `fit` does, the default first.
        descends: whether the solvers of all models serve as well, from what `fit` makes of few samples; without it `solvers`
            are all there are.
        objective: what the fit makes small, which those solvers then do too unless they are asked for another; a fit that
            takes any has a keyword of that name.
        on_relief: ``on_relief(surface, height, *, ...)`` fits shadow and ambient light itself, or returns None for options
            that take the way of all models; those of `rungs` it must take.
        geometry: "flat" or "recover": what a fit takes the surface for where nothing else is asked.
        quick: options of the fit that says what a relief is worth.
        stepping: options that a solver which steps takes where they are not given, of a model whose own fit is another.
        tiling: how the model is fitted tile by tile, and what memory that takes.
        shared: the class of what its fit says that all texels have in common.
        rungs: candidates of the automatic choice.
        ladder: how the choice builds the model part by part; None if it does not.
        compared: options of its rows in a comparison ("terms=9"; empty is none).
        near: whether `fit` and `on_relief` ask each texel's own directions (``training.planes(samples)``), so that near lights and
            cameras are right. "centred" gives `fit` images that were brought to the directions at the centre (`fitting.models.centred`).
            Without it such data is refused. What descends from `start` always asks.
        solvers_differ: whether a comparison has a row for each further solver, where none is the obvious one.
        bytes_per_texel: what the maps take by default, in words, for lists of models; empty where unknown.
        by_luminance: maps that `fit` finds from the luminance of the samples alone, for their standard errors.
    """

    material: type[Material]
    fit: Callable[..., Fitted] | None = None
    start: Callable[..., Material] | None = None
    solvers: tuple[str, ...] = ("closed_form",)
    descends: bool = True
    objective: str = LINEAR
    on_relief: Callable[..., Fitted | None] | None = None
    quick: Mapping[str, Any] = field(default_factory=dict)
    stepping: Mapping[str, Any] = field(default_factory=dict)
    tiling: Tiling = Tiling()
    shared: type[Shared] = Shared
    geometry: str = FLAT
    rungs: tuple[Rung, ...] = ()
    ladder: Ladder | None = None
    compared: tuple[str, ...] = ("",)
    near: bool | Literal["centred"] = False
    solvers_differ: bool = False
    bytes_per_texel: str = ""
    by_luminance: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        where = "Recipe"
        if not (isinstance(self.material, type) and issubclass(self.material, Material)):
            raise RangeError(message(where, "material", "be a subclass of Material", f"it is {self.material!r}"))
        if not isinstance(getattr(self.material, "name", None), str):
            step = "Write `name = \"...\"` into the class."
            raise RangeError(message(where, "material", "have a name", f"{self.material.__name__} has none", step))
        if (self.fit is None) == (self.start is None):
            fact = "both are given" if self.fit else "neither is given"
            step = "Give fit(training, *, ...) -> Fitted, or start(training, *, ...) -> Material to descend from."
            raise RangeError(message(where, f"the fit of {self.name}", "be `fit` or `start`", fact, step))
        check_option(where, "geometry", self.geometry, GEOMETRIES)
        for solver in self.solvers:
            check_option(where, f"a solver of {self.name}", solver, SOLVERS)

    @property
    def name(self) -> str:
        """The model's name."""
        return self.material.name

    @property
    def way(self) -> Callable[..., Any]:
        """The function whose keywords are the model's options: `fit` or `start`."""
        way = self.fit or self.start
        assert way is not None  # one of them is given
        return way

    @property
    def all_solvers(self) -> tuple[str, ...]:
        """Every solver that may be asked for, the default first."""
        if self.fit is None:
            return ("minibatch", "adam", "lbfgs")
        return (*self.solvers, *(one for one in DESCENTS if one not in self.solvers)) if self.descends else self.solvers

    @property
    def options(self) -> dict[str, Any]:
        """The model's options and their defaults: the keywords of its fit or start, the solver and the objective."""
        parameters = inspect.signature(self.way).parameters.values()
        own = {p.name: p.default for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY}
        more = {"steps": 0, "rate": 0.0} if self.fit is None else {}
        return {**own, **more, "solver": self.all_solvers[0], "objective": self.objective}

    @property
    def kinds(self) -> dict[str, Any]:
        """What each option may be: a type, or a union of types and literal words."""
        hints = typing.get_type_hints(self.fit or self.start)
        found = {"steps": int, "rate": float, **hints, "solver": str, "objective": str}
        return {name: found.get(name, type(default)) for name, default in self.options.items()}

    @property
    def iterates(self) -> bool:
        """Whether the default solver goes step by step, so that a time says more with its error."""
        return issubclass(SOLVERS[self.all_solvers[0]], Stepping)

    def solver_of(self, options: Mapping[str, Any]) -> Solver:
        """Return the solver that options ask for, with their `steps` and `rate`, and check that it takes their objective.

        Raises RangeError, saying what to give, for solvers that do not serve this model, for settings that are given
        twice, and for an objective that the solver has none of.
        """
        where = f"fit {self.name}"
        solver = as_solver(where, options.get("solver") or self.all_solvers[0], self.all_solvers)
        for name in ("steps", "rate") if self.fit is None else ():
            if options.get(name):
                solver = with_setting(where, solver, name, options[name])
        objective = options.get("objective", self.objective)
        check_objective(where, objective, (self.objective,))
        if objective != self.objective and not isinstance(solver, Stepping):
            others = [name for name in self.all_solvers if issubclass(SOLVERS[name], Stepping)]
            step = f"Give solver={' or '.join(map(repr, others))}, which make any small."
            step = step if others else "A fit that goes on from the material takes any: fit(btf, material, objective=...)."
            wanted = f"be {self.objective!r} by {solver.name}"
            raise RangeError(message(where, "objective", wanted, f"it is {objective!r}", step))
        return solver

    def run(self, training: Training, **options: Any) -> Fitted:
        """Fit the model to a flat surface by one of its solvers; neutral outside of an object mask."""
        return self._run(training, options).settled(training.btf.mask)

    def _run(self, training: Training, options: dict[str, Any]) -> Fitted:
        if self.start is None and not self.near:
            far_only(f"fit {self.name}", training.btf.near)
        solver, objective = self.solver_of(options), options.pop("objective", self.objective)
        options.pop("solver", None)
        if self.start is not None:
            assert isinstance(solver, Stepping)
            own = {name: value for name, value in options.items() if name not in ("steps", "rate")}
            material = self.start(training, **own)
            tables = [spec.name for spec in material.own_specs() if spec.constant or not spec.per_texel]
            known = {name: table for name in tables if (table := training.table(name)) is not None}
            material = material.with_maps(**known) if known else material
            begun = Fitted(material, shared=Shared({name: material.maps[name].detach() for name in tables}))
            return descend(training, begun, solver, objective)
        assert self.fit is not None
        way = fit_centred(self.fit) if self.near == CENTRED else self.fit
        if solver.name not in self.solvers:
            assert isinstance(solver, Stepping)
            return fit_by_descent(training, way, solver, {**self.stepping, **options}, objective)
        return way(training, **options, **_taken(self.fit, solver=solver, objective=objective))

    def run_on_relief(self, surface: Surface, height: Tensor, options: Mapping[str, Any]) -> Fitted | None:
        """Fit the model over a relief in its own way; None where these options take the way of all models."""
        if self.on_relief is None:
            return None
        if not self.near:
            far_only(f"fit {self.name}", surface.training.btf.near)
        solver, objective = self.solver_of(options), options.get("objective", self.objective)
        if solver.name not in self.solvers:
            return None
        own = {name: value for name, value in options.items() if name not in ("solver", "objective")}
        found = self.on_relief(surface, height, **own, **_taken(self.on_relief, solver=solver, objective=objective))
        return None if found is None else found.settled(surface.training.btf.mask)


def with_setting(where: str, solver: Solver, name: str, value: Any) -> Solver:
    """Return a solver with one more setting; raises RangeError when it has it already, or none of that name."""
    if name in solver.given:
        fact = f"the solver has {solver.given[name]!r} and {name} is {value!r}"
        raise RangeError(message(where, name, "be given once", fact, "Leave one of them out."))
    if name not in (field.name for field in fields(solver)):
        raise RangeError(message(where, name, f"be left out with {solver.name}", "it has no such setting"))
    return replace(solver, **{name: value})


def _taken(function: Callable[..., Any], **offered: Any) -> dict[str, Any]:
    """Return those of the keywords that a function has."""
    known = inspect.signature(function).parameters
    every = any(one.kind is one.VAR_KEYWORD for one in known.values())
    return {name: value for name, value in offered.items() if every or name in known}


RECIPES: dict[str, Recipe] = {}


def register(recipe: Recipe) -> Recipe:
    """Add a model to those that `fit`, `compare`, folders and pictures know by name; return the recipe.

    Args:
        recipe: the model's material and fit. The built-in models come the same way.

    Raises RangeError when the name is taken, or the recipe is none.
    """
    if not isinstance(recipe, Recipe):
        step = "Give Recipe(material=..., start=...) or Recipe(material=..., fit=...)."
        raise RangeError(message("register", "recipe", "be a Recipe", f"it is {type(recipe).__name__}", step))
    if recipe.name in RECIPES or recipe.name == AUTO:
        step = "Give the class another name."
        raise RangeError(message("register", "the model's name", "be new", f"{recipe.name!r} is taken", step))
    if MATERIALS.get(recipe.name) is not recipe.material:
        register_material(recipe.material)
    RECIPES[recipe.name] = recipe
    return recipe


def unregister(name: str) -> None:
    """Take a model out again, the counterpart of `register`; materials of it can no longer be loaded by name."""
    check_option("unregister", "name", name, RECIPES)
    del RECIPES[name]
    MATERIALS.pop(name, None)


def recipe_of(model: str) -> Recipe:
    """Return the recipe of a model; raises RangeError, with the nearest name, for an unknown one."""
    check_option("fit", "model", model, RECIPES)
    return RECIPES[model]
