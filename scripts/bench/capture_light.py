"""The benchmark suite of light and colour in captures: the photographs of ``scripts/make_photographs.py`` against what is true of them.

``python scripts/bench/capture_light.py --photographs DIR [--width 3000]`` writes ``results/capture_light.json``. Everything is found from the
photographs: camera, poses, lamps, vignetting, exposure and white.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from measure import save

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from make_photographs import shots_by_hand, studio  # noqa: E402

from torchmat.capturing.board import Board  # noqa: E402
from torchmat.capturing.locate import locate, photograph_files, read_photographs  # noqa: E402
from torchmat.capturing.photographs import turned_alike  # noqa: E402
from torchmat.capturing.photometry import photometry  # noqa: E402


def light(folder: Path, width: int) -> dict[str, Any]:
    """Directions to lamps, and what photographs are divided by, against what is true."""
    files = photograph_files(folder)
    of, shots = studio(width), dict(zip([path.name for path in files], shots_by_hand(len(files)), strict=True))
    found, unread = read_photographs(files)
    scene = locate(Board(), turned_alike(found), unread, show=False).scene
    start = time.process_time()
    known = photometry(scene, show=False)
    seconds = time.process_time() - start
    points = of.texel_points()[::40, ::40]
    rows = []
    for index, one in enumerate(scene.photographs):
        lamp, place = shots[one.name].lamp, known.lights[index]
        if place is None:
            continue
        truth, _, strength = lamp.at(points)
        apart = np.degrees(np.arccos(np.clip((place.directions(points) * truth).sum(-1), -1, 1)))
        middle = np.degrees(np.arccos(place.direction @ lamp.position / np.linalg.norm(lamp.position)))
        gains = np.array(lamp.colour) * of.gains * shots[one.name].exposure
        lit = known.irradiance(index, points)[..., 0]
        off = (known.whites.scale[index][:, None, None] * lit / (gains[:, None, None] * strength) - 1)[:, lit > 0]
        balance = known.whites.scale[index] / known.whites.scale[index].mean() / (gains / gains.mean()) - 1
        rows.append((middle, apart.max(), place.sigma_deg, np.abs(off.mean(1)).max(), np.abs(off).max(), np.abs(balance).max()))
    table = np.array(rows)
    return {
        "photographs": len(files), "with_light": len(rows), "width": width, "seconds_of_cpu": seconds, "light_deg_rms": float(np.sqrt((table[:, 0] ** 2).mean())),
        "light_deg_most": float(table[:, 0].max()), "texel_deg_most": float(table[:, 1].max()), "said_deg": float(np.median(table[:, 2])),
        "exposure_most": float(table[:, 3].max()), "texel_exposure_most": float(table[:, 4].max()), "balance_most": float(table[:, 5].max()),
    }


def main() -> None:
    """Measure, save and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photographs", type=Path, required=True)
    parser.add_argument("--width", type=int, default=3000)
    given = parser.parse_args()
    row = light(given.photographs, given.width)
    save("capture_light", [row])
    print(row)


if __name__ == "__main__":
    main()
