"""Numbers as text: the table of a fit, rows of a comparison, JSON that other programs read."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

FIGURES = ("relative_error", "psnr_db", "psnr_log_db", "ssim", "delta_e", "mse")
COMPARE_COLUMNS = (
    "model", "bytes_per_texel", "shared_bytes", "fit_seconds", "shade_mtexels_per_s", "train_relative_error",
    "relative_error", "psnr_db", "relative_error_after_export",
)


def _plain(value: Any) -> Any:
    """Return `value` with NaN and infinities as None, which is what JSON has for them."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


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


def error_rows(report: dict[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Return header and rows of the six figures on train, held-out and held-out-after-export samples."""
    columns = [name for name in ("train", "held_out", "held_out_after_export") if report.get(name)]
    rows = [[figure, *(report[name][figure] for name in columns)] for figure in FIGURES]
    return ["", *(name.replace("_", " ") for name in columns)], rows


def error_table(report: dict[str, Any]) -> str:
    """Return the six figures on train, held-out and held-out-after-export samples as a table."""
    return text_table(*error_rows(report))


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
    return text_table(["", ""], rows)


def comparison_table(rows: list[dict[str, Any]]) -> str:
    """Return the rows of a comparison as a table."""
    return text_table(COMPARE_COLUMNS, [[row[column] for column in COMPARE_COLUMNS] for row in rows])


def write_csv(rows: list[dict[str, Any]], path: Path) -> None:
    """Write the rows of a comparison as CSV."""
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, COMPARE_COLUMNS, extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    path.write_text(stream.getvalue(), encoding="utf-8", newline="")
