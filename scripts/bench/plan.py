"""How many photographs a plan saves: simulated captures out of measured ones, by `tm.plan` and by even spreads.

A capture begins with five photographs spread evenly, goes on as the plan says or as an even spread of the whole has it, and is
measured on all photographs that it did not take. Each is repeated with the spread turned, and means stand in the table.

    python scripts/bench/plan.py [--only wallpaper ...]
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable
from typing import Any

import torch
from measure import SHARED, save
from torch import Tensor

import torchmat as tm
from torchmat.frames import spiral

START = 5
TURNS = (0.0, 1.0, 2.0, 3.0)  # radians by which the even spreads are turned
DATA: dict[str, Callable[[], tm.Btf]] = {
    "wallpaper": lambda: tm.load_btf(SHARED / "real" / "ubo2003_wallpaper", downscale=8, progress=False),
    "lion's head": lambda: tm.load_btf(SHARED / "real" / "loewenkopf_rti", downscale=4, progress=False),
    "leather": lambda: along_the_normal(tm.load_btf(SHARED / "reference" / "leather.zip", downscale=2, progress=False)),
    "disk": lambda: along_the_normal(tm.load_btf(SHARED / "reference" / "disk.zip", downscale=2, progress=False)),
}
MODELS = {"hsh": (10, 12, 15, 18, 22, 27, 33, 40), "ptm": (7, 9, 12, 15, 18, 22, 27, 33)}


def along_the_normal(btf: tm.Btf) -> tm.Btf:
    """Return the photographs from straight above: a capture under one view."""
    return btf.picked(btf.view_index == int(btf.views[:, 2].argmax()))


def nearest(btf: tm.Btf, wanted: Tensor) -> list[int]:
    """Return photographs whose lights are nearest to those wanted, none twice."""
    found: list[int] = []
    for direction in wanted:
        far = (btf.light.double() - direction).norm(dim=1)
        far[found] = torch.inf
        found.append(int(far.argmin()))
    return found


def even(btf: tm.Btf, count: int, turn: float) -> list[int]:
    """Return photographs that are spread evenly: nearest to a spiral over the lights that were measured."""
    return nearest(btf, spiral(count, max(float(btf.lights[:, 2].min()), 0.0), turn))


def apart(btf: tm.Btf, count: int, turn: float) -> list[int]:
    """Return the same five to begin with, and then always the photograph farthest from all that were taken."""
    taken = even(btf, START, turn)
    while len(taken) < count:
        taken.append(int(torch.cdist(btf.light.double(), btf.light[taken].double()).amin(dim=1).argmax()))
    return taken


def planned(btf: tm.Btf, count: int, turn: float, model: str) -> list[int]:
    """Return the same five to begin with, and then those that the plan names of the photographs that there are."""
    taken = even(btf, START, turn)
    rest = [number for number in range(len(btf)) if number not in taken]
    found = tm.plan(
        btf.picked(taken), model, count=count - START, candidates=(btf.light[rest], btf.view[rest]), tiles=False, progress=False,
    )
    return taken + nearest(btf, found.light)


def measured(btf: tm.Btf, taken: list[int], model: str) -> dict[str, float]:
    """Return the errors of a fit to some photographs on all others."""
    material = tm.fit(btf.picked(taken), model, holdout=0, measure="none", tiles=False, progress=False).material
    rest = torch.tensor([number for number in range(len(btf)) if number not in taken])
    report = tm.evaluate(material, btf, rest, perceptual=False).report
    return {"psnr_db": report["psnr_db"], "relative_error": report["relative_error"]}


def needed(curve: dict[int, float], wanted: float) -> float | None:
    """Return how many photographs a curve of dB needs for `wanted`, between its counts by straight lines; None if it never has them."""
    before: tuple[int, float] | None = None
    for count, value in curve.items():
        if value >= wanted:
            return float(count) if before is None else before[0] + (count - before[0]) * (wanted - before[1]) / (value - before[1])
        before = count, value
    return None


def run(name: str, model: str) -> list[dict[str, Any]]:
    """Return a row for each way and count of one capture and model."""
    btf = DATA[name]()
    counts = [count for count in MODELS[model] if count <= len(btf) * 2 // 3]
    ways = {"even": even, "farthest": apart, "plan": lambda *given: planned(*given, model)}
    rows = []
    for way, choose in ways.items():
        for count in counts:
            found = [measured(btf, choose(btf, count, turn), model) for turn in TURNS]
            means = {key: statistics.mean(one[key] for one in found) for key in found[0]}
            least, most = (pick(one["psnr_db"] for one in found) for pick in (min, max))
            rows.append({"data": name, "photographs": len(btf), "model": model, "way": way, "count": count, **means, "psnr_least": least, "psnr_most": most})
            print(rows[-1], flush=True)
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """Return a table: the photographs that each way needs for what an even spread of so many has."""
    lines = ["| capture | model | even spread | dB | farthest needs | plan needs | relative error, even | plan |", "|---|---|---|---|---|---|---|---|"]
    for name, model in dict.fromkeys((row["data"], row["model"]) for row in rows):
        some = [row for row in rows if (row["data"], row["model"]) == (name, model)]
        curves = {way: {row["count"]: row["psnr_db"] for row in some if row["way"] == way} for way in ("even", "farthest", "plan")}
        errors = {way: {row["count"]: row["relative_error"] for row in some if row["way"] == way} for way in curves}
        for count, wanted in curves["even"].items():
            told = [needed(curves[way], wanted) for way in ("farthest", "plan")]
            said = ["never" if one is None else f"{one:.1f}" for one in told]
            lines.append(f"| {name} | {model} | {count} | {wanted:.2f} | {said[0]} | {said[1]} | {errors['even'][count]:.4f} | {errors['plan'][count]:.4f} |")
    return "\n".join(lines)


def main() -> None:
    """Run all captures, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=list(DATA))
    chosen = parser.parse_args().only
    rows = [row for name in chosen for model in MODELS for row in run(name, model)]
    save("plan", rows)
    print(table(rows))


if __name__ == "__main__":
    main()
