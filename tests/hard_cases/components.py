"""What the hard cases are run on: every registered model, solver, reader and writer, and the renderer, found anew at each call."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from tests.models.examples import EXAMPLE_OPTIONS

from torchmat.fitting.recipe import RECIPES
from torchmat.models import MATERIALS
from torchmat.rendering.scene import PATCH
from torchmat.rendering.shapes import SHAPES
from torchmat.solvers import DESCENTS, SOLVERS, Solver


class Component(NamedTuple):
    """One thing that the cases of its kind are run on; `given` is what their checks need to know of it."""

    kind: str
    name: str
    given: Any


class Room(NamedTuple):
    """Where a check may write, and whether it has the time for all its inputs (the long form) or for a few of them."""

    folder: Path
    thorough: bool = False


class NotHere(Exception):
    """What a check needs is not permitted or not there on this machine."""


Check = Callable[[Any, Room], float | None]


def outcome(check: Callable[[], float | None]) -> dict[str, Any]:
    """Run a check; return its figure, whether it passed (None: what it needs is not here), and why not."""
    try:
        return {"figure": check(), "passed": True, "note": ""}
    except NotHere as missing:
        return {"figure": None, "passed": None, "note": str(missing)}
    except BaseException as error:  # pytest's own failures are no Exceptions
        if isinstance(error, KeyboardInterrupt):
            raise
        return {"figure": None, "passed": False, "note": f"{type(error).__name__}: {error}"[:600]}


def _said(value: object) -> str:
    return "+".join(map(str, value)) or "none" if isinstance(value, list) else str(value)


def models() -> list[Component]:
    """Return every registered model in each variant of its examples; one that has none there, as it is by default."""
    return [
        Component("model", "-".join([name, *map(_said, options.values())]), (name, options))
        for name in MATERIALS for options in EXAMPLE_OPTIONS.get(name, [{}])
    ]


def solvers() -> list[Component]:
    """Return every model with each of its solvers: what fits."""
    return [Component("solver", f"{model}-{solver}", (model, solver)) for model, recipe in RECIPES.items() for solver in recipe.all_solvers]


def readers() -> list[Component]:
    """Return everything that reads a file."""
    from tests.hard_cases.fuzz_readers import READERS

    return [Component("reader", reader.name, reader) for reader in READERS]


def writers() -> list[Component]:
    """Return everything that writes files: the material folder in each storage, and all that has a form of its own."""
    from tests.hard_cases.writers import writers as known

    return [Component("writer", writer.name, writer) for writer in known()]


def renderers() -> list[Component]:
    """Return the renderer with each shape that it makes."""
    return [Component("renderer", shape, shape) for shape in (PATCH, *SHAPES)]


KINDS: dict[str, Callable[[], list[Component]]] = {
    "model": models, "solver": solvers, "reader": readers, "writer": writers, "renderer": renderers,
}

_FEW_STEPS, _MORE_STEPS = {"adam": 6, "minibatch": 12, "lbfgs": 4}, {"adam": 60, "minibatch": 120, "lbfgs": 30}


def stepping(model: str, solver: str, room: Room, **more: Any) -> str | Solver:
    """Return a solver that takes few steps, more when the room has time: what breaks, breaks early; others as they are."""
    if solver not in DESCENTS or solver in RECIPES[model].solvers:
        return solver
    return SOLVERS[solver](steps=(_MORE_STEPS if room.thorough else _FEW_STEPS)[solver], **more)
