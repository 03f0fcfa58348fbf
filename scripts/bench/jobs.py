"""Whole jobs in processor seconds of one thread: what a user starts, from the first import to the last file, and the parts of it.

``python scripts/bench/jobs.py [small middle large forms zip teapot texels help]`` measures all parts or those named, each job in a
process of its own, and stores ``results/jobs.json`` after each row. Processor time, for others may use the machine: of each job
the least of its runs. Beside every part stands what bounds it, measured in the same run: `import torch`, one pass that decodes the
images, one copy of the maps.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from generated import directions, large_btf
from measure import RESULTS, Used, save, used_by
from photographs import rti_set, write_codes

NAME = "jobs"
_RUNS = 3
_HERE = Path(__file__).parent
# What each piece of code says is its last line: numbers of processor seconds, by name.
_BEGIN = """
import json, sys, time
import torch, torchmat as tm
torch.set_num_threads(1)
def least(run, runs=5):
    run()
    found = []
    for _ in range(runs):
        begin = time.process_time(); run(); found.append(time.process_time() - begin)
    return min(found)
"""
_LARGE = """
sys.path.insert(0, {here!r})
from generated import open_large
btf = open_large({folder!r}, {size})
rows = torch.arange(len(btf))
def decode():
    for part in rows.split(max(1, 4_000_000 // (btf.height * btf.width))):
        btf.images(part)
found = {{"decode": least(decode, {runs})}}
for model, options in {models!r}:
    run = lambda: tm.fit(btf, model, holdout=0.0, measure=False, progress=False, **options)
    found[" ".join([model, *options.values()])] = least(run, {runs})
print(json.dumps(found))
"""
_API = """
begin = time.process_time()
result = tm.fit(tm.load_btf({data!r}, cache=False), "ptm", storage="png8", progress=False)
tm.save_material(result.material, {out!r})
print(json.dumps({{"after the imports": time.process_time() - begin}}))
"""
_UNZIP = """
import zipfile
begin = time.process_time()
archive = zipfile.ZipFile({data!r})
for name in archive.namelist():
    archive.read(name)
print(json.dumps({{"unzip": time.process_time() - begin}}))
"""
_ZIP = """
begin = time.process_time()
btf = tm.load_btf({data!r}, cache=False, progress=False)
print(json.dumps({{"load": time.process_time() - begin, "samples": len(btf)}}))
"""
_TEAPOT = """
from torchmat.rendering import Scene
texture = tm.fit(tm.load_btf(tm.sample_path()), "lambert", measure=False, progress=False).material
scene = Scene("teapot", [(0.4, 0.5, 0.77)], size=512)
scene.picture(texture)
print(json.dumps({{
    "one call": least(lambda: tm.render(texture, "teapot", [(0.4, 0.5, 0.77)], size=512)),
    "with shadows": least(lambda: tm.render(texture, "teapot", [(0.4, 0.5, 0.77)], size=512, shadows=True)),
    "scene kept": least(lambda: scene.picture(texture)),
}}))
"""
_TEXELS = """
from torchmat.models.edit import resized
btf, size = tm.load_btf(tm.sample_path()), 512
generator = torch.Generator().manual_seed(0)
def planes():
    polar, azimuth = 1.2 * torch.rand(size, size, generator=generator), 6.2832 * torch.rand(size, size, generator=generator)
    return torch.stack((polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()))
light, view, found = planes(), planes(), {{}}
for model in ("lambert", "ptm", "hsh", "phong_srf", "pca", "microfacet", "distribution"):
    slow = {{"geometry": "flat", "effort": 0.02}} if model in ("microfacet", "distribution") else {{}}
    material = resized(tm.fit(btf, model, measure=False, progress=False, **slow).material, (size, size))
    flat = torch.cat([part.detach().flatten() for part in material.maps.values()])
    with torch.no_grad():
        shading, copy = least(lambda: material.shade(light, view)), least(flat.clone)
    found[model] = {{"Mtexel/s": size * size / 1e6 / shading, "bound by a copy of the maps": size * size / 1e6 / copy}}
print(json.dumps(found))
"""


def _run(command: list[str]) -> Used:
    """Run a command on one thread, with what Python has compiled of it before."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return used_by(command, environment | {"OMP_NUM_THREADS": "1", "GOMP_SPINCOUNT": "1000"})


def least(command: Callable[[], list[str]], runs: int = _RUNS) -> dict[str, float]:
    """Return the least processor seconds of some runs of a command, made anew for each, and its memory."""
    found = [_run(command()) for _ in range(runs)]
    return {"processor_seconds": min(one.processor_seconds for one in found), "peak_rss_mb": min(one.peak_rss_mb for one in found)}


def _said(code: str, runs: int = 1) -> list[dict[str, Any]]:
    return [json.loads(_run([sys.executable, "-c", _BEGIN + code]).printed.splitlines()[-1]) for _ in range(runs)]


def _fit(folder: Path, *more: str, model: str = "ptm") -> list[str]:
    out = tempfile.mkdtemp(dir=folder.parent)
    return [sys.executable, "-m", "torchmat.cli", "fit", model, str(folder / "lights.lp"), "--no-cache", "--out", f"{out}/out", *more]


def small(place: Path) -> Iterator[dict[str, Any]]:
    """81 photographs of 256 x 256."""
    folder = rti_set(place / "small", 81, 256, 256)
    png = ("--set", "storage=png8")
    yield {"job": "import torch", **least(lambda: [sys.executable, "-c", "import torch"])}
    unmeasured = ("--no-pictures", "--measure", "none")
    for name, more in (("the command", ()), ("without pictures", ("--no-pictures",)), ("nor errors", unmeasured)):
        yield {"job": f"81 x 256 x 256, ptm, {name}", **least(lambda more=more: _fit(folder, *png, *more))}
    found = _said(_API.format(data=str(folder / "lights.lp"), out=str(place / "api")), 1)
    yield {"job": "81 x 256 x 256, ptm, in Python, after the imports", "processor_seconds": found[0]["after the imports"]}


def middle(place: Path) -> Iterator[dict[str, Any]]:
    """50 photographs of 2000 x 1500."""
    folder = rti_set(place / "middle", 50, 1500, 2000)
    for name, more in (("the command", ()), ("without pictures", ("--no-pictures",))):
        yield {"job": f"50 x 2000 x 1500, ptm, {name}", **least(lambda more=more: _fit(folder, *more), 1)}


def _generated(size: int, lights: int, views: int, models: list[tuple[str, dict[str, str]]], runs: int) -> Iterator[dict[str, Any]]:
    with large_btf(size, lights, views) as folder:
        code = _LARGE.format(here=str(_HERE), folder=str(folder), size=size, models=models, runs=runs)
        found = _said(code)[0]
    for name, seconds in found.items():
        job = f"{size} x {size} x {lights * views}, {name}"
        yield {"job": job, "processor_seconds": seconds, "of the decoding": seconds / found["decode"]}


def large(place: Path) -> Iterator[dict[str, Any]]:
    """1024 x 1024 texels of 441 images."""
    yield from _generated(1024, 21, 21, [("ptm", {}), ("hsh", {})], 1)


def forms(place: Path) -> Iterator[dict[str, Any]]:
    """64 x 64 texels of 2401 images."""
    models: list[tuple[str, dict[str, str]]] = [("texture", {}), ("ptm", {}), ("hsh", {}), ("phong_srf", {"residual": "half_light"})]
    yield from _generated(64, 49, 49, models, 5)


def zipped(place: Path) -> Iterator[dict[str, Any]]:
    """A zip of 6561 small JPEGs, and what unpacking and decoding alone take."""
    path, random = place / "many.zip", np.random.default_rng(0)
    light, view = directions(81), directions(81)
    with zipfile.ZipFile(path, "w") as archive:
        rows = ["file,light_x,light_y,light_z,view_x,view_y,view_z"]
        base = random.integers(0, 255, (64, 64, 3)).astype(np.uint8)
        for number, (seen, lit) in enumerate((seen, lit) for seen in view for lit in light):
            name = f"image_{number:04d}.jpg"
            file = place / name
            write_codes(file, (base * (0.5 + 0.5 * lit[2])).astype(np.uint8))
            archive.write(file, name)
            file.unlink()
            rows.append(",".join([name, *(f"{value:.6f}" for value in (*lit, *seen))]))
        archive.writestr("manifest.csv", "\n".join(rows) + "\n")
    seconds = _said(_UNZIP.format(data=str(path)))[0]["unzip"]
    found = _said(_ZIP.format(data=str(path)), _RUNS)
    yield {"job": "zip of 6561 JPEGs, unzip alone", "processor_seconds": seconds}
    yield {"job": "zip of 6561 JPEGs, first load", "processor_seconds": min(one["load"] for one in found)}


def teapot(place: Path) -> Iterator[dict[str, Any]]:
    """The teapot, 512 x 512 pixels, one light."""
    for name, seconds in _said(_TEAPOT.format())[0].items():
        yield {"job": f"teapot, 512 x 512, {name}", "processor_seconds": seconds}


def texels(place: Path) -> Iterator[dict[str, Any]]:
    """Shading with a light and a view of each texel's own."""
    for name, found in _said(_TEXELS.format())[0].items():
        yield {"job": f"light and view a texel, {name}", **found}


def helped(place: Path) -> Iterator[dict[str, Any]]:
    """What asks for nothing but words."""
    for name, command in (("python alone", ["-c", "pass"]), ("torchmat --help", ["-m", "torchmat.cli", "--help"])):
        found = least(lambda command=command: [sys.executable, *command])
        yield {"job": name, "processor_seconds": found["processor_seconds"]}  # its memory is that of the process that began it


PARTS = {
    "small": small, "middle": middle, "large": large, "forms": forms, "zip": zipped, "teapot": teapot, "texels": texels, "help": helped,
}


def jobs(parts: list[str]) -> list[dict[str, Any]]:
    """Measure the parts asked for; rows of others that stand in the file stay there."""
    path = RESULTS / f"{NAME}.json"
    rows: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.is_file() else []
    for part in parts:
        rows = [row for row in rows if row["part"] != part]
        with tempfile.TemporaryDirectory() as place:
            for row in PARTS[part](Path(place)):
                rows.append({"part": part, **row})
                print(json.dumps(rows[-1]), flush=True)
        save(NAME, rows)
    return rows


def main() -> None:
    """Measure the parts named on the command line, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="which parts (default: all)")
    jobs(parser.parse_args().parts or list(PARTS))


if __name__ == "__main__":
    main()
