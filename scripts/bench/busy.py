"""The benchmark suite of busy machines: what other programs cost a fit, by threads and how long idle ones spin."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

from measure import SHARED, in_fresh_process, median_of

from torchmat.cli.threads import SPINS

_FIT = """
import json, time
import torchmat as tm
btf = tm.load_btf({path!r})
start = time.perf_counter()
tm.fit(btf, "distribution", geometry="flat", lobes=1, fresnel=False, rotation=False, effort=0.03, measure=False, progress=False)
print(json.dumps(dict(seconds=time.perf_counter() - start)))
"""
_OTHERS = 4  # programs that do nothing but count
_WAYS = {
    "one thread": {"OMP_NUM_THREADS": "1"}, "two threads as libgomp has them": {"OMP_NUM_THREADS": "2"},
    "two, no spinning": {"OMP_NUM_THREADS": "2", "GOMP_SPINCOUNT": "0"},
    "two, as the commands set them": {"OMP_NUM_THREADS": "2", "GOMP_SPINCOUNT": str(SPINS)},
}


def busy() -> list[dict[str, Any]]:
    """Seconds of a short fit alone and beside four programs that keep all cores busy."""
    code, rows = _FIT.format(path=str(SHARED / "reference" / "leather.zip")), []
    usual = dict(os.environ)
    for way, settings in _WAYS.items():
        row: dict[str, Any] = {"threads": way}
        os.environ.update(settings)
        try:
            for name, count in (("alone", 0), ("busy", _OTHERS)):
                others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
                try:
                    row[name] = median_of(in_fresh_process(code, 3), "seconds")
                finally:
                    for other in others:
                        other.kill()
                        other.wait()
        finally:
            os.environ.clear()
            os.environ.update(usual)
        print({key: value if isinstance(value, str) else round(value["seconds"], 2) for key, value in row.items()}, flush=True)
        rows.append(row)
    return rows
