"""The errors of a report as a viewer shows them: the figures that say most, of the photographs that say most."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from torchmat.errors import RangeError, message
from torchmat.figures import FIGURES, PARTS

_KEYS = ("relative_error", "psnr_db", "ssim", "delta_e")
# Of each group the first that was measured: what textures hold before what the fit held in full.
_GROUPS = (("held_out_after_export", "held_out"), ("test_after_export", "test"), ("train",))


def error_table(report: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return caption, columns and rows of text from what `report.json` says; None where nothing was measured.

    Raises RangeError for what is no report.
    """
    if report is None:
        return None
    if not isinstance(report, Mapping):
        step = "Give what report.json holds, or result.report."
        raise RangeError(message("error_table", "report", "be a mapping", f"it is {type(report).__name__}", step))
    parts = [next((name for name in group if _figures(report, name)), None) for group in _GROUPS]
    measured = [name for name in parts if name is not None]
    rows = [[FIGURES[key].name, *(_number(_figures(report, part).get(key)) for part in measured)] for key in _KEYS]
    rows = [row for row in rows if any(cell != "-" for cell in row[1:])]
    if not rows:
        return None
    better = "Errors and colour differences: lower is better. PSNR and SSIM: higher is better."
    return {"caption": better, "columns": [PARTS[name] for name in measured], "rows": rows}


def _figures(report: Mapping[str, Any], part: str) -> Mapping[str, Any]:
    found = report.get(part)
    return found if isinstance(found, Mapping) else {}


def _number(value: Any) -> str:
    known = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return f"{value:.3g}" if known else "-"
