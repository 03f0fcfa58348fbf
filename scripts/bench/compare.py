"""The benchmark suite of `torchmat compare`: every family beside a network, flat and on a relief, and solvers."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from measure import RESULTS, SHARED, save

import torchmat as tm
from torchmat.report.compare_plots import PLOTS, write_plots
from torchmat.report.compare_rows import mark_fronts
from torchmat.report.tables import COMPARE_COLUMNS, comparison_table

_QUICK = (
    "texture", "lambert", "ptm", "hsh:terms=9", "phong_srf", "phong_srf:residual=half_light",
    "phong_srf:residual=quadratic", "phong_srf:residual=half_light,storage=png8", "pca:components=8",
    "pca:components=16", "shading_map:brdf=ggx,azimuths=4",
)
_SLOW = ("distribution", "neural")
_ON_RELIEF = (*_SLOW, "distribution:geometry=recover", "neural:geometry=recover")
_SETS: dict[str, tuple[Path, tuple[str, ...]]] = {
    "leather": (SHARED / "reference" / "leather.zip", _ON_RELIEF),
    "stones": (SHARED / "reference" / "stones.zip", _ON_RELIEF),
    "real wallpaper": (SHARED / "real" / "ubo2003_wallpaper", _SLOW),
    "disk": (SHARED / "reference" / "disk.zip", _SLOW),
}
_REPEATS = 5
_BUDGET = 60.0  # seconds of one fit: longer than all defaults take, for the solvers that do not end by themselves
_PICTURES = {"leather": tuple(PLOTS), "stones": ("error_against_bytes",)}


def compare() -> list[dict[str, Any]]:
    """Error beside bytes, seconds, memory and throughput: what is quick five times, what is slow once."""
    found = []
    for data, (path, slow) in _SETS.items():
        if not path.exists():
            print(f"skipped: {path.name} is absent")
            continue
        btf = tm.load_btf(path)
        tm.compare(btf, ["texture"], progress=False)  # warms up
        rows = tm.compare(btf, _QUICK, repeats=_REPEATS) + tm.compare(btf, slow, budget=_BUDGET, geometry="flat")
        rows = mark_fronts(rows)
        print(f"\n{data}\n{comparison_table(rows)}", flush=True)
        _draw(rows, data)
        kept = (*COMPARE_COLUMNS, "curve", "repeats")
        size = {"data": data, "samples": len(btf), "texels": btf.height * btf.width}
        found += [size | {key: row.get(key) for key in kept} for row in rows]
        save("compare", found)  # what is interrupted has lost nothing
    return found


def _draw(rows: list[dict[str, Any]], data: str) -> None:
    RESULTS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for picture in write_plots(rows, Path(folder)):
            if picture.stem in _PICTURES.get(data, ()):
                name = f"compare_{data}_{picture.stem.removeprefix('error_against_')}.png"
                (RESULTS / name).write_bytes(picture.read_bytes())
