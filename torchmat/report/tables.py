"""Numbers as text: the table of a fit, rows of a comparison, JSON that other programs read."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchmat.fitting.evaluate import NotMeasured
from torchmat.report.words import COMPARED
from torchmat.solvers.stop_reasons import DIVERGED, NOT_FINITE

FIGURES = ("relative_error", "psnr_db", "psnr_log_db", "ssim", "delta_e", "mse")
INTERVAL = "relative_error_interval"
COMPARE_MEANINGS = {name: figure.meaning for name, figure in COMPARED.items()}
COMPARE_COLUMNS = tuple(COMPARE_MEANINGS)
_ON_A_TERMINAL = (
    "model", "total_bytes_per_texel", "fit_seconds", "fit_seconds_spread", "fit_memory_mb", "shade_mtexels_per_s",
    "train_relative_error", "relative_error", "relative_error_low", "psnr_db", "relative_error_after_export", "front",
)
_SHORT = {
    "total_bytes_per_texel": "bytes/texel", "fit_seconds": "fit (s)", "fit_seconds_spread": "spread",
    "fit_memory_mb": "MB", "shade_mtexels_per_s": "Mtexel/s", "train_relative_error": "seen",
    "relative_error": "unseen", "relative_error_low": "95 % interval", "psnr_db": "dB", "relative_error_after_export": "exported",
}


def _plain(value: Any) -> Any:
    """Return `value` with NaN and infinities as None, which is what JSON has for them, and what was not measured alike."""
    if isinstance(value, NotMeasured):
        return None
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def near_text(meaning: str, brought: str | None = None) -> str:
    """Return a line on near lights and cameras, and what was done for a model that has one direction an image."""
    return meaning if brought is None else f"{meaning}; {brought}"


def object_text(mask: str, share: float) -> str:
    """Return what an object mask says, in words."""
    return f"{100 * share:.1f} % of the texels, by {mask}; the others count nowhere"


def test_text(source: Mapping[str, Any]) -> str:
    """Return what test images are, in words."""
    known = source["pairs_in_data"]
    also = f"; the data has the pair of light and view of {known} of them too" if known else ""
    return f"{source['samples']} photographs from {source['path']}{also}"


def to_json(value: Any) -> str:
    """Return indented JSON; what is not finite becomes null."""
    return json.dumps(_plain(value), indent=1, ensure_ascii=False, allow_nan=False)


def number(value: Any) -> str:
    """Format one number for reading: four digits that matter, a dash for None."""
    if value is None:
        return "-"
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, int):
        return f"{value}"
    size = abs(value)
    return f"{value:.0f}" if size >= 1000 else f"{value:.4g}"


def text_table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return an aligned table in Markdown, which reads well on a terminal too."""
    cells = [[number(cell) for cell in row] for row in rows]
    widths = [max(len(line[column]) for line in [list(header), *cells]) for column in range(len(header))]
    lines = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |"
             for line in [list(header), *cells]]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines)


def interval_text(interval: Sequence[float] | None) -> str:
    """Return the two ends of an interval for reading, a dash for None."""
    return number(None) if interval is None else f"{number(interval[0])} to {number(interval[1])}"


_MEASURED = ("train", "held_out", "held_out_after_export", "test", "test_after_export")
_REFITTED = ("train_before", "train_after", "held_out_before", "held_out_after")


def error_rows(report: dict[str, Any], measured: Sequence[str] = _MEASURED) -> tuple[list[str], list[list[Any]]]:
    """Return header and rows of the figures, and of the error's interval, on what a report has `measured`: train ..."""
    columns = [name for name in measured if report.get(name)]
    rows = [[figure, *(report[name][figure] for name in columns)] for figure in FIGURES]
    rows.insert(1, [INTERVAL.replace("_", " "), *(interval_text(report[name].get(INTERVAL)) for name in columns)])
    return ["", *(name.replace("_", " ") for name in columns)], rows


def error_table(report: dict[str, Any]) -> str:
    """Return the six figures on train, held-out and held-out-after-export samples as a table."""
    return text_table(*error_rows(report))


def refit_table(report: dict[str, Any]) -> str:
    """Return the six figures before and after a refit, on train and held-out samples, as a table."""
    return text_table(*error_rows(report, _REFITTED))


def stopped_text(report: Mapping[str, Any]) -> str:
    """Return what is to be said of a fit that did not end as it should; empty where it did."""
    figures = report.get("figures") or {}
    choice, back = figures.get("auto"), (figures.get("geometry") or {}).get("fell_back")
    said = [f"{back}: the surface is flat"] if back else []
    reason = (choice.get("chosen") or {}).get("fit_stopped") if choice else report.get("stop_reason")
    if reason in (DIVERGED, NOT_FINITE):
        steps = figures.get("solver_steps", figures.get("steps"))
        ended = "diverged" if reason == DIVERGED else "met values that are not finite"
        after = "" if steps is None else f" after {steps} steps"
        best = "this is the best it had met before, not a finished one; a solver with a smaller rate may help"
        said.insert(0, f"the fit {ended}{after}: {best}")
    return "; ".join(said)


def summary_table(report: dict[str, Any]) -> str:
    """Return what a fit cost: bytes, seconds, memory."""
    rows = [
        ["model", report["model"]],
        ["options", ", ".join(f"{k}={v}" for k, v in report["options"].items())],
        ["samples x texels", f"{report['samples']} x {report['texels']}"],
        ["bytes per texel (+ shared)", f"{number(report['bytes_per_texel'])} (+ {report['shared_bytes']})"],
        ["load / fit seconds", f"{number(report['load_seconds'])} / {number(report['fit_seconds'])}"],
        ["shading, million texels/s", report["shade_mtexels_per_s"]],
        ["peak memory, MB", report["peak_rss_mb"]],
        ["stopped because", report["stop_reason"]],
    ]
    if report.get("lambert_residual"):
        rows.append(["Lambert residual", report["lambert_residual"]["meaning"]])
    return text_table(["", ""], rows + measured_rows(report))


def _ordinal(number_of: int) -> str:
    """Return 2nd, 3rd, 4th ..."""
    ends = {1: "st", 2: "nd", 3: "rd"}
    return f"{number_of}{'th' if number_of % 100 in (11, 12, 13) else ends.get(number_of % 10, 'th')}"


def measured_rows(report: dict[str, Any]) -> list[list[Any]]:
    """Return on how many images the figures of each part stand, and SSIM and delta E on how much of how many."""
    rows = []
    for name in ("train", "held_out", "test"):
        part = report.get(name) or {}
        if "perceptual_samples" in part:
            size, whole = part["perceptual_size"], [report["source"]["height"], report["source"]["width"]]
            where = "" if size == whole else f", the middle {size[0]} x {size[1]} texels"
            lines = f", every {_ordinal(part['every'])} row and column" if "every" in part else ""
            what = f"{part['samples']} images{lines}; SSIM and delta E: {part['perceptual_samples']}{where}"
            rows.append([f"measured on, {name.replace('_', ' ')}", what])
    return rows


def scene_rows(report: dict[str, Any]) -> list[list[Any]]:
    """Return what a fit for a scene saves, and how true it is inside and outside."""
    scene = report["scene"]
    samples = f"{scene['samples']} ({number(scene['samples_share'])} of all)"
    size = f"{samples} x {scene['texels']} ({number(scene['texels_share'])})"
    rows = [
        ["samples x texels fitted", size],
        ["bytes, of the whole texture", f"{scene['bytes']}, {scene['whole_bytes']}"],
        ["use beyond the measured directions", scene["outside_measured_share"]],
    ]
    errors = {
        "inside_points": "relative error at the scene's points", "inside_held_out": "on held-out samples, as used",
        "outside_held_out": "on held-out samples, unused",
    }
    return rows + [[text, scene[name]] for name, text in errors.items() if name in scene]


def scene_table(report: dict[str, Any]) -> str:
    """Return what a fit for a scene saves, and how true it is inside and outside, as a table."""
    return text_table(["the scene", ""], scene_rows(report))


def fit_tables(report: dict[str, Any]) -> str:
    """Return what a fit says on a terminal: its cost, its errors, and for a scene what that saves."""
    tables = [summary_table(report), error_table(report)]
    return "\n\n".join([*tables, scene_table(report)] if "scene" in report else tables)


def comparison_table(rows: list[dict[str, Any]]) -> str:
    """Return the rows of a comparison as a table, the columns that fit on a terminal."""
    header = [_SHORT.get(column, column) for column in _ON_A_TERMINAL]
    return text_table(header, [[_on_a_terminal(row, column) for column in _ON_A_TERMINAL] for row in rows])


def _on_a_terminal(row: Mapping[str, Any], column: str) -> Any:
    if column != "relative_error_low":
        return row[column]
    low, high = (row.get(name) for name in ("relative_error_low", "relative_error_high"))  # earlier results have none
    return interval_text(None if low is None or high is None else (low, high))


def write_csv(rows: list[dict[str, Any]], path: Path, columns: Sequence[str] = COMPARE_COLUMNS) -> None:
    """Write some columns of rows as CSV, by default those of a comparison."""
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, columns, extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    path.write_text(stream.getvalue(), encoding="utf-8", newline="")
