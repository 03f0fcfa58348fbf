"""Several models and solvers on one set of held-out directions: error beside bytes, seconds and shading speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from torchmat import atomic
from torchmat.btf import Btf, split_samples
from torchmat.errors import RangeError, check_option, message
from torchmat.fitting.evaluate import MEASURES
from torchmat.fitting.geometry import resolve_geometry
from torchmat.fitting.recipe import RECIPES, Recipe
from torchmat.fitting.recipes import resolve_options
from torchmat.progress import whole
from torchmat.report.compare_plots import PLOTS, write_plots
from torchmat.report.compare_rows import Entry, Setting, entry_of, judged, make_row, mark_fronts, parse_model
from torchmat.report.compare_page import comparison_page
from torchmat.report.tables import to_json, write_csv

__all__ = ["check_target", "closed_forms", "compare", "default_models", "parse_model", "write_comparison"]


def closed_forms() -> tuple[str, ...]:
    """Return the rows of all registered models that are solved at once."""
    return _rows(lambda recipe: not recipe.iterates)


def default_models() -> tuple[str, ...]:
    """Return the rows of a comparison of all registered models, those that go step by step last."""
    further = (
        f"{recipe.name}:solver={solver}" for recipe in RECIPES.values() if recipe.solvers_differ
        for solver in recipe.all_solvers[1:]
    )
    return (*closed_forms(), *_rows(lambda recipe: recipe.iterates), *further)


def _rows(wanted: Callable[[Recipe], bool]) -> tuple[str, ...]:
    return tuple(
        f"{recipe.name}:{options}" if options else recipe.name
        for recipe in RECIPES.values() if wanted(recipe) for options in recipe.compared
    )


_FILES = ("comparison.json", "comparison.csv", "comparison.html", *(f"{name}.png" for name in PLOTS))


def compare(
    btf: Btf, models: Sequence[str] | None = None, *, budget: float | None = None, repeats: int = 1,
    geometry: Any = None, curves: bool = True, holdout: float = 0.2, holdout_by: str = "pair", seed: int = 0,
    measure: str = "full", progress: bool | None = None, each: Callable[[list[dict[str, Any]]], Any] | None = None,
) -> list[dict[str, Any]]:
    """Fit each model on the same split; return a row each: error, bytes, seconds, memory, shading rate, full report.

    A model that the data cannot determine gets a row whose figures are None and whose `failed` says why; nothing else
    is hidden. What the columns mean stands in `report.tables.COMPARE_MEANINGS`.

    Args:
        btf: the images.
        models: names, or names with options: ``"hsh:terms=9"``, ``"phong_srf:solver=adam"``, ``"lambert:geometry=recover"``;
            None is all registered models (`default_models`).
        budget: seconds that an iterative solver may take, which then stops with the best it has; None is no limit.
        repeats: how often each is fitted, on the same split from the same seed: seconds are the median, with their spread,
            and `same_bits` says whether the result was the same. At least 1.
        geometry: as `fit` takes it, a word, a height map or the path of one, for all whose text says nothing of it; None
            leaves each to its own way.
        curves: whether rows of iterative solvers have the error on some held-out samples against seconds, measured off the
            clock.
        holdout: share of the samples held out, in [0, 1).
        holdout_by: "pair", "light", "view", "both" or "arc" (`split_samples`).
        seed: seed of the split and of the solvers, from 0.
        measure: "full", errors on all held-out samples, or "quick", on some, about 2 million texels.
        progress: whether to show a bar; None shows it on a terminal.
        each: called with the rows so far after every model, so that a long comparison that is interrupted has lost nothing.

    Raises RangeError, before any fit, for models that are unknown or given twice, and for a budget or repeats that leave
    nothing.
    """
    entries = _entries(default_models() if models is None else models, geometry)
    if budget is not None and not budget > 0:
        step = "It is the seconds of one fit."
        raise RangeError(message("compare", "budget", "be positive", f"it is {budget}", step))
    if not isinstance(repeats, int) or isinstance(repeats, bool) or repeats < 1:
        raise RangeError(message("compare", "repeats", "be a whole number of at least 1", f"it is {repeats!r}"))
    check_option("compare", "measure", measure, MEASURES[1:3])
    split_samples(btf, holdout, holdout_by, seed)  # what is wrong with the split is no model's failure
    setting = Setting({"holdout": holdout, "holdout_by": holdout_by, "seed": seed}, budget, repeats, curves, measure == MEASURES[1])
    rows: list[dict[str, Any]] = []
    with whole("comparing", len(entries), show=progress) as bar:
        for number, entry in enumerate(entries, 1):
            bar.what = f"comparing {entry.model} ({number} of {len(entries)})"
            rows = mark_fronts([*rows, make_row(btf, entry, setting)])
            if each is not None:
                each(rows)
            bar.advance()
    return rows


def _entries(models: Sequence[str], geometry: Any) -> list[Entry]:
    surface = None if geometry is None else resolve_geometry(geometry)
    if isinstance(models, str) or not models:
        step = "Leave it out for all families."
        raise RangeError(message("compare", "models", "be a list of at least one", f"it is {models!r}", step))
    entries = [entry_of(text, surface) for text in models]
    seen: dict[str, str] = {}
    for entry in entries:
        key = repr((entry.model, entry.where, sorted(resolve_options(entry.model, entry.options).items())))
        if key in seen:
            fact = f"{entry.text!r} is the same as {seen[key]!r}"
            raise RangeError(message("compare", "the models", "differ", fact, "Use repeats to fit one several times."))
        seen[key] = entry.text
    return entries


def check_target(target: str | Path) -> None:
    """Raise DataError unless `target` may be replaced: absent, empty, or an earlier comparison and nothing else."""
    atomic.refuse_foreign(Path(target), lambda name: name in _FILES, "an earlier comparison")


def write_comparison(
    rows: list[dict[str, Any]], folder: str | Path, title: str = "Comparison of models", plots: bool = True
) -> Path:
    """Write rows as JSON, CSV and one HTML page with plots, whole or not at all; return the folder.

    `plots` False leaves the pictures out, which take most of the time: for rows that are not all there yet.
    """
    target = Path(folder)
    check_target(target)
    with atomic.building(target) as building:
        (building / "comparison.json").write_text(to_json([_without_picture(row) for row in rows]), encoding="utf-8")
        write_csv(rows, building / "comparison.csv")
        drawn = plots and any(judged(row) is not None for row in rows)
        pictures = write_plots(rows, building) if drawn else []
        (building / "comparison.html").write_text(comparison_page(title, rows, pictures), encoding="utf-8")
    return target


def _without_picture(row: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in row.items() if name != "picture"}
