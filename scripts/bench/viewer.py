"""The benchmark of the viewer: how large a page is, when its first picture stands, what its own work costs a frame, and how near it is.

``python scripts/bench/viewer.py [FOLDER ...]`` measures materials fitted to the embedded sample, one made of a picture, and material
folders that are given, in Chromium without a graphics card (SwiftShader), and writes ``results/viewer.json``.
"""

from __future__ import annotations

import argparse
import math
import re
import shutil
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from measure import save

import torchmat as tm
from torchmat import colour
from torchmat.create import material_from_picture
from torchmat.models import Material
from torchmat.models.edit import resized

NAME, FITTED = "viewer", ("texture", "ptm", "phong_srf", "shading_map")
FRAMES, SIZE = 60, 160
_ARGUMENTS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
_VIEWER = "document.getElementById('torchmat-viewer')?.viewer"
# Everything sweeps, so that every panel follows; the processor of the pictures is the same as that of the page here.
_MEASURE = """(count) => new Promise((done) => {
  const viewer = VIEWER, costs = [];
  viewer.change((state) => { state.sweeps = ["view.theta", "view.phi", "light.theta", "light.phi"]; });
  const stop = viewer.on("frame", (cost) => {
    costs.push(cost);
    if (costs.length === count) { stop(); viewer.reset(); done(costs); }
  });
})""".replace("VIEWER", _VIEWER)
_PICTURE = "(size) => { const viewer = VIEWER; return [...viewer.scene.picture({ ...viewer.picture(), background: [0, 0, 0] }, size, size)]; }"


def materials(folders: Sequence[str]) -> Iterator[tuple[str, Material]]:
    """Return what is measured, and what it is called."""
    btf = tm.load_btf(tm.sample_path())
    for name in FITTED:
        yield name, tm.fit(btf, name, measure=False, progress=False).material
    picture = tm.fit(btf, "texture", measure=False, progress=False).material.maps["albedo"].detach()
    made = material_from_picture(picture)
    yield "distribution on a relief, of a picture", made
    yield "the same, 512 x 512", resized(made, (512, 512))
    for folder in folders:
        material = tm.load_material(folder)
        yield f"{material.name}{' on a recovered relief' if material.has_relief else ''}", material


def measured(browser: Any, name: str, material: Material, folder: Path) -> dict[str, Any]:
    """Return one row: bytes, seconds, milliseconds, and the share of pixels that differ from `tm.render`."""
    path = folder / "page.html"
    started = time.perf_counter()
    tm.export(material, path, "html", force=True)
    seconds = time.perf_counter() - started
    page = browser.new_page(viewport={"width": 800, "height": 480}, reduced_motion="reduce")
    page.goto(path.as_uri())
    page.wait_for_function(f"{_VIEWER}?.frames > 0")
    first = page.evaluate("performance.now()")
    page.wait_for_function(f"!{_VIEWER}.pace.moving && !{_VIEWER}.wanted")
    costs = page.evaluate(_MEASURE, FRAMES)
    page.wait_for_function(f"!{_VIEWER}.pace.moving && !{_VIEWER}.wanted")
    found = torch.tensor(page.evaluate(_PICTURE.replace("VIEWER", _VIEWER), SIZE)).reshape(SIZE, SIZE, 4)[..., :3]
    theta, phi = (math.radians(page.evaluate(f"{_VIEWER}.state.lights[0].{angle}")) for angle in ("theta", "phi"))
    page.close()
    light = (math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))
    expected = tm.render(material.as_exported(), "teapot", [light], (0.7, 0.5, 1.0), SIZE, rays=1)
    off = (found - (colour.display(expected) * 255).round().permute(1, 2, 0)).abs().amax(dim=2)
    text = path.read_text(encoding="utf-8")
    held = len(re.sub(r'"data": "[^"]*"', "", text).encode())
    return {
        "material": name, "texels": material.texels, "page_bytes": path.stat().st_size, "bytes_without_textures": held, "write_seconds": seconds,
        "first_picture_ms": first, "frame_ms": statistics.median(costs), "frame_ms_95": sorted(costs)[int(0.95 * len(costs))],
        "pixels_off": float((off > 2).float().mean()),
    }


def main() -> None:
    """Measure what is asked for, and save it."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(_ARGUMENTS))
        for name, material in materials(given.folders):
            rows.append(measured(browser, name, material, Path(folder)))
            print(rows[-1], flush=True)
        browser.close()
    save(NAME, rows)


if __name__ == "__main__":
    main()
