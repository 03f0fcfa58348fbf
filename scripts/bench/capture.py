"""The benchmark suite of captures: simulated photographs of a known sample, and photographs that cannot be used.

``python scripts/bench/capture.py [--photographs DIR] [--count N] [--only geometry bad]`` writes ``results/capture.json``. The light is given as it is: what is
measured is where the camera stood, and where texels come to lie. The photographs of 3000 x 2000 take some minutes to simulate; those that
stand in DIR are taken from there.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import RESULTS, save

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.capturing.bad_photographs import bad_photographs, photographs_of  # noqa: E402
from tests.capturing.known_light import KnownLight  # noqa: E402
from tests.capturing.shots import Lamp, Lens, Shot  # noqa: E402
from tests.capturing.simulated import Studio, write  # noqa: E402

from torchmat.capturing.board import Board  # noqa: E402
from torchmat.capturing.detect import detect  # noqa: E402
from torchmat.capturing.locate import locate, photograph_files, read_photographs  # noqa: E402
from torchmat.capturing.photographs import turned_alike  # noqa: E402
from torchmat.capturing.rectify import choose_grid  # noqa: E402
from torchmat.capturing.register import register  # noqa: E402
from torchmat.colour import srgb_to_linear  # noqa: E402

NAME, COUNT, BAD, SIZE = "capture", 30, 200, (3000, 2000)
LENS = Lens(SIZE, 3300.0, (1512.0, 989.0), (-0.12, 0.05, 0.0008, -0.0006, 0.0))
TEXELS = 640


def sample(light: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
    """A matte pattern of three sizes under a gloss."""
    draw = torch.Generator().manual_seed(7)
    noise = [torch.rand(1, 3, side, side, generator=draw) for side in (20, 90, 300)]
    layers = [torch.nn.functional.interpolate(one, (TEXELS, TEXELS), mode="bicubic") for one in noise]
    albedo = (0.05 + 0.5 * sum(layers)[0] / 3).clamp(0.02, 0.9)
    half = torch.nn.functional.normalize(light + view, dim=0)
    return (albedo + 0.3 * half[2:].clamp(min=0) ** 60) * light[2:].clamp(min=0)


def shots() -> list[Shot]:
    """Thirty photographs from 20 to 60 degrees by hand: no two from one distance, aimed and rolled a little differently."""
    random = np.random.default_rng(11)
    found = []
    for number in range(COUNT):
        polar, azimuth = np.radians(random.uniform(20, 60)), np.radians(137.5 * number)
        place = random.uniform(380, 460) * np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
        tilt, turn = np.radians(random.uniform(5, 45)), np.radians(222.5 * number)
        lamp = random.uniform(450, 600) * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        aim = (*random.uniform(-10, 10, 2), 0.0)
        exposure, roll = random.uniform(0.6, 0.9), float(random.choice([90, 270]) + random.uniform(-10, 10))
        found.append(Shot(tuple(place), Lamp(tuple(lamp)), exposure, aim, roll))
    return found


def geometry(folder: Path, count: int = COUNT) -> dict[str, Any]:
    """View directions and places of texels against what is true, of `count` photographs in `folder`, which are made where there are none."""
    left, bottom, right, top = Board().window
    studio = Studio(sample, Board(spheres=0), LENS, (TEXELS, TEXELS), (left, bottom, right, top), vignetting=0.25, full_well=20000, blur=0.5)
    taken = shots()[:count]
    for number, shot in enumerate(taken, 1):
        if not (folder / f"photo_{number:02d}.jpg").is_file():
            write(folder / "new", [studio.one(shot, number)], ".jpg")
            (folder / "new" / "photo_01.jpg").rename(folder / f"photo_{number:02d}.jpg")
            print(f"photograph {number} of {count}", flush=True)
    by_name = {f"photo_{number:02d}.jpg": shot for number, shot in enumerate(taken, 1)}
    start = time.process_time()
    found, unread = read_photographs([path for path in photograph_files(folder) if path.name in by_name])
    located = locate(Board(spheres=0), turned_alike(found), unread, show=False)
    scene = located.scene
    grid = choose_grid(scene.board, scene.cameras, scene.poses)
    registered = register(scene, KnownLight(by_name, scene), grid, show=False)
    seconds = time.process_time() - start
    row = {"photographs": count, "used": len(scene.photographs), "size": list(SIZE), "texels": list(grid.shape), "seconds_of_cpu": seconds}
    row |= {"corners_px_rms": located.calibration.rms, "model": located.calibration.model, "focal_error": scene.cameras[0].matrix[0, 0] / LENS.focal - 1}
    row |= _against_truth(studio, by_name, scene, grid, registered)
    row |= {"measured_texels_rms": registered.step.figures["after_texels"], "moved": registered.step.figures["moved"], "height_mm": registered.height}
    return row


def _against_truth(studio: Studio, by_name: dict[str, Shot], scene: Any, grid: Any, registered: Any) -> dict[str, float]:
    rows, columns = (np.linspace(0, side - 1, 25) for side in grid.shape)
    column, row = np.meshgrid(columns, rows)
    at = np.stack((column, row, np.ones_like(row)), axis=-1)
    step_y, step_x = grid.texel

    def place(texel: np.ndarray) -> np.ndarray:
        x, y = grid.box[0] + (texel[..., 0] + 0.5) * step_x, grid.box[3] - (texel[..., 1] + 0.5) * step_y
        return np.stack((x, y, np.zeros(x.shape)), axis=-1)

    angles, beside = [], []
    for one, camera, pose, shift in zip(scene.photographs, scene.cameras, scene.poses, registered.shifts, strict=True):
        shot, points = by_name[one.name], place(at)
        views = np.asarray(shot.position) - points
        views /= np.linalg.norm(views, axis=-1, keepdims=True)
        angles.append(np.degrees(np.arccos(np.clip((views * pose.views(points)).sum(-1), -1, 1))))
        moved = place(at if shift is None else at @ shift.T)
        moved[..., 2] = registered.height
        truth, found = studio.pixels_of(shot, points), pose.project(camera, moved)
        steps = np.stack([studio.pixels_of(shot, points + step) - truth for step in ((step_x, 0, 0), (0, -step_y, 0))], axis=-1)
        beside.append(np.linalg.solve(steps, (found - truth)[..., None])[..., 0])
    lengths = np.linalg.norm(np.array(beside), axis=-1)
    return {
        "view_deg_rms": float(np.sqrt(np.mean(np.square(angles)))), "view_deg_most": float(np.max(angles)),
        "texels_rms": float(np.sqrt(np.mean(lengths**2))), "texels_most": float(lengths.max()),
    }


def bad() -> list[dict[str, Any]]:
    """How many of 200 bad photographs are told by their reason, by what was done to them."""
    lens = Lens((720, 480), 790.0)
    good, other = photographs_of(Board(), lens, 6), photographs_of(Board(series=3), lens, 2, 1)
    right, total, wrong = Counter(), Counter(), []
    for name, word, pixels in itertools.islice(bad_photographs(good, other), BAD):
        reason = detect(Board(), srgb_to_linear(torch.from_numpy(pixels).permute(2, 0, 1).float() / 255)).reason
        total[name] += 1
        right[name] += reason.startswith(word) and bool(reason) == bool(word)
        if not (reason.startswith(word) and bool(reason) == bool(word)):
            wrong.append(f"{name}: {reason or 'used'}")
    others = {name: [one for one in wrong if one.startswith(f"{name}: ")] for name in total}
    return [{"bad": name, "photographs": total[name], "told": right[name], "otherwise": others[name]} for name in total]


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photographs", type=Path)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--only", nargs="+", default=("geometry", "bad"), choices=("geometry", "bad"))
    given = parser.parse_args()
    path = RESULTS / f"{NAME}.json"
    rows: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.is_file() else []
    if "bad" in given.only:
        rows = [row for row in rows if "bad" not in row] + bad()
        save(NAME, rows)
    if "geometry" in given.only:
        with tempfile.TemporaryDirectory() as made:
            rows = [geometry(given.photographs or Path(made), given.count)] + [row for row in rows if "bad" in row]
        save(NAME, rows)
    for row in rows:
        print(row)


if __name__ == "__main__":
    main()
