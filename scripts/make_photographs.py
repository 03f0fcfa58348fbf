"""Make the photographs that the tutorial of `torchmat capture` uses, without a camera.

A leather swatch of which everything is known lies in the window of the A4 board, with two mirror spheres. A phone takes it by hand from 20 to
60 degrees, with a lamp that somebody puts elsewhere each time, half a metre away. The photographs have what real ones have: perspective, a lens
that bends and darkens its corners, a near lamp that falls off and is a little stronger or weaker each time, the lamp's and the camera's
colours, noise, eight bits and JPEG.

    python scripts/make_photographs.py --out photographs            # 30 of 3000 x 2000, about ten seconds of one core each
    python scripts/make_photographs.py --out photographs --width 1500 --count 12
    torchmat capture photographs --out leather

``--truth DIR`` writes the same swatch under the same lights as a BTF that no camera saw, for comparison.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.capturing.shots import Lens, Shot  # noqa: E402
from tests.capturing.simulated import Studio, Taken, write  # noqa: E402
from tests.capturing.swatch import leather, shots_by_hand  # noqa: E402

from torchmat.capturing.board import Board  # noqa: E402
from torchmat.capturing.rectify import Grid  # noqa: E402
from torchmat.capturing.write import manifest_text  # noqa: E402
from torchmat.images import write_image  # noqa: E402

GAINS = (0.62, 1.0, 0.7)  # the camera's own white
DISTORTION = (-0.12, 0.05, 0.0008, -0.0006, 0.0)
EXIF = {"Make": "Simulated", "Model": "Phone", "Exif:FocalLength": 5.4, "ExposureTime": 0.02, "FNumber": 1.8, "Exif:PhotographicSensitivity": 100}


def studio(width: int = 3000, texels: int = 640) -> Studio:
    """Return the studio, for photographs so wide; the swatch fills the board's window with texels x texels."""
    height = width * 2 // 3
    lens = Lens((width, height), 1.1 * width, ((width - 1) / 2 + 0.004 * width, (height - 1) / 2 - 0.004 * width), DISTORTION)
    return Studio(leather(texels), Board(), lens, (texels, texels), vignetting=0.25, gains=GAINS, full_well=20000, blur=0.5)


def put(folder: Path, taken: Taken, number: int) -> Path:
    """Write a photograph as a camera would, with EXIF."""
    exif = EXIF | {"Exif:FocalLengthIn35mmFilm": 40, "ExposureTime": 0.02 * taken.shot.exposure}
    made, = write(folder / ".new", [taken], ".jpg", exif)
    path = made.replace(folder / f"IMG_{number:04d}.jpg")
    (folder / ".new").rmdir()
    return path


def write_truth(folder: Path, of: Studio, shots: Sequence[Shot], values: Sequence[np.ndarray]) -> None:
    """Write the swatch's values [3, h, w] under the shots' lights and views as a BTF."""
    folder.mkdir(parents=True, exist_ok=True)
    grid = Grid(tuple(float(one) for one in of.sample_box), of.texels)
    names = [f"IMG_{number:04d}.exr" for number in range(1, len(shots) + 1)]
    places = [np.array([place(shot) for shot in shots], float) for place in (lambda one: one.position, lambda one: one.lamp.position)]
    for name, value in zip(names, values, strict=True):
        write_image(folder / name, np.ascontiguousarray(np.moveaxis(value, 0, -1)).astype(np.float16))
    (folder / "manifest.csv").write_text(manifest_text(names, grid, *places, True), encoding="utf-8")


def main() -> None:
    """Make what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("photographs"))
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--width", type=int, default=3000)
    parser.add_argument("--truth", type=Path)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    of, shots, values = studio(given.width), shots_by_hand(given.count), []
    for number, shot in enumerate(shots, 1):
        taken = of.one(shot, number)
        values.append(taken.value)
        print(put(given.out, taken, number), flush=True)
    if given.truth:
        write_truth(given.truth, of, shots, values)
        print(given.truth)


if __name__ == "__main__":
    main()
