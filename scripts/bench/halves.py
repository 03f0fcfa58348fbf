"""Are standard errors as large as fits differ? Two fits to halves of the photographs of real captures and of reference sets.

The halves share no photograph. Where errors are right, the numbers of the two fits differ by less than the 68 and 95 %
interval of their difference in 68 and 95 % of the texels; a misfit that photographs share makes it fewer or more.

    python scripts/bench/halves.py
"""

from __future__ import annotations

from typing import Any

import torch
from measure import SHARED, save

import torchmat as tm

CASES = {
    "wallpaper (Bonn 2003), 81 lights": (lambda: tm.load_btf(SHARED / "real" / "ubo2003_wallpaper", downscale=8, progress=False), ("ptm", "hsh")),
    "lion's head, 240 lights": (lambda: tm.load_btf(SHARED / "real" / "loewenkopf_rti", downscale=4, progress=False), ("ptm", "hsh")),
    "leather, 2401 pairs": (lambda: tm.load_btf(SHARED / "reference" / "leather.zip", downscale=4, progress=False), ("phong_srf", "lambert")),
    "stones, 2401 pairs": (lambda: tm.load_btf(SHARED / "reference" / "stones.zip", downscale=4, progress=False), ("phong_srf", "lambert")),
}


def run(btf: tm.Btf, model: str) -> dict[str, Any]:
    """Return which share of the numbers differ by less than their intervals say."""
    order = torch.randperm(len(btf), generator=torch.Generator().manual_seed(0))
    fits = []
    for rows in order.chunk(2):
        half = btf.picked(rows.sort().values)
        result = tm.fit(half, model, holdout=0, measure="none", tiles=False, geometry="flat", uncertainty=True, progress=False)
        fits.append(result)
    inside = btf.inside
    found: dict[str, Any] = {}
    for level in (0.68, 0.95):
        for name in fits[0].uncertainty.error:
            one, other = (result.material.maps[name].detach().flatten(1)[:, inside] for result in fits)
            widths = [result.uncertainty.interval(level)[name].flatten(1)[:, inside] for result in fits]
            share = ((one - other).abs() <= (widths[0].square() + widths[1].square()).sqrt()).double().mean()
            found[f"{name} {level:g}"] = float(share)
    return found


def main() -> None:
    """Run all cases and print their rows."""
    rows = []
    for name, (load, models) in CASES.items():
        btf = load()
        for model in models:
            rows.append({"data": name, "model": model, **run(btf, model)})
            print(rows[-1], flush=True)
    save("halves", rows)


if __name__ == "__main__":
    main()
