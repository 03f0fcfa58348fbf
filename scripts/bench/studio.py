"""The benchmark suite of the studio: from a save to a changed pixel, many saves, the first picture, and hostile input.

``python scripts/bench/studio.py`` measures in Chromium without a window, whose pictures SwiftShader draws on the CPU, and
writes `results/studio.json`. ``--only saves many first hostile`` chooses, ``--side`` is the material's side in texels.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import machine

import torchmat as tm
from torchmat.create import material_from_picture
from torchmat.images import read_image, write_image

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
RESULTS = Path(__file__).parent / "results" / "studio.json"
# Of each frame that is drawn the middle pixel, read back before anything else happens, and when that was.
WATCH = """() => {
  const { viewer } = window.torchmat;
  const { gl } = viewer.context;
  window.seen = [];
  const pixel = new Uint8Array(4);
  viewer.on("frame", () => {
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(gl.drawingBufferWidth >> 1, gl.drawingBufferHeight >> 1, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    const last = window.seen.at(-1);
    if (!last || last.pixel.some((one, k) => Math.abs(one - pixel[k]) > 8)) {
      window.seen.push({ pixel: [...pixel], at: performance.timeOrigin + performance.now() });
    }
  });
}"""


def material(folder: Path, side: int, seed: int = 0) -> Path:
    """Write a material of `side` x `side` texels with all the maps of a picture, on a relief, and return its folder."""
    torch.manual_seed(seed)
    rough = torch.nn.functional.interpolate(torch.rand(1, 3, 16, 16), size=(side, side), mode="bicubic")[0].clamp(0, 1)
    picture = 0.1 + 0.6 * rough + 0.1 * torch.rand(3, side, side)
    made = material_from_picture(picture, lobes=2, specular=("glossy", "soft"), rotation_centres=[(0.5, 0.5)], tilt="default", tiles=True)
    return Path(tm.save_material(made, folder))


@contextmanager
def studio(folder: Path):
    """Yield the process of a studio, its address, and when the command began."""
    began = time.time()
    command = [sys.executable, "-m", "torchmat.cli", "studio", str(folder), "--no-browser"]
    with open(folder.parent / "log", "a", encoding="utf-8") as log, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True) as process:
        assert process.stdout is not None
        address = re.search(r"http://\S+", process.stdout.readline())
        assert address is not None
        try:
            yield process, address[0], began
        finally:
            process.send_signal(2)
            process.wait(10)


def saves(page: Any, folder: Path, way: str, count: int) -> list[float]:
    """Return the milliseconds from the end of each save of the diffuse map to the first picture with another pixel."""
    path, spare = folder / "diffuse.png", folder.parent / "spare.png"
    pixels, found = read_image(path), []
    for number in range(count):
        pixels = pixels.copy()
        pixels[:] = np.array([[255, 40, 40], [40, 40, 255]][number % 2], np.uint8)
        pixels[::2, ::3] //= 2
        write_image(spare, pixels)
        data, before = spare.read_bytes(), page.evaluate("window.seen.length")
        if way == "in place":
            with open(path, "wb") as stream:
                stream.write(data)
        else:
            partial = path.with_suffix(".part")
            partial.write_bytes(data)
            os.replace(partial, path)
        saved = 1000 * time.time()
        page.wait_for_function("n => window.seen.length > n", arg=before, timeout=20_000)
        found.append(page.evaluate("n => window.seen[n].at", before) - saved)
        print(f"{way} {found[-1]:.0f} ms", file=sys.stderr, flush=True)
        time.sleep(0.4)  # the full picture is drawn, and the state is kept
    return found


def memory_mb(process: subprocess.Popen) -> float:
    """Return what a process and those that it started hold in memory."""
    total = 0.0
    for one in [process.pid, *(int(child) for child in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split())]:
        total += int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{one}/status").read_text())[1]) / 1024
    return total


def many(page: Any, process: subprocess.Popen, folder: Path, count: int) -> dict[str, Any]:
    """Save `count` times, a tenth of them waited for, and return how delay and memory went."""
    path, spare = folder / "diffuse.png", folder.parent / "spare.png"
    pixels = read_image(path)
    versions = []
    for colour in ([255, 40, 40], [40, 40, 255]):
        pixels = pixels.copy()
        pixels[:] = np.array(colour, np.uint8)
        write_image(spare, pixels)
        versions.append(spare.read_bytes())
    rows = []
    for number in range(count):
        measured = number % 10 == 9
        if measured:
            time.sleep(0.4)
        before = page.evaluate("window.seen.length") if measured else 0
        path.write_bytes(versions[number % 2])
        saved = 1000 * time.time()
        if measured:
            page.wait_for_function("n => window.seen.length > n", arg=before, timeout=20_000)
            rows.append((page.evaluate("n => window.seen[n].at", before) - saved, memory_mb(process)))
            page.evaluate("window.seen.splice(0, window.seen.length - 1)")
        else:
            time.sleep(0.02)
    tenth = max(1, len(rows) // 10)
    delays, held = zip(*rows, strict=True)
    return {
        "saves": count, "first_ms": statistics.median(delays[:tenth]), "last_ms": statistics.median(delays[-tenth:]),
        "first_mb": statistics.median(held[:tenth]), "last_mb": statistics.median(held[-tenth:]),
        "states": len(json.loads((folder.parent / f".{folder.name}.studio" / "history.json").read_text())["states"]),
    }


def first(browser: Any, folder: Path) -> float:
    """Return the seconds from the command to the first picture, in a browser that is open and goes to the address."""
    page = browser.new_page(viewport={"width": 900, "height": 600})
    page.goto("about:blank")
    with studio(folder) as (_, address, began):
        page.goto(address, wait_until="commit", timeout=60_000)
        page.wait_for_function("window.torchmatDrawn", timeout=60_000)
        shown = page.evaluate("performance.timeOrigin + window.torchmatDrawn") / 1000
        kept = folder.parent / f".{folder.name}.studio" / "first_picture"
        until = time.monotonic() + 60
        while not kept.exists() and time.monotonic() < until:  # what the next start begins with
            time.sleep(0.1)
        time.sleep(1)
        page.close()
    print(f"first picture {shown - began:.2f} s", file=sys.stderr, flush=True)
    return shown - began


def spread(values: list[float]) -> dict[str, Any]:
    """Return median, least and largest of some figures."""
    return {"median": statistics.median(values), "least": min(values), "most": max(values), "count": len(values)}


def main() -> None:
    """Measure what was asked for and write it beside what stands there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", default=["first", "saves", "many", "hostile"])
    parser.add_argument("--side", type=int, default=512)
    parser.add_argument("--saves", type=int, default=50)
    parser.add_argument("--many", type=int, default=2000)
    parser.add_argument("--hostile", type=int, default=5000)
    given = parser.parse_args()
    found = {name: value for name, value in (json.loads(RESULTS.read_text()) if RESULTS.exists() else {}).items() if "picture" not in name}
    found |= {"machine": machine(), "side": given.side}
    from playwright.sync_api import sync_playwright
    from tests.web.browser import _ARGUMENTS, _executable

    random.seed(0)
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_executable(), args=list(_ARGUMENTS))
        folder = material(Path(place) / "wool", given.side)
        if "first" in given.only:
            os.environ["TORCHMAT_CACHE"] = str(Path(place) / "cache")
            found["first_picture_never_seen_s"] = first(browser, folder)
            found["first_picture_again_s"] = spread([first(browser, folder) for _ in range(5)])
            others = [material(Path(place) / f"other{number}", given.side, number + 1) for number in range(5)]
            found["first_picture_of_a_form_seen_s"] = spread([first(browser, other) for other in others])
        if {"saves", "many"} & set(given.only):
            with studio(folder) as (process, address, _):
                page = browser.new_page(viewport={"width": 900, "height": 600})
                page.goto(address)
                page.wait_for_function("window.torchmat && window.torchmat.viewer.frames > 0", timeout=60_000)
                page.evaluate("window.torchmat.viewer.setMesh('quad')")
                page.evaluate(WATCH)
                time.sleep(5)
                saves(page, folder, "in place", 1)  # torch is loaded, and the folder is followed
                if "saves" in given.only:
                    for way in ("in place", "by rename"):
                        found[f"save_ms {way}"] = spread(saves(page, folder, way, given.saves))
                if "many" in given.only:
                    found["many"] = many(page, process, folder, given.many)
        if "hostile" in given.only:
            from tests.studio.hostile import attack

            with studio(folder) as (process, address, _):
                found["hostile"] = attack(address, folder, given.hostile)
                found["hostile"]["log_lines"] = len((folder.parent / "log").read_text().splitlines())
                found["hostile"]["alive"] = process.poll() is None
        browser.close()
    RESULTS.write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
