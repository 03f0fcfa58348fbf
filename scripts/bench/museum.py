"""Captures of museum size: the whole command on generated photographs, seconds, processor seconds and memory beside the error.

``python scripts/bench/museum.py [large] [middle] [small] [--models ptm hsh phong_srf] [--keep FOLDER]`` makes the photographs of a part in a
temporary folder (or in FOLDER, where they stay), fits them in fresh processes without a cache and stores ``results/museum.json``.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from measure import save, used_by
from photographs import rti_set

# Photographs, height, width, and options of the command.
PARTS: dict[str, tuple[int, int, int, tuple[str, ...]]] = {
    "large": (50, 3000, 4000, ()),
    "middle": (50, 1500, 2000, ()),
    "small": (81, 256, 256, ("--set", "storage=png8")),
}
MODELS = ("ptm", "hsh", "phong_srf")


def measured(part: str, model: str, folder: Path, options: tuple[str, ...]) -> dict[str, Any]:
    """Return a row: one run of ``torchmat fit`` with its report, in a process of its own."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "out"
        command = [sys.executable, "-m", "torchmat.cli", "fit", model, str(folder / "lights.lp"), "--no-cache", "--out", str(out), *options]
        used = used_by(command)
        report = json.loads((out / "report.json").read_text(encoding="utf-8"))
        count, height, width, _ = PARTS[part]
        row = {
            "part": part, "model": model, "photographs": count, "height": height, "width": width, "seconds": used.seconds,
            "processor_seconds": used.processor_seconds, "peak_rss_mb": used.peak_rss_mb,
            "load_seconds": report["load_seconds"], "fit_seconds": report["fit_seconds"],
            "psnr_db": report["held_out"]["psnr_db"], "relative_error": report["held_out"]["relative_error"],
            "bytes_written": sum(file.stat().st_size for file in out.rglob("*") if file.is_file()),
        }
    print(
        f"{part:7s} {count} x {width} x {height}  {model:10s} {row['seconds']:7.1f} s  processor {row['processor_seconds']:7.1f} s  "
        f"{row['peak_rss_mb']:6.0f} MB  load {row['load_seconds']:.1f} s, fit {row['fit_seconds']:.1f} s  {row['psnr_db']:.2f} dB", flush=True,
    )
    return row


def museum(parts: list[str], models: list[str], keep: Path | None = None) -> list[dict[str, Any]]:
    """Measure the parts asked for; rows are saved as they come."""
    rows: list[dict[str, Any]] = []
    for part in parts:
        count, height, width, options = PARTS[part]
        with tempfile.TemporaryDirectory() as temporary:
            folder = (keep or Path(temporary)) / part
            if not (folder / "lights.lp").is_file():
                rti_set(folder, count, height, width)
            for model in models if part != "small" else models[:1]:
                rows.append(measured(part, model, folder, options))
                save("museum", rows)
    return rows


def main() -> None:
    """Measure the parts named on the command line, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="which parts (default: all)")
    parser.add_argument("--models", nargs="*", default=list(MODELS), help="which models")
    parser.add_argument("--keep", type=Path, help="where photographs stay for another run")
    given = parser.parse_args()
    museum(given.parts or list(PARTS), given.models, given.keep)


if __name__ == "__main__":
    main()
