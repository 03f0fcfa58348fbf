"""The benchmark suite of wishes: the smallest material that the choice finds at 25, 28 and 30 dB on each data set.

``python scripts/bench/wishes.py [--data stones disk] [--psnr 25 28]`` measures a part, and writes ``results/wishes.json`` after each row;
a row that stands there is not measured again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import Any

from measure import RESULTS, save
from protocol import DATA, load

import torchmat as tm
from torchmat.fitting.choice.shrink import total_bytes

NAME, PSNR = "wishes", (25.0, 28.0, 30.0)


def wishes(data: Sequence[str] = DATA, psnr: Sequence[float] = PSNR) -> list[dict[str, Any]]:
    """Bytes, error, what was picked, and seconds for each wish on each data set."""
    path = RESULTS / f"{NAME}.json"
    rows: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.is_file() else []
    for name in data:
        left = [wish for wish in psnr if not any((row["data"], row["psnr"]) == (name, wish) for row in rows)]
        btf = load(name)[0] if left else None
        for wish in left:
            assert btf is not None
            result = tm.fit(btf, "auto", psnr=wish, measure=False, progress=False)
            found = tm.evaluate(result.material.as_exported(), btf, result.split.held_out, perceptual=False).report
            chosen = result.report["figures"]["auto"]["chosen"]
            rows.append({
                "data": name, "psnr": wish, "outcome": result.stop_reason, "bytes": total_bytes(result.material),
                "dB": found["psnr_db"], "error": found["relative_error"], "picked": chosen["candidate"],
                "seconds": result.report["fit_seconds"],
            })
            print(rows[-1], flush=True)
            save(NAME, rows)
    return rows


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", default=DATA, choices=DATA)
    parser.add_argument("--psnr", nargs="+", type=float, default=PSNR)
    given = parser.parse_args()
    wishes(given.data, given.psnr)


if __name__ == "__main__":
    main()
