"""The benchmark suite of silence: how long commands say nothing on a terminal."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from measure import SHARED
from photographs import rti_set

_LEATHER, _REAL = SHARED / "reference" / "leather.zip", SHARED / "real"
_LARGE = "fit ptm, museum size"  # 50 photographs of 4000 x 3000, which take two minutes to make
_MOST = 900  # seconds of one command


def watched(arguments: list[str], most: float = _MOST) -> tuple[list[tuple[float, str]], float, int]:
    """Run torchmat on a terminal of its own; return (second, text) of all that it writes, its seconds, and its code."""
    ours, its = pty.openpty()
    start, found = time.perf_counter(), []
    process = subprocess.Popen([sys.executable, "-m", "torchmat.cli", *arguments], stdin=its, stdout=its, stderr=its)
    os.close(its)
    try:
        while time.perf_counter() - start < most:
            if not select.select([ours], [], [], 1.0)[0]:
                continue
            try:
                text = os.read(ours, 65536).decode(errors="replace")
            except OSError:  # it has ended
                break
            found.append((time.perf_counter() - start, text))
        return found, time.perf_counter() - start, process.wait(timeout=10)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        os.close(ours)


def figures(found: list[tuple[float, str]], seconds: float) -> dict[str, Any]:
    """Return the second of the first sign, the longest silence after it and the last sign before that, and how long Python
    takes to end after the last one."""
    times = [0.0, *(second for second, _ in found)]
    gaps = [later - earlier for earlier, later in zip(times, times[1:], strict=False)]
    longest = max(range(1, len(gaps)), key=gaps.__getitem__, default=0)
    before = found[longest - 1][1].strip().splitlines()[-1:] if longest else []
    return {
        "seconds": seconds, "first_sign": gaps[0] if gaps else seconds, "longest_silence": gaps[longest] if gaps else 0.0,
        "after": "".join(before).strip(), "until_the_prompt": seconds - times[-1],
    }


def commands(folder: Path) -> dict[str, list[str]]:
    """Return the commands that are watched, by name; they write into `folder`."""
    picture = next(iter(sorted((_REAL / "ambientcg").glob("*/*Color*"))))
    brdf = next(iter(sorted((_REAL / "rgl").glob("*.bsdf"))))
    made = {
        "fit distribution": ["fit", "distribution", str(_LEATHER), "--set", "effort=0.2"],
        "fit ptm": ["fit", "ptm", str(_LEATHER)],
        "create, a picture": ["create", str(picture)],
        "create, a .bsdf": ["create", str(brdf)],
        "create, textures": ["create", str(picture.parent)],
        "geometry": ["geometry", str(_LEATHER)],
        "compare": ["compare", str(_LEATHER), "--models", "ptm", "phong_srf"],
        _LARGE: ["fit", "ptm", str(folder / "large" / "lights.lp"), "--cache", str(folder / "cache")],
    }
    return {name: [*given, "--out", str(folder / name)] for name, given in made.items()}


def signs(only: tuple[str, ...] = ()) -> list[dict[str, Any]]:
    """Seconds until the first sign of life of each command, and its longest silence afterwards."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, given in commands(Path(folder)).items():
            if only and name not in only:
                continue
            if name == _LARGE:
                rti_set(Path(folder) / "large", 50, 3000, 4000)
            found, seconds, code = watched(given)
            row = {"command": name, **figures(found, seconds), "code": code}
            print({key: round(value, 2) if isinstance(value, float) else value for key, value in row.items()}, flush=True)
            rows.append(row)
    return rows


if __name__ == "__main__":
    signs(tuple(sys.argv[1:]))
