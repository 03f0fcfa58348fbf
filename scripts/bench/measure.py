"""What the benchmarks share: repeated timing, the machine's description, results as JSON and as a table."""

from __future__ import annotations

import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import torch

RESULTS = Path(__file__).with_name("results")
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


def timed(run: Callable[[], Any], repeats: int = 5) -> dict[str, float]:
    """Return median and spread (largest minus smallest) of the seconds of `repeats` runs, after one that warms up."""
    run()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    return {"seconds": statistics.median(seconds), "spread": max(seconds) - min(seconds), "runs": repeats}


class Used(NamedTuple):
    """What a process took: seconds on the clock and of the processor, its memory at most in MB, and what it printed."""

    seconds: float
    processor_seconds: float
    peak_rss_mb: float
    printed: str


def used_by(command: list[str], environment: dict[str, str] | None = None) -> Used:
    """Run a command and return what it took; raises SystemExit when it fails.

    Its memory is at least that of the process that asks.
    """
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    printed = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - start
    if os.waitstatus_to_exitcode(status):
        raise SystemExit(f"{' '.join(command)} failed")
    return Used(seconds, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6, printed)


def in_fresh_process(code: str, repeats: int = 5) -> list[dict[str, Any]]:
    """Run Python `code` in a new process `repeats` times; each prints one JSON object on its last line."""
    found = []
    for _ in range(repeats):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        found.append(json.loads(done.stdout.strip().splitlines()[-1]))
    return found


def median_of(rows: list[dict[str, Any]], key: str) -> dict[str, float]:
    """Return median and spread of one figure over the rows of `in_fresh_process`."""
    values = [row[key] for row in rows]
    return {"seconds": statistics.median(values), "spread": max(values) - min(values), "runs": len(values)}


def machine() -> dict[str, Any]:
    """Describe what the numbers were measured on."""
    return {
        "cores": os.cpu_count(), "threads": torch.get_num_threads(), "processor": platform.processor() or platform.machine(),
        "python": platform.python_version(), "torch": version("torch"), "torchmat": version("torchmat"),
    }


def save(name: str, rows: list[dict[str, Any]]) -> None:
    """Write the rows of one suite as ``results/NAME.json``."""
    RESULTS.mkdir(exist_ok=True)
    text = json.dumps({"machine": machine(), "rows": rows}, indent=1, ensure_ascii=False)
    path = RESULTS / f"{name}.json"
    part = path.with_name(path.name + ".part")  # a run that is stopped leaves the rows before it
    part.write_text(text + "\n", encoding="utf-8")
    os.replace(part, path)
