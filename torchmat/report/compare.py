"""Several models on the same data and the same held-out directions: error beside bytes and seconds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchmat import atomic
from torchmat.btf import Btf
from torchmat.errors import FitError, RangeError, message
from torchmat.fit import fit
from torchmat.fit.config import parse_value
from torchmat.fit.registry import resolve_options
from torchmat.progress import progress as progress_bar
from torchmat.report.html import comparison_page
from torchmat.report.pictures import plotting, save_figure
from torchmat.report.tables import COMPARE_COLUMNS, to_json, write_csv

DEFAULT_MODELS = (
    "texture", "lambert", "lptm", "ptm", "hsh:terms=4", "hsh:terms=9", "hsh:terms=16", "phong_srf",
    "phong_srf:residual=half_light", "phong_srf:residual=quadratic", "phong_srf:base=ashikhmin_shirley",
    "pca:components=8", "pca:components=16", "local_pca", "sphere_images", "shading_map",
    "shading_map:brdf=ggx,azimuths=4",
)
_LEAST = 1e-9  # errors below are drawn there
_FILES = ("comparison.json", "comparison.csv", "comparison.html", "error_against_bytes.png", "error_against_seconds.png")


def parse_model(text: str) -> tuple[str, dict[str, Any]]:
    """Split ``hsh:terms=9,storage=png8`` into the model's name and its options, both checked."""
    name, _, rest = text.partition(":")
    options: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, separator, value = part.partition("=")
        if not separator:
            raise RangeError(message("compare", repr(text), "be NAME:KEY=VALUE,...", f"{part!r} has no '='"))
        options[key.strip()] = parse_value(value)
    return name, resolve_options(name, options) and options


def compare(
    btf: Btf, models: Sequence[str] = DEFAULT_MODELS, *, holdout: float = 0.2, holdout_by: str = "pair", seed: int = 0,
    progress: bool | None = None,
) -> list[dict[str, Any]]:
    """Fit each model on the same split; return a row each: error, bytes, seconds, shading rate, and the full report.

    A model is a name, or a name with options: ``"hsh:terms=9"``. A model that the data cannot determine gets a row
    whose figures are None and whose `failed` says why; nothing else is hidden.
    """
    parsed = [(text, *parse_model(text)) for text in models]
    rows = []
    for text, name, options in progress_bar(parsed, "comparing", total=len(parsed), show=progress):
        row: dict[str, Any] = dict.fromkeys(COMPARE_COLUMNS)
        row |= {"model": text, "failed": None}
        try:
            report = fit(btf, name, holdout=holdout, holdout_by=holdout_by, seed=seed, progress=False, **options).report
        except FitError as error:
            row["failed"] = str(error)
        else:
            row |= _row(report)
        rows.append(row)
    return rows


def _row(report: dict[str, Any]) -> dict[str, Any]:
    held_out, after = report["held_out"] or report["train"], report["held_out_after_export"] or {}
    kept = ("bytes_per_texel", "shared_bytes", "fit_seconds", "shade_mtexels_per_s")
    return {
        **{name: report[name] for name in kept}, "train_relative_error": report["train"]["relative_error"],
        "relative_error": held_out["relative_error"], "psnr_db": held_out["psnr_db"],
        "relative_error_after_export": after.get("relative_error"), "report": report,
    }


def _scatter(rows: list[dict[str, Any]], column: str, label: str, path: Path) -> Path:
    figure, axis = plotting().subplots(figsize=(7.5, 4.6))
    # A perfect fit stands at the foot of the logarithmic axis; black data has no relative error.
    known = [row for row in rows if row["relative_error"] is not None]
    done = [(row[column], max(row["relative_error"], _LEAST), row["model"]) for row in known]
    best = float("inf")
    for cost, error, model in sorted(done):
        front = error < best
        best = min(best, error)
        axis.plot(cost, error, "o", color="C1" if front else "C0", markersize=7 if front else 5)
        axis.annotate(model, (cost, error), fontsize=7, xytext=(4, 3), textcoords="offset points")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel(label)
    axis.set_ylabel("relative error, held out")
    axis.set_title("orange: nothing cheaper is better", fontsize=8)
    axis.grid(alpha=0.3, which="both")
    return save_figure(figure, path)


def check_target(target: str | Path) -> None:
    """Raise DataError unless `target` may be replaced: absent, empty, or an earlier comparison and nothing else."""
    atomic.refuse_foreign(Path(target), lambda name: name in _FILES, "an earlier comparison")


def write_comparison(rows: list[dict[str, Any]], folder: str | Path, title: str = "Comparison of models") -> Path:
    """Write rows as JSON, CSV and one HTML page with plots, whole or not at all; return the folder."""
    target = Path(folder)
    check_target(target)
    with atomic.building(target) as building:
        (building / "comparison.json").write_text(to_json(rows), encoding="utf-8")
        write_csv(rows, building / "comparison.csv")
        pictures = []
        if any(row["relative_error"] is not None for row in rows):
            pictures = [
                _scatter(rows, "bytes_per_texel", "bytes per texel", building / "error_against_bytes.png"),
                _scatter(rows, "fit_seconds", "fit seconds", building / "error_against_seconds.png"),
            ]
        cells = [[row[column] for column in COMPARE_COLUMNS] for row in rows]
        page = comparison_page(title, COMPARE_COLUMNS, cells, pictures)
        (building / "comparison.html").write_text(page, encoding="utf-8")
    return target
