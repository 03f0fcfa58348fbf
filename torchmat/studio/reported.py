"""The report of the fit of a material, if there is one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torchmat.studio.textures import table_in

REPORT = "report.json"


def report_in(folder: Path) -> dict[str, Any]:
    """Return what a material's folder says of its fit; an empty table where there is no report, or a damaged one."""
    return table_in(folder / REPORT)
