"""Fits by tiles: a material of any size in bounded memory, its tiles fitted alone and joined without seams.

What texels share is found first (`plan_tiles`); after that each texel has its own answer, whatever else is in its tile,
so a tile's border is no border of the result. On a relief a tile's samples are looked up in the images around it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import Tensor

from torchmat.fitting.geometry import Geometry
from torchmat.fitting.recipe import recipe_of
from torchmat.fitting.relief.window import Window
from torchmat.fitting.tiles.plan import TilePart, TilePlan, fit_part, plan_tiles
from torchmat.fitting.tiles.work import Work, open_work
from torchmat.fitting.training import Fitted, Training
from torchmat.progress import progress
from torchmat.solvers.clock import Watch
from torchmat.solvers.stop_reasons import CLOSED_FORM, STEP_LIMIT


def fit_tile(training: Training, plan: TilePlan, window: Window, seconds: float = math.inf) -> TilePart:
    """Fit one tile: its bits depend on the plan and on the images, and on no other tile."""
    own = replace(training, shared=plan.shared, progress=False, watch=Watch(seconds))
    fitted = fit_part(own, plan.model, plan.options, plan.height, window, plan.sight(training))
    material = fitted.material
    names = [spec.name for spec in material.specs() if spec.per_texel and not spec.constant and spec.name != "height"]
    maps = {name: material.maps[name].detach() for name in names}
    return TilePart(window, maps, fitted.coverage, fitted.stop_reason)


def join_tiles(plan: TilePlan, parts: Iterable[TilePart]) -> Fitted:
    """Return the fit of the whole from those of all its tiles."""
    maps: dict[str, Tensor] = {}
    reasons, count = {plan.reason}, 0
    for part in parts:
        given = part.maps if part.coverage is None else {**part.maps, "coverage": part.coverage}
        for name, value in given.items():
            whole = maps.setdefault(name, value.new_empty(value.shape[0], *plan.size))
            part.window.crop(whole).copy_(value)
        reasons.add(part.reason)
        count += 1
    coverage = maps.pop("coverage", None)
    if plan.height is not None:
        maps["height"] = plan.height
    join = recipe_of(plan.model).tiling.join
    if join is not None:
        maps |= join({**plan.template.maps, **maps})
    tiles = {"side": plan.side, "texels_for_what_is_shared": plan.shared_from, "count": count}
    figures = {**plan.figures, "tiles": tiles}
    material = plan.template.with_maps(**{name: value.detach() for name, value in maps.items()})
    return Fitted(material, _overall(reasons), coverage, figures, plan.relief)


def _overall(reasons: set[str]) -> str:
    """Return one reason for all tiles: what went wrong with some, else what ended most work."""
    for usual in (CLOSED_FORM, STEP_LIMIT):
        if len(reasons) > 1:
            reasons = reasons - {usual}
    return min(reasons)


def fit_tiled(
    training: Training, model: str, options: dict[str, Any], geometry: Geometry, tile_size: int, memory_mb: float,
    work: str | Path | None,
) -> Fitted:
    """Fit a model tile by tile; with `work`, go on where an earlier run of the same fit was stopped.

    Finished tiles are kept in that folder, written whole or not at all; it stays until `clear_work`.
    """
    folder = None if work is None else open_work(work, training, model, options, geometry, tile_size, memory_mb)
    plan = None if folder is None else folder.load_plan()
    if plan is None:
        plan = plan_tiles(training, model, options, geometry, tile_size, memory_mb)
        if folder is not None:
            folder.save_plan(plan)
    return join_tiles(plan, _parts(training, plan, folder)).settled(training.btf.mask)


def _parts(training: Training, plan: TilePlan, folder: Work | None) -> Iterator[TilePart]:
    """Yield the parts of all tiles, those that were fitted before from the folder."""
    missing = {}
    for number, window in enumerate(plan.windows):
        part = None if folder is None else folder.load_tile(number, window)
        if part is None:
            missing[window] = number
        else:
            yield part
    parts = _RUNNER.get()(training, plan, list(missing))
    for part in progress(parts, "tiles", total=len(missing), show=training.progress):
        if folder is not None:
            folder.save_tile(missing[part.window], part)
        yield part


def _one_by_one(training: Training, plan: TilePlan, windows: Sequence[Window]) -> Iterator[TilePart]:
    for number, window in enumerate(windows):
        left = training.watch.limit - training.watch.seconds
        yield fit_tile(training, plan, window, max(0.0, left / (len(windows) - number)))


Runner = Callable[[Training, TilePlan, Sequence[Window]], Iterable[TilePart]]
_RUNNER: ContextVar[Runner] = ContextVar("runner", default=_one_by_one)


@contextmanager
def tiles_fitted_by(runner: Runner) -> Iterator[None]:
    """Let `runner` fit the tiles of all fits in the block: it yields the part of each window, in any order."""
    token = _RUNNER.set(runner)
    try:
        yield
    finally:
        _RUNNER.reset(token)
