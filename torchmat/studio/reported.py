"""The report of the fit of a material, if there is one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

REPORT = "report.json"


def report_in(folder: Path) -> dict[str, Any]:
    """Return what a material's folder says of its fit; an empty table where there is no report, or a damaged one."""
    try:
        found = json.loads((folder / REPORT).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
