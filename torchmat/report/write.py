"""The output folder of a fit: the material with its report and pictures, whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torchmat.btf import Btf
from torchmat.fit import FitResult
from torchmat.material_io import save_material
from torchmat.report.html import fit_page
from torchmat.report.pictures import write_pictures
from torchmat.report.tables import to_json


def write_fit(btf: Btf, result: FitResult, folder: str | Path, pictures: bool = True) -> Path:
    """Write the material of `result`, `report.json`, and unless told not to, `pictures/` and `report.html`.

    Everything appears together in one step; see `save_material` for what may be replaced.
    """

    def companions(building: Path) -> None:
        (building / "report.json").write_text(to_json(result.report), encoding="utf-8")
        if pictures:
            written = write_pictures(btf, result, building / "pictures")
            (building / "report.html").write_text(fit_page(result.report, written), encoding="utf-8")

    return save_material(result.material, folder, _provenance(result.report), companions)


def _provenance(report: dict[str, Any]) -> dict[str, Any]:
    kept = ("options", "seed", "holdout", "holdout_by", "samples", "source", "versions")
    return {name: report[name] for name in kept}
