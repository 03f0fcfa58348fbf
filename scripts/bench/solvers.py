"""The roads of each model to the same held-out error: seconds of every solver, against full-batch Adam at its best rate."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from measure import RESULTS, SHARED

import torchmat as tm
from torchmat.btf.btf import Btf
from torchmat.fitting.evaluate import evaluate
from torchmat.fitting.recipe import RECIPES
from torchmat.fitting.recipes import resolve_options
from torchmat.fitting.training import Fitted, Training, make_training
from torchmat.report.pictures import plotting, save_figure
from torchmat.solvers.clock import Watch

RATES = (0.003, 0.01, 0.03, 0.1, 0.3)
_LONGER = 12  # times the default's seconds: what takes longer has not reached the error
_TRIED = 3  # times the default's seconds that each rate of Adam is tried for; the best one then runs in full
_FEWEST_SECONDS = 0.5  # that a rival is given, and no less
_NEAR = 1.01  # of the default's error counts as the same
_SAMPLES = 480  # held-out ones that the error is measured on: of a few, chance decides whether they hold a highlight
_CASES = {
    "phong_srf": {}, "phong_srf:residual=half_light": {"residual": "half_light"}, "hsh": {}, "ptm": {}, "lptm": {}, "lambert": {},
    "texture": {}, "sphere_images": {},
    "distribution": {"lobes": 1, "fresnel": True, "rotation": True},
}
_DATA = ("leather", "wallpaper")
_DRAWN = (("leather", "phong_srf"), ("leather", "distribution"))
Run = Callable[[Training], Fitted]
Curve = list[tuple[float, float]]


def _curve(btf: Btf, run: Run, seconds: float = math.inf, dtype: torch.dtype = torch.float32) -> tuple[Curve, Fitted]:
    """Return (seconds, held-out error) as a fit went on, measured off its clock, and what it found."""
    split = tm.split_samples(btf)

    def measure(material: Any) -> float:
        return evaluate(material, btf, split.held_out, _SAMPLES, perceptual=False).report["relative_error"]

    watch = Watch(seconds, measure)
    training = make_training(btf, split.train, 0, True, dtype, False, watch)
    with torch.no_grad():
        watch.restart()
        fitted = run(training)
        watch.note(lambda: fitted.material)
    return watch.history, fitted


def seconds_to(curve: Curve, error: float) -> float | None:
    """Return the first second at which the curve is at most `error`; None if it never is."""
    return next((seconds for seconds, found in curve if found <= error), None)


def _own(model: str, options: dict[str, Any]) -> Run:
    return lambda training: RECIPES[model].run(training, **resolve_options(model, options))


def _adam(model: str, options: dict[str, Any], rate: float) -> Run:
    # As many steps as there is time for; a tolerance that nothing meets.
    solver = tm.Adam(steps=50_000, rate=rate) if model == "distribution" else tm.Adam(10**6, rate, tolerance=1e-30)
    return _own(model, {**options, "solver": solver})


def _row(data: str, model: str, solver: str, curve: Curve, target: float, own: float, **more: Any) -> dict[str, Any]:
    reached = seconds_to(curve, target)
    return {
        "data": data, "model": model, "solver": solver, "seconds to the same error": reached,
        "times the default": None if reached is None else reached / own, "lowest error": min(error for _, error in curve),
        "seconds in all": curve[-1][0], **more,
    }


def _same_bits(btf: Btf, run: Run, found: Fitted) -> bool:
    again = _curve(btf, run)[1].material.maps
    return all(torch.equal(again[name], value) for name, value in found.material.maps.items())


def _case(data: str, btf: Btf, name: str, options: dict[str, Any]) -> tuple[list[dict[str, Any]], dict[str, Curve]]:
    """Return the rows of one model on one BTF, the default first, and the curves that they come from."""
    model = name.partition(":")[0]
    default = RECIPES[model].all_solvers[0]
    _curve(btf, _own(model, options))  # warms up
    curve, found = _curve(btf, _own(model, options))
    target = curve[-1][1] * _NEAR
    own = seconds_to(curve, target)
    curves, most = {default: curve}, max(_LONGER * own, _FEWEST_SECONDS)
    same = _same_bits(btf, _own(model, options), found)
    rows = [_row(data, name, default, curve, target, own, rate=None, same_bits=same)]
    double = _curve(btf, _own(model, options), dtype=torch.float64)[0]
    rows.append(_row(data, name, f"{default}, float64", double, target, own, rate=None, same_bits=None))
    for solver in RECIPES[model].all_solvers[1:]:
        if solver != "adam":
            curves[solver] = _curve(btf, _own(model, {**options, "solver": solver}), most)[0]
            rows.append(_row(data, name, solver, curves[solver], target, own, rate=None, same_bits=None))
    tried = max(_TRIED * own, _FEWEST_SECONDS)
    tuned = {rate: _curve(btf, _adam(model, options, rate), tried)[0] for rate in RATES}

    def standing(rate: float) -> tuple[float, float]:
        return seconds_to(tuned[rate], target) or math.inf, min(error for _, error in tuned[rate])

    best = min(RATES, key=standing)
    if math.isinf(standing(best)[0]) and most > tried:
        tuned[best] = _curve(btf, _adam(model, options, best), most)[0]
    curves["adam"] = tuned[best]
    rows.append(_row(data, name, "adam", tuned[best], target, own, rate=best, same_bits=None))
    return rows, curves


def solvers() -> list[dict[str, Any]]:
    """Every model by each of its solvers, in float32 and float64; pictures of error against seconds beside the results."""
    rows = []
    for data in _DATA:
        path = SHARED / "reference" / f"{data}.zip"
        if not path.exists():
            print(f"skipped: {path.name} is absent")
            continue
        btf = tm.load_btf(path)
        for name, options in _CASES.items():
            found, curves = _case(data, btf, name, options)
            rows += found
            if (data, name) in _DRAWN:
                _picture(f"solvers_{data}_{name}", f"{name} on {data}", curves)
            for row in found:
                print({key: value if not isinstance(value, float) else round(value, 4) for key, value in row.items()}, flush=True)
    return rows


def _picture(name: str, title: str, curves: dict[str, Curve]) -> None:
    figure, axis = plotting().subplots(figsize=(6.4, 4.2))
    for solver, curve in curves.items():
        axis.plot(*zip(*curve, strict=True), "o-", markersize=3, label=solver)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("seconds")
    axis.set_ylabel("relative error, held out")
    axis.set_title(title, fontsize=9)
    axis.grid(alpha=0.3, which="both")
    axis.legend(fontsize=8)
    RESULTS.mkdir(exist_ok=True)
    save_figure(figure, RESULTS / f"{name}.png")
