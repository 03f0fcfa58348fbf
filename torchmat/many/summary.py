"""What became of many jobs: a table for the terminal, and JSON, CSV and a page as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torchmat import atomic
from torchmat.report.compare_page import table_page
from torchmat.report.tables import text_table, to_json, write_csv

SUMMARY_MEANINGS = {
    "data": "Where the images are.",
    "status": "Done; skipped, since the result was there already; or failed.",
    "model": "What was fitted.",
    "out": "The folder of the result.",
    "bytes_per_texel": "Bytes of the textures' codes per texel.",
    "shared_bytes": "Bytes of what all texels share.",
    "fit_seconds": "Seconds of the fit alone.",
    "seconds": "Seconds from reading to writing, on its worker.",
    "relative_error": "Relative error on held-out samples.",
    "psnr_db": "PSNR there, in dB.",
    "relative_error_after_export": "Relative error on held-out samples of what the textures hold.",
    "stop_reason": "Why the solver stopped.",
    "failed": "Why there is no result.",
}
SUMMARY_COLUMNS = tuple(SUMMARY_MEANINGS)
_ON_A_TERMINAL = ("data", "status", "model", "bytes_per_texel", "seconds", "relative_error", "psnr_db")
_FILES = ("summary.json", "summary.csv", "summary.html")


def check_target(target: str | Path) -> None:
    """Raise DataError unless `target` may be replaced: absent, empty, or an earlier summary and nothing else."""
    atomic.refuse_foreign(Path(target), lambda name: name in _FILES, "an earlier summary")


def summary_table(rows: list[dict[str, Any]]) -> str:
    """Return the rows as a table, with a line for each job that failed."""
    header = [name.replace("_", " ") for name in _ON_A_TERMINAL]
    table = text_table(header, [[row[name] for name in _ON_A_TERMINAL] for row in rows])
    failures = [f"{row['data']}: {row['failed']}" for row in rows if row["failed"]]
    counts = [f"{sum(row['status'] == status for row in rows)} {status}" for status in ("done", "skipped", "failed")]
    return "\n".join([table, "", ", ".join(counts), *failures])


def write_summary(rows: list[dict[str, Any]], folder: str | Path) -> Path:
    """Write the rows as JSON, CSV and one HTML page, whole or not at all; return the folder."""
    target = Path(folder)
    check_target(target)
    with atomic.building(target) as building:
        (building / "summary.json").write_text(to_json(rows), encoding="utf-8")
        write_csv(rows, building / "summary.csv", SUMMARY_COLUMNS)
        page = table_page("Many materials", SUMMARY_MEANINGS, rows)
        (building / "summary.html").write_text(page, encoding="utf-8")
    return target
