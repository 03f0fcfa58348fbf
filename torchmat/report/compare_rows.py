"""One row of a comparison: a model fitted several times on one split, with what it costs and how true it is."""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field
from typing import Any

import torch

from torchmat import colour
from torchmat.btf import Btf
from torchmat.errors import FitError, RangeError, message
from torchmat.fitting import FitResult, fit
from torchmat.fitting.config import parse_value
from torchmat.fitting.evaluate import comparable, evaluate, evaluate_parts
from torchmat.fitting.geometry import Geometry, Given, check_word, resolve_geometry
from torchmat.fitting.recipe import recipe_of
from torchmat.fitting.recipes import AUTO, resolve_options
from torchmat.machine import MemoryMark
from torchmat.report.inline import data_uri
from torchmat.report.pictures import thinned
from torchmat.report.samples import shown
from torchmat.report.tables import COMPARE_COLUMNS, INTERVAL
from torchmat.solvers import Solver, Stepping

_COSTS = {"total_bytes_per_texel": "bytes", "fit_seconds": "seconds", "shade_mtexels_per_s": "shading"}


PICTURE_SIDE = 72  # pixels along a side of a row's pictures


@dataclass(frozen=True)
class Entry:
    """One row that is asked for: `text` as it was given, the model, its options, and its geometry.

    `asked` is the geometry that its own text names, if it does.
    """

    text: str
    model: str
    options: dict[str, Any]
    geometry: Geometry
    asked: str | None = None

    @property
    def solver(self) -> str:
        """How the model's numbers are found."""
        return self._solver.name

    @property
    def _solver(self) -> Solver:
        return resolve_options(self.model, self.options)["solver"]

    @property
    def where(self) -> tuple[str, ...]:
        """What its geometry is, in words that tell two of them apart."""
        return (self.geometry.word, str(self.asked)) if isinstance(self.geometry, Given) else (self.geometry.word,)

    @property
    def iterates(self) -> bool:
        """Whether its error falls bit by bit, so that a curve says more than a point."""
        return isinstance(self._solver, Stepping)


@dataclass(frozen=True)
class Setting:
    """What all rows share: the split, the `budget` of seconds of one fit, its repeats, whether curves are drawn, and whether
    errors are measured on some samples alone."""

    split: dict[str, Any] = field(default_factory=dict)
    budget: float | None = None
    repeats: int = 1
    curves: bool = True
    quick: bool = False


def parse_model(text: str) -> tuple[str, dict[str, Any]]:
    """Split ``hsh:terms=9,storage=png8`` into the model's name and its options, both checked.

    `geometry`, flat, recover or the path of a height map, may stand among the options: ``lambert:geometry=recover``.
    """
    name, _, rest = text.partition(":")
    options: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, separator, value = part.partition("=")
        if not separator:
            raise RangeError(message("compare", repr(text), "be NAME:KEY=VALUE,...", f"{part!r} has no '='"))
        options[key.strip()] = parse_value(value)
    own = {key: value for key, value in options.items() if key != "geometry"}
    resolve_options(name, own)
    if name == AUTO:
        step = 'Give models; fit(btf, "auto") chooses among them.'
        raise RangeError(message("compare", "the models", "be models", f"{AUTO!r} is the choice among them", step))
    if "geometry" in options:
        check_word("compare", str(options["geometry"]), by_itself=False)
    return name, options


def entry_of(text: str, geometry: Geometry | None) -> Entry:
    """Return the row that a model's text asks for; `geometry` holds unless the text says otherwise, None is its own way."""
    name, options = parse_model(text)
    own = {key: value for key, value in options.items() if key != "geometry"}
    asked = options.get("geometry")
    if asked is not None or geometry is None:
        geometry = resolve_geometry(asked, default=recipe_of(name).geometry)
    return Entry(text, name, own, geometry, asked)


def make_row(btf: Btf, entry: Entry, setting: Setting) -> dict[str, Any]:
    """Fit one model as often as is asked for and return its row; what the data cannot determine says so in `failed`."""
    row: dict[str, Any] = dict.fromkeys(COMPARE_COLUMNS)
    row |= {"model": entry.text, "solver": entry.solver, "geometry": entry.geometry.word, "curve": [], "report": None, "picture": None}
    runs: list[tuple[FitResult, float | None]] = []
    with_curve = entry.iterates and setting.curves
    try:
        for repeat in range(setting.repeats):
            # The last run draws the curve; where there are others, the memory is theirs, free of measuring.
            runs.append(_run(btf, entry, setting, with_curve and repeat == setting.repeats - 1))
    except (FitError, RangeError) as error:  # too few lights for a relief are known only by the data
        return row | {"failed": str(error)}
    return row | _figures(btf, runs, setting.quick) | ({"curve": runs[-1][0].report["curve"]} if with_curve else {})


def _run(btf: Btf, entry: Entry, setting: Setting, curve: bool) -> tuple[FitResult, float | None]:
    mark = MemoryMark()
    result = fit(
        btf, entry.model, geometry=entry.geometry, seconds=setting.budget, curve=curve, measure=False, progress=False,
        **setting.split, **entry.options,
    )
    return result, mark.taken_mb


def _figures(btf: Btf, runs: list[tuple[FitResult, float | None]], quick: bool) -> dict[str, Any]:
    result, report = runs[-1][0], runs[-1][0].report
    report = report | evaluate_parts(btf, result.material, result.split, False, quick, full=not quick)[0]
    seconds = [one.report["fit_seconds"] for one, _ in runs]
    memory = [taken for _, taken in runs[: max(1, len(runs) - 1)] if taken is not None]
    held_out, after = report["held_out"] or report["train"], report["held_out_after_export"] or {}
    low, high = held_out[INTERVAL] or (None, None)
    total = report["bytes_per_texel"] + report["shared_bytes"] / report["texels"]
    geometry = report["figures"].get("geometry", {}).get("chosen", report["geometry"])
    return {
        **{name: report[name] for name in ("bytes_per_texel", "shared_bytes", "shade_mtexels_per_s", "stop_reason")},
        "geometry": "flat (recover)" if (geometry, report["geometry"]) == ("flat", "recover") else geometry,
        "total_bytes_per_texel": total, "fit_seconds": statistics.median(seconds),
        "fit_seconds_spread": max(seconds) - min(seconds) if len(runs) > 1 else None,
        "fit_memory_mb": max(memory) if memory else None,
        "train_relative_error": report["train"]["relative_error"],
        "relative_error": held_out["relative_error"], "relative_error_low": low, "relative_error_high": high, "psnr_db": held_out["psnr_db"],
        "relative_error_after_export": after.get("relative_error"), "psnr_db_after_export": after.get("psnr_db"),
        **_repeated(btf, [one for one, _ in runs], held_out["relative_error"]),
        "repeats": seconds, "report": report, "picture": _picture(btf, result),
    }


def _picture(btf: Btf, result: FitResult) -> dict[str, Any]:
    """Return one photograph and its fit as data URIs, small: the same for all models, of middling slant among the held out."""
    material, btf = comparable(result.material, btf)
    indices = result.split.held_out if len(result.split.held_out) else result.split.train
    slant = btf.light[indices, 2] + btf.view[indices, 2]
    one = shown(btf, material, int(indices[slant.argsort(stable=True)[len(slant) // 2]]), "middling")
    target, fit = (thinned(colour.display(picture), PICTURE_SIDE) for picture in (one.target, one.fit))
    size = [int(target.shape[1]), int(target.shape[2])]
    return {"sample": one.sample, "directions": one.directions, "size": size, "target": data_uri(target), "fit": data_uri(fit)}


def _repeated(btf: Btf, results: list[FitResult], error: float | None) -> dict[str, Any]:
    """Return whether all repeats gave the same bits, and if not, the errors of all."""
    if len(results) == 1:
        return {"same_bits": None}
    last = results[-1].material.maps
    alike = [all(torch.equal(value, last[name]) for name, value in one.material.maps.items()) for one in results]
    if all(alike):
        return {"same_bits": True}
    split = results[-1].split
    rows = split.held_out if len(split.held_out) else split.train
    others = [evaluate(one.material, btf, rows, perceptual=False).report["relative_error"] for one in results[:-1]]
    return {"same_bits": False, "relative_errors": [*others, error]}


def judged(row: dict[str, Any]) -> float | None:
    """Return the error that a row is compared by: held out, after export where it was measured."""
    return row["relative_error"] if row["relative_error_after_export"] is None else row["relative_error_after_export"]


def front(rows: list[dict[str, Any]], cost: str) -> list[int]:
    """Return the rows, from cheap to dear, that no other row beats in `cost` and error alike; of equals the first."""
    sign = -1 if cost == "shade_mtexels_per_s" else 1
    judgements = ((number, judged(row), row[cost]) for number, row in enumerate(rows))
    known = [(sign * much, error, number) for number, error, much in judgements if error is not None and much is not None]
    found, best = [], float("inf")
    for _, error, number in sorted(known):
        if error < best:
            best = error
            found.append(number)
    return found


def mark_fronts(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows, each saying in `front` in what it is on the Pareto front."""
    fronts = {name: front(rows, cost) for cost, name in _COSTS.items()}
    return [
        {**row, "front": ", ".join(name for name, members in fronts.items() if number in members)}
        for number, row in enumerate(rows)
    ]
