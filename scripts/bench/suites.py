"""The benchmark suites: each returns rows that hold time beside error."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

import auto
import brdfs
import busy
import compare
import compiled
import exports
import fast
import finish
import meshes
import objects
import protocol
import reliefs
import scale
import scene
import shading_maps
import signs
import solvers
import spheres
import torch
import wishes
from generated import large_btf
from measure import SHARED, in_fresh_process, median_of, timed

import torchmat as tm
from torchmat.btf import Btf
from torchmat.fitting.recipe import RECIPES
from torchmat.fitting.recipes import resolve_options
from torchmat.fitting.training import make_training
from torchmat.report.comparison import closed_forms, parse_model

_WALLPAPER = SHARED / "real" / "ubo2003_wallpaper"
_SEEDS = range(5)


def _fit_only(btf: Btf, model: str, options: dict[str, Any]) -> dict[str, float]:
    """Time the fit alone: no evaluation, the images already loaded."""
    split = tm.split_samples(btf)
    chosen = resolve_options(model, options)

    def run() -> None:
        with torch.no_grad():
            RECIPES[model].run(make_training(btf, split.train, 0, True, torch.float32, False), **chosen)

    return timed(run)


def _row(name: str, btf: Btf, text: str, seeds: range) -> dict[str, Any]:
    model, options = parse_model(text)
    reports = [tm.fit(btf, model, seed=seed, **options).report for seed in seeds]
    figures = {
        f"{part}_{figure}": statistics.mean(report[part][figure] for report in reports)
        for part in ("train", "held_out", "held_out_after_export") for figure in ("relative_error", "psnr_db")
    }
    kept = ("samples", "texels", "bytes_per_texel", "shared_bytes", "stop_reason", "peak_rss_mb")
    errors = [report["held_out"]["relative_error"] for report in reports]
    return {
        "data": name, "model": text, **{key: reports[-1][key] for key in kept}, "fit": _fit_only(btf, model, options),
        "seeds": len(seeds), **figures, "held_out_relative_error_spread": max(errors) - min(errors),
    }


def accuracy() -> list[dict[str, Any]]:
    """Every model on each data set: error on unseen pairs beside bytes and seconds. Means over five splits on real data."""
    rows = []
    sets = {"sample": (tm.sample_path(), range(3)), "real wallpaper": (_WALLPAPER, _SEEDS)}
    sets |= {name: (SHARED / "reference" / f"{name}.zip", range(1)) for name in ("leather", "wallpaper", "stones", "disk")}
    sets["weave (8-bit)"] = (SHARED / "reference" / "weave_ubo2003.zip", range(1))
    sets["lion's head (RTI)"] = (SHARED / "real" / "loewenkopf_rti", range(3))
    for name, (path, seeds) in sets.items():
        if not path.exists():
            print(f"skipped: {path.name} is absent")
            continue
        btf = tm.load_btf(path)
        extra = [f"{model}{',' if ':' in model else ':'}storage=png8" for model in ("ptm", "phong_srf:residual=half_light")]
        for text in (*closed_forms(), *extra):
            rows.append(_row(name, btf, text, seeds))
            row = rows[-1]
            print(f"{name:18s} {text:42s} {row['bytes_per_texel']:5.0f} B  {row['fit']['seconds']:7.4f} s  "
                  f"{row['held_out_relative_error']:.4f}  {row['held_out_psnr_db']:.2f} dB", flush=True)
    return rows


_PIPELINE = """
import json, sys, tempfile, time
import torchmat as tm
start = time.perf_counter()
btf = tm.load_btf({path!r}, cache={cache!r})
loaded = time.perf_counter()
result = tm.fit(btf, {model!r}, holdout=0, measure=False, storage="png8")
fitted = time.perf_counter()
with tempfile.TemporaryDirectory() as folder:
    tm.save_material(result.material, folder + "/material")
    done = time.perf_counter()
print(json.dumps(dict(load=loaded - start, fit=fitted - loaded, write=done - fitted, whole=done - start)))
"""


def pipeline() -> list[dict[str, Any]]:
    """Read 81 photographs, fit, write 8-bit textures, each time in a fresh process and without the cache."""
    rows = []
    for model in ("ptm", "phong_srf"):
        runs = in_fresh_process(_PIPELINE.format(path=str(_WALLPAPER), cache=False, model=model), 7)
        row = {"data": "real wallpaper", "what": f"read, fit {model}, write", **{k: median_of(runs, k) for k in runs[0]}}
        rows.append(row)
        print(row["what"], {k: round(row[k]["seconds"], 3) for k in runs[0]}, flush=True)
    return rows


_START = """
import json, subprocess, sys, time
def seconds(*command):
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start
print(json.dumps(dict(
    bare=seconds(sys.executable, "-c", "pass"),
    torch=seconds(sys.executable, "-c", "import torch"),
    command=seconds(sys.executable, "-m", "torchmat.cli", "info", "--no-plot", {path!r}),
)))
"""


def start_up() -> list[dict[str, Any]]:
    """What the command line adds to importing torch."""
    tm.load_btf(_WALLPAPER)
    runs = in_fresh_process(_START.format(path=str(_WALLPAPER)), 5)
    row = {"what": "torchmat info against import torch", **{k: median_of(runs, k) for k in runs[0]}}
    print({k: round(row[k]["seconds"], 3) for k in runs[0]}, flush=True)
    return [row]


_LOAD = """
import json, tempfile
import torchmat as tm
from torchmat.machine import peak_memory_mb
with tempfile.TemporaryDirectory() as cache:
    first = tm.load_btf({path!r}, cache=cache).source.load_seconds
    again = tm.load_btf({path!r}, cache=cache).source.load_seconds
print(json.dumps(dict(first=first, again=again, peak_rss_mb=peak_memory_mb())))
"""


def loading() -> list[dict[str, Any]]:
    """First load, and load from the cache."""
    rows = []
    for name in ("weave_ubo2003", "leather"):
        path = SHARED / "reference" / f"{name}.zip"
        runs = in_fresh_process(_LOAD.format(path=str(path)), 5)
        row = {"data": name, **{k: median_of(runs, k) for k in ("first", "again")}, "peak_rss_mb": runs[-1]["peak_rss_mb"]}
        rows.append(row)
        print(name, {k: round(row[k]["seconds"], 3) for k in ("first", "again")}, flush=True)
    return rows


def shading() -> list[dict[str, Any]]:
    """Pictures a second of 600 x 600 texels, one light and view; beside the error of rounding the maps to half."""
    rows = []
    generator = torch.Generator().manual_seed(0)
    light, view = torch.tensor([0.3, 0.2, 0.9327])[:, None, None], torch.tensor([-0.4, 0.1, 0.911])[:, None, None]
    for residual, terms in (("half", 3), ("half_light", 7), ("quadratic", 15)):
        maps = {
            "residual": 0.2 * torch.randn(3 * terms, 600, 600, generator=generator),
            "lobe": torch.tensor([0.3, 0.2, 0.1, 0.2, 0.2, 0.2, 3.0]),
        }
        material = tm.models.PhongSrf(maps, residual=residual)
        with torch.no_grad():
            speed = timed(lambda material=material: material.shade(light, view), 30)
            exact, rounded = material.shade(light, view), material.as_exported().shade(light, view)
        error = float((exact - rounded).square().sum() / exact.square().sum())
        row = {"model": f"phong_srf:residual={residual}", "size": 600, **speed, "pictures_per_second": 1 / speed["seconds"]}
        rows.append(row | {"relative_error_of_half_maps": error})
        print(row["model"], round(row["pictures_per_second"]), "pictures a second", flush=True)
    return rows


_LARGE = """
import json, sys, time
sys.path.insert(0, {here!r})
import torchmat as tm
from generated import open_large
from torchmat.machine import peak_memory_mb
btf = open_large({folder!r}, {size})
for block in btf.blocks(): pass
start = time.perf_counter()
for block in btf.blocks(): pass
read = time.perf_counter() - start
result = tm.fit(btf, "phong_srf", residual={residual!r}, measure=False)
held_out = tm.evaluate(result.material, btf, result.split.held_out[::20]).report["relative_error"]
print(json.dumps(dict(read=read, fit=result.report["fit_seconds"], relative_error=held_out,
    peak_rss_mb=peak_memory_mb())))
"""


def large() -> list[dict[str, Any]]:
    """phong_srf on a generated 256 x 256 BTF of 6561 images, against the time of reading the store once."""
    rows, size = [], 256
    with large_btf(size, 81, 81) as folder:
        for residual in ("half", "half_light"):
            code = _LARGE.format(here=str(Path(__file__).parent), folder=str(folder), size=size, residual=residual)
            runs = in_fresh_process(code, 5)
            row = {"model": f"phong_srf:residual={residual}", "samples": 6561, "texels": size * size}
            row |= {k: median_of(runs, k) for k in ("read", "fit")}
            row |= {"ratio": row["fit"]["seconds"] / row["read"]["seconds"], "peak_rss_mb": runs[-1]["peak_rss_mb"]}
            rows.append(row | {"held_out_relative_error": runs[-1]["relative_error"]})
            print(rows[-1], flush=True)
    return rows


SUITES = {
    "accuracy": accuracy, "pipeline": pipeline, "start_up": start_up, "loading": loading, "shading": shading, "large": large,
    "geometry": reliefs.geometry, "relief": reliefs.relief, "distribution": reliefs.distribution,
    "finish": finish.finish, "fast": fast.fast, "compiled": compiled.measure, "auto": auto.auto, "scale": scale.scale, "scene": scene.scene,
    "shading_maps": shading_maps.shading_maps,
    "objects": objects.objects, "meshes": meshes.meshes, "compare": compare.compare, "solvers": solvers.solvers,
    "protocol": protocol.protocol, "brdfs": brdfs.brdfs, "wishes": wishes.wishes, "busy": busy.busy, "signs": signs.signs, "exports": exports.exports,
    "sphere_images": spheres.sphere_images, "sphere_sizes": spheres.sphere_sizes, "sphere_shading": spheres.sphere_shading,
}
