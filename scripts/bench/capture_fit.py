"""The benchmark suite of fits from photographs: what `torchmat capture` wrote against the same swatch as no camera saw it.

``python scripts/bench/capture_fit.py --captured DIR --truth DIR [--model phong_srf]`` writes ``results/capture_fit.json``: how far the captured images are
from the true ones, and how well a model that was fitted to either predicts the true ones. Both folders are made as the tutorial makes them;
the true images are brought to the captured texels.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import save

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import torchmat as tm  # noqa: E402
from torchmat.capturing.rectify import Grid  # noqa: E402
from torchmat.capturing.write import manifest_text  # noqa: E402
from torchmat.colour import linear_to_srgb  # noqa: E402
from torchmat.images import read_image, write_image  # noqa: E402

_FINE = 3  # samples along a texel's side


def resampled(truth: Path, captured: Path, out: Path) -> None:
    """Write the true images, those of the photographs that were used, on the captured texels."""
    said = json.loads((captured / "capture.json").read_text(encoding="utf-8"))["steps"]["texels"]
    left, bottom, right, top = said["box_mm"]
    rows = list(csv.DictReader((truth / "manifest.csv").open(encoding="utf-8")))
    used = [row["file"] for row in csv.DictReader((captured / "manifest.csv").open(encoding="utf-8"))]
    rows = [row for row in rows if row["file"] in used]
    half = float(rows[0]["sample_width"]) / 2
    x = left + (np.arange(_FINE * said["columns"]) + 0.5) / _FINE / said["columns"] * (right - left)
    y = top - (np.arange(_FINE * said["rows"]) + 0.5) / _FINE / said["rows"] * (top - bottom)
    at = torch.from_numpy(np.stack(np.meshgrid(x / half, -y / half), axis=-1)).float()[None]
    out.mkdir()
    for row in rows:
        image = torch.as_tensor(np.asarray(read_image(truth / row["file"]), dtype=np.float32)).movedim(-1, 0)[None]
        fine = torch.nn.functional.grid_sample(image, at, mode="bilinear", padding_mode="border", align_corners=False)
        small = torch.nn.functional.avg_pool2d(fine, _FINE)[0].movedim(0, -1)
        write_image(out / row["file"], small.contiguous().numpy().astype(np.float16))
    places = [np.array([[float(row[f"{which}_{axis}"]) for axis in "xyz"] for row in rows]) for which in ("view", "light")]
    grid = Grid((left, bottom, right, top), (said["rows"], said["columns"]))
    (out / "manifest.csv").write_text(manifest_text([row["file"] for row in rows], grid, *places, True), encoding="utf-8")


def decibels(shown: torch.Tensor, true: torch.Tensor) -> float:
    """Return dB of sRGB codes for peak 1, as reports have them."""
    codes = [linear_to_srgb(one.clamp(0, 1)) for one in (shown, true)]
    return float(-10 * torch.log10(((codes[0] - codes[1]) ** 2).mean()))


def compared(captured: Path, truth: Path, model: str) -> dict[str, Any]:
    """Return the row of one capture."""
    with tempfile.TemporaryDirectory() as folder:
        resampled(truth, captured, Path(folder) / "truth")
        true, seen = (tm.load_btf(path, cache=False, progress=False) for path in (Path(folder) / "truth", captured))
        mean = [float(-10 * np.log10(np.mean([float(((seen.image(i) - true.image(i)) ** 2).mean()) for i in range(len(true))])))]
        row: dict[str, Any] = {"model": model, "images": len(true), "texels": list(true.image(0).shape[1:]), "images_db_linear": mean[0]}
        row["images_db"] = float(np.mean([decibels(seen.image(i), true.image(i)) for i in range(len(true))]))
        for name, source in (("photographs", seen), ("truth", true)):
            start = time.process_time()
            material = tm.fit(source, model, holdout=0, measure=False, progress=False).material
            row[f"fit_seconds_{name}"] = time.process_time() - start
            with torch.no_grad():
                row[f"db_{name}"] = float(np.mean([decibels(material.shade(*(one[0] for one in true.directions([i]))), true.image(i)) for i in range(len(true))]))
        row["db_lost"] = row["db_truth"] - row["db_photographs"]
        return row


def main() -> None:
    """Measure, save and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captured", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--model", default="phong_srf")
    given = parser.parse_args()
    row = compared(given.captured, given.truth, given.model)
    save("capture_fit", [row])
    print(row)


if __name__ == "__main__":
    main()
