"""Thousands of fits and renders in one process: neither memory nor time may grow.

The engine runs in a process of its own, so that nothing else counts: ``python long_runs.py COUNT SEED``.
"""

from __future__ import annotations

import gc
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

ENTRY = Path(__file__)
_HANGS = 1200  # seconds
_PARTS = 10  # of a run; the first is for warming up
# Pages that the allocator keeps for the next time differ from run to run; a fit that kept its maps would grow by more.
MOST_GROWTH_MB = 16.0
MOST_SLOWDOWN = 1.5  # of the last fifth against the second: machines have other things to do as well


def run(count: int, seed: int = 0) -> list[dict]:
    """Return a row for each component: case, component, count, passed, figure (MB grown), note."""
    done = subprocess.run(
        [sys.executable, str(ENTRY), str(count), str(seed)], capture_output=True, text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"}, timeout=_HANGS,
    )
    if done.returncode:
        raise AssertionError(f"the engine of long runs failed:\n{done.stderr[-4000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def resident_mb() -> float:
    """Return the resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def repeated(component: str, work: Callable[[int], object], count: int) -> dict:
    """Do `work` over and over; compare memory and time early on with those at the end."""
    part = max(1, count // _PARTS)
    memory, seconds = [], []
    for number in range(_PARTS):
        took = []
        for step in range(part):
            start = time.process_time()
            work(number * part + step)
            took.append(time.process_time() - start)
        gc.collect()
        memory.append(resident_mb())
        seconds.append(statistics.median(took))
    grown, slower = memory[-1] - memory[1], statistics.median(seconds[-2:]) / max(statistics.median(seconds[1:3]), 1e-9)
    note = f"{1000 * seconds[-1]:.1f} ms each, {slower:.2f} times the beginning's; {memory[-1]:.0f} MB"
    passed = grown <= MOST_GROWTH_MB and slower <= MOST_SLOWDOWN
    return {"case": "long runs", "component": component, "count": part * _PARTS, "passed": passed, "figure": grown, "note": note}


def main() -> None:
    """The process of its own."""
    sys.path.insert(0, str(ENTRY.parents[2]))
    count, seed = int(sys.argv[1]), int(sys.argv[2])
    import numpy as np
    import torch
    from tests.support import all_pairs, hemisphere, plausible_images

    import torchmat as tm

    torch.set_num_threads(1)
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1), (40, 4))))
    btf = tm.Btf.from_tensors(plausible_images(light, view, 8, 8).astype(np.float32), light, view)
    models = ("texture", "lambert", "ptm", "hsh", "phong_srf", "pca", "shading_map")

    def fit_one(number: int) -> None:
        tm.fit(btf, models[number % len(models)], seed=seed + number, progress=False)

    materials = [tm.fit(btf, model, measure=False).material for model in models]

    def render_one(number: int) -> None:
        mesh = ("sphere", "patch", "torus")[number % 3]
        tm.render(materials[number % len(materials)], mesh, size=48, shadows=number % 2 == 0 and mesh != "patch", rays=1)

    print(json.dumps([repeated("fit", fit_one, count), repeated("render", render_one, count)]))


if __name__ == "__main__":
    main()
