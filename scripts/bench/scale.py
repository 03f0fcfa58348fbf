"""How time and memory grow with texels and with samples, for each model, and what two threads are worth: fresh processes, generated data.

``python scripts/bench/scale.py [texels] [samples] [large] [threads] [bonn] [--models ...] [--limit SECONDS]``. Exponents are those of
processor seconds, for others may use the machine; threads are worth what they are on a quiet machine, and beside as many other programs.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from generated import large_btf
from measure import RESULTS, save

from torchmat.cli.threads import SPINS

SIDES, FEW_SAMPLES = (64, 128, 256, 512, 1024, 2048), (9, 9)
LARGEST = {"local_pca": 256, "distribution": 1024}  # sides from which on a model is fitted by tiles (part "large")
SAMPLES, SMALL = ((9, 9), (21, 21), (49, 49), (81, 81), (200, 125)), 64
BONN = (256, 81, 81)
PARTS = ("texels", "samples", "large", "threads", "bonn")
# Iterative models with the effort that a user would spend on data of that size; the rest takes what it needs.
MODELS: dict[str, dict[str, Any]] = {
    "texture": {}, "lambert": {}, "ptm": {}, "hsh": {}, "phong_srf": {"residual": "half_light"}, "pca": {},
    "rbf": {}, "sphere_images": {}, "shading_map": {}, "local_pca": {},
    "distribution": {"geometry": "flat", "lobes": 1, "fresnel": False, "rotation": False, "effort": 0.05, "memory_mb": 3000},
}
THREADED = ("texture", "lambert", "ptm", "hsh", "phong_srf", "pca")
BONN_MODELS = {**MODELS, "lptm": {}, "neural": {"geometry": "flat", "seconds": 60}}
THREADS = ((1024, (9, 9)), (64, (200, 125)))  # what one thread and two are measured on
_OTHERS = 4  # programs that do nothing but count
# 1024 x 1024 within a bound, by tiles; the distribution has one already.
LARGE_MODELS = {name: {**MODELS[name], "memory_mb": 800} for name in ("ptm", "phong_srf", "pca", "shading_map")}
_HELD_OUT = 48  # samples that the error is measured on
_FIT = """
import json, sys
sys.path.insert(0, {here!r})
import torch
import torchmat as tm
from generated import open_large
import time
from torchmat.machine import peak_memory_mb
btf = open_large({folder!r}, {size})
# What the first fit of a process loads, whatever its size, is apart.
tm.fit(tm.load_btf(tm.sample_path()), {model!r}, measure=False, progress=False, **{options!r})
begin = time.process_time()
result = tm.fit(btf, {model!r}, measure=False, progress=False, **{options!r})
used, peak = time.process_time() - begin, peak_memory_mb()
rows = result.split.held_out[:: max(1, len(result.split.held_out) // {held_out})]
found = tm.evaluate(result.material, btf, rows, perceptual=False).report
print(json.dumps(dict(seconds=result.report["fit_seconds"], processor_seconds=used, peak_rss_mb=peak, stop_reason=result.stop_reason,
    relative_error=found["relative_error"], psnr_db=found["psnr_db"], tiles=result.report["figures"].get("tiles"))))
"""


def measured(
    folder: Path, part: str, size: int, samples: int, model: str, options: dict[str, Any], limit: float, threads: int = 1
) -> dict[str, Any]:
    """Fit once in a fresh process of so many threads and at most `limit` seconds; return the row."""
    code = _FIT.format(
        here=str(Path(__file__).parent), folder=str(folder), size=size, model=model, options=options, held_out=_HELD_OUT
    )
    row = {"part": part, "model": model, "options": options, "side": size, "texels": size * size, "samples": samples}
    try:
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads), "GOMP_SPINCOUNT": str(SPINS)}
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=limit, check=True)
        row |= json.loads(done.stdout.strip().splitlines()[-1])
    except subprocess.TimeoutExpired:
        row["failed"] = f"not done after {limit:g} s"
    except subprocess.CalledProcessError as error:
        row["failed"] = error.stderr.strip().splitlines()[-1]
    told = row.get("failed")
    if told is None:
        told = f"{row['seconds']:8.2f} s ({_used(row):8.2f})  {row['peak_rss_mb']:6.0f} MB  error {row['relative_error']:.4f}"
    print(f"{part:8s} {model:14s} {size:5d}^2 x {samples:6d}  {told}", flush=True)
    return row


def shared_out(folder: Path, side: int, samples: int, model: str, limit: float) -> dict[str, Any]:
    """Return seconds of one thread and of two, the least of three by turns, on a machine of its own and beside others."""
    row: dict[str, Any] = {"part": "threads", "model": model, "side": side, "texels": side * side, "samples": samples}
    for way, count in (("alone", 0), ("busy", _OTHERS)):
        others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
        try:
            runs = [
                {threads: measured(folder, f"{way} {threads}", side, samples, model, MODELS[model], limit, threads) for threads in (1, 2)}
                for _ in range(3)
            ]
        finally:
            for other in others:
                other.kill()
                other.wait()
        one, two = (min(run[threads].get("seconds", math.inf) for run in runs) for threads in (1, 2))
        row |= {f"{way}, one thread": one, f"{way}, two": two, f"{way}, gain": one / two}
    print(row, flush=True)
    return row


def exponents(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return, for each model, by which power time and memory grow with texels and with samples: least squares on logs.

    Also that of the three largest sizes: below, what every fit costs whatever its size hides how it grows.
    """
    found = []
    for part in ("texels", "samples"):
        for model in dict.fromkeys(row["model"] for row in rows if row["part"] == part):
            chosen = [row for row in rows if row["part"] == part and row["model"] == model and "failed" not in row]
            if len(chosen) < 3:
                continue
            size = [row[part] for row in chosen]
            row = {"part": f"exponent of {part}", "model": model, "time": _slope(size, [_used(r) for r in chosen])}
            row["time_of_the_three_largest"] = _slope(size[-3:], [_used(r) for r in chosen[-3:]])
            row["memory"] = _slope(size, [r["peak_rss_mb"] for r in chosen])
            found.append(row)
            largest = row["time_of_the_three_largest"]
            told = f"time {row['time']:.2f} ({largest:.2f} of the three largest)  memory {row['memory']:.2f}"
            print(f"{row['part']:20s} {model:14s} {told}", flush=True)
    return found


def _used(row: dict[str, Any]) -> float:
    return row.get("processor_seconds", row["seconds"])  # of rows from before the processor's were counted


def _slope(size: list[float], cost: list[float]) -> float:
    return float(np.polyfit(np.log(size), np.log(np.maximum(cost, 1e-6)), 1)[0])


def scale(
    parts: tuple[str, ...] = PARTS, models: tuple[str, ...] | None = None, limit: float = 1500
) -> list[dict[str, Any]]:
    """Measure the parts asked for; rows are saved as they come, those of other parts and models are kept."""
    def asked(row: dict[str, Any]) -> bool:
        return row["part"] in parts and (models is None or row["model"] in models)

    rows = [row for row in _known() if not asked(row) and not row["part"].startswith("exponent")]

    def run(part: str, side: int, lights: int, views: int, chosen: dict[str, dict[str, Any]]) -> None:
        with large_btf(side, lights, views) as folder:
            for model, options in chosen.items():
                if models is None or model in models:
                    rows.append(measured(folder, part, side, lights * views, model, options, limit))
                    save("scale", rows)

    if "texels" in parts:
        for side in SIDES:
            run("texels", side, *FEW_SAMPLES, {n: MODELS[n] for n in MODELS if side <= LARGEST.get(n, SIDES[-1])})
    if "samples" in parts:
        for lights, views in SAMPLES:
            run("samples", SMALL, lights, views, MODELS)
    if "large" in parts:
        run("large", 1024, 21, 21, LARGE_MODELS)
    if "threads" in parts:
        for side, (lights, views) in THREADS:
            with large_btf(side, lights, views) as folder:
                for model in [name for name in THREADED if models is None or name in models]:
                    rows.append(shared_out(folder, side, lights * views, model, limit))
                    save("scale", rows)
    if "bonn" in parts:
        run("bonn", *BONN, BONN_MODELS)
    rows += exponents(rows)
    _picture(rows, RESULTS / "scale.png")
    return rows


def _known() -> list[dict[str, Any]]:
    path = RESULTS / "scale.json"
    return json.loads(path.read_text(encoding="utf-8"))["rows"] if path.is_file() else []


def _picture(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw seconds and peak memory against texels and samples, all logarithmic."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 2, figsize=(11, 8), layout="constrained")
    for column, part in enumerate(("texels", "samples")):
        for line, (cost, unit) in enumerate((("seconds", "seconds"), ("peak_rss_mb", "peak memory, MB"))):
            axis = axes[line, column]
            for model in MODELS:
                chosen = [row for row in rows if row["part"] == part and row["model"] == model and "failed" not in row]
                if chosen:
                    axis.loglog([row[part] for row in chosen], [row[cost] for row in chosen], marker="o", label=model)
            axis.set(xlabel=part, ylabel=unit)
            axis.grid(True, which="major", alpha=0.4)
    axes[0, 0].legend(fontsize=8)
    samples, side = math.prod(FEW_SAMPLES), SMALL
    axes[0, 0].set_title(f"{samples} samples")
    axes[0, 1].set_title(f"{side} x {side} texels")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def main() -> None:
    """Measure the parts named on the command line, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="which parts (default: all)")
    parser.add_argument("--models", nargs="*", help="which models (default: all)")
    parser.add_argument("--limit", type=float, default=1500, help="seconds that one fit may take")
    given = parser.parse_args()
    save("scale", scale(tuple(given.parts) or PARTS, given.models and tuple(given.models), given.limit))


if __name__ == "__main__":
    main()
