"""The benchmark suite of the compiled part: whole fits on either road, in processor time, and its loops one by one."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import torch
from reliefs import REFERENCES

from torchmat import fast as road
from torchmat.geometry.rays import clearance, look_up, texel_centres, trace_view
from torchmat.models import Distribution

# One fit in a process of its own. Processor time, for others may use the machine: it is what the fit takes, whoever waits.
_FIT = """
import json, sys, time
import torch, torchmat as tm
sys.path.insert(0, sys.argv[1])
from reliefs import _load
torch.set_num_threads(1)
btf = _load(sys.argv[2])
tm.fast.library()  # compiled once on a machine, or taken from the cache
begin = time.process_time()
report = tm.fit(btf, "distribution", geometry="recover", effort=float(sys.argv[3]), progress=False).report
found = report["held_out"]
print(json.dumps({"cpu seconds": time.process_time() - begin, "dB": found["psnr_db"], "error": found["relative_error"], "road": report["fast"]}))
"""
_ROADS = {"plain": "0", "compiled": "1"}


def fast(efforts: tuple[float, ...] = (0.3, 1.0), data: tuple[str, ...] = ("stones", "leather", "disk")) -> list[dict[str, Any]]:
    """Whole fits of the distribution material on a recovered relief by both roads, by turns; then the loops."""
    assert set(data) <= set(REFERENCES)
    rows = []
    for effort in efforts:
        for name in data:
            for way, asked in _ROADS.items():
                command = [sys.executable, "-c", _FIT, os.path.dirname(__file__), name, str(effort)]
                environment = {**os.environ, "TORCHMAT_FAST": asked, "OMP_NUM_THREADS": "1"}
                done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
                rows.append({"data": name, "effort": effort, "way": way, **json.loads(done.stdout.splitlines()[-1])})
                print(rows[-1], flush=True)
    return rows + loops()


def loops() -> list[dict[str, Any]]:
    """Milliseconds of processor time of each loop on one thread, by both roads: sizes are those of a fit of 64 x 64 texels."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    rows = []
    for name, work in _works().items():
        row: dict[str, Any] = {"loop": name}
        for way, asked in _ROADS.items():
            road.use(asked == "1")
            row[way] = _milliseconds(work)
        rows.append(row)
        print(row, flush=True)
    road.use(None)
    return rows


def _milliseconds(work: Callable[[], Any], runs: int = 7, seconds: float = 0.3) -> float:
    work()
    found = []
    for _ in range(runs):
        count, begin = 0, time.process_time()
        while count == 0 or time.process_time() - begin < seconds / runs:
            work()
            count += 1
        found.append((time.process_time() - begin) / count * 1e3)
    return statistics.median(found)


def _works() -> dict[str, Callable[[], Any]]:
    maps, places = torch.rand(12, 6, 64, 64), texel_centres(128, 128) + 0.02 * torch.randn(12, 2, 128, 128)
    leaf = maps.clone().requires_grad_()
    height = torch.nn.functional.interpolate(torch.rand(1, 1, 12, 12), size=(128, 128), mode="bicubic")[0] * 0.1
    toward = torch.randn(2, 16, 3, 1, 1)
    toward[:, :, 2] = toward[:, :, 2].abs() + 0.1
    light, view = toward / toward.norm(dim=2, keepdim=True)
    angle, normal = torch.rand(64, 64) * 6, torch.randn(3, 64, 64) * 0.3
    normal[2] = 1
    own = {
        "diffuse": torch.rand(3, 64, 64), "normal": normal / normal.norm(dim=0), "specular_mask": torch.rand(1, 64, 64), "fresnel": torch.rand(1, 64, 64),
        "rotation": torch.stack((angle.cos(), angle.sin())), "masking": torch.tensor([0.3, 0.2]), "specular": torch.rand(3, 48, 48),
    }
    parts = tuple(name for name in own if name not in ("diffuse", "specular"))
    material = Distribution(own, parts=parts, specular_spacing="dense")
    leaves = {name: value.clone().requires_grad_() for name, value in own.items()}

    def step() -> None:
        material.sharing(leaves).value(light[:12], view[:12]).sum().backward()

    return {
        "cubic look-up, 12 images of 6 channels at 128 x 128 places": lambda: look_up(maps, places, True, "bicubic"),
        "and its gradient in the maps": lambda: look_up(leaf, places, True, "bicubic").sum().backward(),
        "16 views met on a relief of 128 x 128": lambda: trace_view(height, view),
        "16 lights' shadow on it": lambda: clearance(height, light),
        "the distribution material's value of 12 images, and its gradient": step,
    }
