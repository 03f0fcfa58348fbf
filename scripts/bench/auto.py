"""The benchmark suite of the automatic choice: what it picks, what that costs, and what an exhaustive search picks."""

from __future__ import annotations

import itertools
import math
import statistics
import time
from typing import Any

import torch
from measure import SHARED
from reliefs import _load

import torchmat as tm
from torchmat.btf.btf import Btf
from torchmat.fitting import FitResult
from torchmat.fitting.choice.candidate import Option, fit_rung
from torchmat.fitting.choice.climb import Climb
from torchmat.fitting.choice.parts import PartsClimb
from torchmat.fitting.choice.shrink import Shrunk, shrink_steps, total_bytes
from torchmat.fitting.recipe import RECIPES
from torchmat.fitting.relief.recover import recover_relief
from torchmat.fitting.training import make_training
from torchmat.fitting.wanted import Target
from torchmat.models import Distribution, Material
from torchmat.models.storage import StoredAs

PSNR = 25.0
DATA = ("real wallpaper", "stones", "wallpaper", "disk")
# Searched exhaustively, and the parts of the distribution material whose every combination is fitted.
SEARCHED = {
    "real wallpaper": (), "stones": ("specular_mask", "normal"),
    "wallpaper": ("specular_mask", "fresnel", "rotation", "normal", "tilt"),
}
_QUICK = 0.5  # seconds: what takes less is timed five times
_WHOLE = 2  # combinations of parts that are fitted in full


def auto() -> list[dict[str, Any]]:
    """Choose at 25 dB on each data set, time that against the fit of what was picked, and search exhaustively.

    The fit of what was picked is that of the model with those parts and options, its geometry included, and the export
    at the sizes and depths picked. The exhaustive search fits all closed forms, flat and on the recovered relief, and
    the distribution material with every combination of the parts of SEARCHED, each as shortly as the choice does, on the
    geometry that the closed forms are truer on; the two combinations that then take the fewest bytes are fitted in full.
    Stores: of a closed form every combination of sizes and depths of its maps that takes fewer bytes than the smallest
    material so far is measured, in ascending order of bytes, until one meets the target; left out is what misses it with
    one map alone stored so, since no other map stored smaller as well makes that good. The stores of the distribution
    material, of which there may be hundreds of thousands, are chosen as the choice does.
    """
    rows = []
    for name in DATA:
        if not SHARED.exists():
            print(f"skipped: {name} is absent")
            continue
        btf = _load(name)
        row, result = _choice(name, btf)
        print(_line(row), flush=True)
        if name in SEARCHED:
            row |= _search(name, btf, result, row["bytes"])
            print({key: row[key] for key in ("exhaustive", "exhaustive bytes", "bytes / exhaustive", "search seconds")}, flush=True)
        rows.append(row)
    return rows


def _choice(name: str, btf: Btf) -> tuple[dict[str, Any], FitResult]:
    tiles = name != "disk"

    def choose() -> FitResult:
        return tm.fit(btf, "auto", psnr=PSNR, tiles=tiles, measure=False)

    result = choose()
    choice = result.report["figures"]["auto"]
    chosen = choice["chosen"]
    geometry = "recover" if chosen["relief"] else "flat"

    def fit_it() -> float:
        again = tm.fit(btf, chosen["model"], geometry=geometry, tiles=tiles, measure=False, **chosen["options"])
        start = time.perf_counter()
        _stored_like(again.material, result.material).as_exported()
        return again.report["fit_seconds"] + time.perf_counter() - start

    alone, seconds = fit_it(), result.report["fit_seconds"]
    if alone < _QUICK:  # after a first run, which warms up
        pairs = [(choose().report["fit_seconds"], fit_it()) for _ in range(5)]
        seconds, alone = (statistics.median(times) for times in zip(*pairs, strict=True))
    after = tm.evaluate(result.material.as_exported(), btf, result.split.held_out, perceptual=False).report
    return {
        "data": name, "wanted psnr_db": PSNR, "outcome": result.stop_reason, "picked": chosen["candidate"],
        "options": chosen["options"], "bytes": chosen["bytes"], "bytes_per_texel": chosen["bytes_per_texel"],
        "shared_bytes": chosen["shared_bytes"], "psnr_db": after["psnr_db"], "relative_error": after["relative_error"],
        "validation psnr_db": chosen["psnr_db"], "seconds": seconds, "seconds of it alone": alone,
        "ratio": seconds / alone, "maps": chosen["maps"],
    }, result


def _stored_like(material: Material, other: Material) -> Material:
    """Return a material with its maps in the sizes and depths of another."""
    stored = {name: one for name, one in other.stored.items() if name in material.maps}
    if "specular" in material.maps and "specular" in other.maps:
        stored["specular"] = StoredAs(tuple(other.maps["specular"].shape[-2:]))
    return material.stored_at(stored)


def _line(row: dict[str, Any]) -> str:
    return (
        f"{row['data']:15s} {row['picked']:55s} {row['bytes']:6.2f} B  {row['psnr_db']:.2f} dB held out  "
        f"{row['seconds']:.3f} s, alone {row['seconds of it alone']:.3f} s, ratio {row['ratio']:.2f}  ({row['outcome']})"
    )


class _Exhaustive(Climb):
    """A climb that leaves nothing out, of closed forms neither any combination of stores."""

    def _cannot_pay(self, rung: Any, height: Any = None) -> bool:
        return False

    def shrunk(self, option: Option) -> Option:
        if option.rung.model == Distribution.name:
            return super().shrunk(option)
        most = self.bytes_of(self.best) if self.met else math.inf
        fronts = shrink_steps(option.material, self.cost_of, self.limit, most)
        found = (self._stored(option.material, steps) for steps in itertools.product(*fronts) if fronts)
        for size, material in sorted(((total_bytes(one), one) for one in found), key=lambda one: one[0]):
            if size >= most:
                break
            cost = self.cost_of(material)
            if cost <= self.limit:
                return Option(
                    option.rung, option.fitted, material, cost, option.height, Shrunk(material, cost),
                    cost_in_full=option.cost_in_full,
                )
        return option

    @staticmethod
    def _stored(material: Material, steps: tuple[Any, ...]) -> Material:
        return material.stored_at({step.map: step.stored for step in steps if step.stored is not None})


def _search(name: str, btf: Btf, result: FitResult, found: float) -> dict[str, Any]:
    start = time.perf_counter()
    training = make_training(btf, tm.split_samples(btf).train, 0, name != "disk", torch.float32, False)
    with torch.no_grad():
        search = _Exhaustive(training, Target(psnr=PSNR))
        search.flat()
        height = (result.relief or recover_relief(search.part).relief).height
        if float(height.abs().max()) > 0:
            search.relief(height)
        if SEARCHED[name]:
            _search_parts(search, SEARCHED[name])
    best = search.best
    size = search.bytes_of(best)
    return {
        "exhaustive": best.name, "exhaustive bytes": size, "bytes / exhaustive": found / size,
        "candidates": len(search.options), "parts searched": SEARCHED[name], "search seconds": time.perf_counter() - start,
    }


def _search_parts(search: _Exhaustive, names: tuple[str, ...]) -> None:
    truest = min(search.options, key=lambda option: option.cost_in_full)
    recipe = RECIPES["distribution"]
    parts = [part for part in recipe.ladder.parts if part.name in names]
    climb = PartsClimb(search, recipe, truest.height)
    tried = {(): climb.best}
    for count in range(1, len(parts) + 1):
        for some in itertools.combinations(parts, count):
            tried[some] = climb.pilot(some, None, "")
    for some in sorted(tried, key=lambda some: search.rank(tried[some]))[:_WHOLE]:
        rung = climb.rung(some)
        search._consider(rung, fit_rung(search.part, rung, truest.height), search.watch.seconds, truest.height)
