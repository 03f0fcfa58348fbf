"""capture: from photographs to a BTF, step by step, each with what it found and the figure that would show that it went wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchmat.capturing.board import Board
from torchmat.capturing.brackets import merge_photographs
from torchmat.capturing.locate import Located, locate, photograph_files, read_photographs
from torchmat.capturing.page import capture_page
from torchmat.capturing.photographs import turned_alike
from torchmat.capturing.photometry import PhotometryOptions, photometry
from torchmat.capturing.pictures import contact_sheet, marked, thumb
from torchmat.capturing.pose import printed, stations
from torchmat.capturing.rectify import FILTER, Grid, Rectified, choose_grid
from torchmat.capturing.register import Registered, register
from torchmat.capturing.scene import Photometry, Scene, Step
from torchmat.capturing.texels import texels_of
from torchmat.capturing.write import check_target, manifest_text, write_capture
from torchmat.errors import FitError, message
from torchmat.progress import progress as bar

_SHOWN = 3  # photographs on the page, with the corners that were found
_FAR = 1e6  # mm: where a far lamp is put when others are near


@dataclass(frozen=True, eq=False)
class Captured:
    """What a capture wrote: its `folder`, what each of its `steps` found, the `grid` of the texels, the photographs that are used, in
    the order of the manifest, and in words why others are `left_out`, by their names."""

    folder: Path
    steps: tuple[Step, ...]
    grid: Grid
    used: tuple[str, ...]
    left_out: dict[str, str]


def capture(
    photographs: str | Path | Sequence[str | Path], out: str | Path, board: Board | None = None,
    light: PhotometryOptions | Callable[[Scene], Photometry] | None = None, *, measured: float | None = None,
    texel: float | None = None, height: float | None = None, refine: bool = True, brackets: int | None = None,
    encoding: str = "auto", force: bool = False, progress: bool | None = None,
) -> Captured:
    """Turn photographs of a flat sample in a printed board's window into a BTF, a folder that `load_btf` reads.

    Returns what each step found (`Captured`); ``capture.html`` in the folder shows it. Needs the extra `capture`.

    Args:
        photographs: a folder, or a list of files.
        out: the folder to write; an earlier capture there is replaced, unless something in it was changed.
        board: as it was printed nominally (`torchmat.capturing.board.Board`); None is the one that `torchmat board` draws.
        light: where light and colour come from (`torchmat.capturing.photometry.PhotometryOptions`), or a function of the scene that tells them;
            None finds lamps from the board's mirror spheres.
        measured: length of the printed scale bar in mm; None takes it as printed at 100 %, and says so.
        texel: side of a texel in mm; None takes the photographs' own resolution.
        height: of the sample's surface above the board in mm; None finds it where the sample's own pattern tells it.
        refine: whether photographs are registered on the sample itself, where that gains.
        brackets: exposures of each bracket, in the photographs' order; None sees from the files whether they are brackets, 1 merges none.
        encoding: as `load_btf` has it.
        force: whether an earlier capture that was changed is replaced, and kept as a backup.
        progress: whether bars are shown; None shows them on a terminal.

    Raises DataError, RangeError or FitError, which name what is at fault; a photograph that cannot be used is left out instead, with its reason.
    """
    check_target(out, force)
    board, said = printed(board or Board(), measured)
    found, unread = read_photographs(photograph_files(photographs), encoding)
    found, merged = merge_photographs(found, brackets, encoding)
    located = locate(board, turned_alike(found), unread, progress)
    told = light(located.scene) if callable(light) else photometry(located.scene, light, progress)
    located, known = _without_unlit(located, told)
    scene = located.scene
    grid = choose_grid(board, scene.cameras, scene.poses, texel, height or 0.0)
    registered = register(scene, known, grid, find_height=height is None, show=progress) if refine else None
    grid = grid if registered is None else replace(grid, height=registered.height)
    last = [_texels(grid, texel)] if registered is None else [registered.step, _texels(grid, texel)]
    steps = [_scale(board, said), _with_pictures(located, merged), *located.steps[1:], *known.steps, *last]
    return _written(out, scene, known, grid, registered, steps, located.left_out, force, progress)


def _without_unlit(located: Located, light: Photometry) -> tuple[Located, Photometry]:
    """Return the scene without photographs whose light could not be found, and the photometry by the numbers that they have in it."""
    kept = [index for index, keep in enumerate(light.keep) if keep]
    if not kept:
        step = "See the notes of the steps before."
        raise FitError(message("capture", "photographs", "have a light that can be found", f"none of {len(light.keep)} has", step))
    if len(kept) == len(light.keep):
        return located, light
    scene = located.scene
    left = {one.name: "its light was not found" for index, one in enumerate(scene.photographs) if index not in kept}
    detections = tuple(located.detections[index] for index in kept)
    return replace(located, scene=scene.picked(kept), left_out={**located.left_out, **left}, detections=detections), _Kept(light, kept)


class _Kept:
    """A photometry of some of the photographs that it was made for."""

    def __init__(self, whole: Photometry, kept: Sequence[int]) -> None:
        self._whole, self._kept = whole, kept
        self.steps: Sequence[Step] = whole.steps
        self.keep: Sequence[bool] = [True] * len(kept)
        self.light = whole.light[kept]
        position = whole.position
        self.position = None if position is None or not np.isfinite(position[kept]).any() else position[kept]

    def correct(self, index: int, pixels: torch.Tensor) -> torch.Tensor:
        return self._whole.correct(self._kept[index], pixels)

    def irradiance(self, index: int, points: np.ndarray) -> np.ndarray:
        return self._whole.irradiance(self._kept[index], points)


def _scale(board: Board, said: str) -> Step:
    return Step("scale", said, "", {"paper": board.paper, "series": board.series, "scale": board.scale, "square_mm": board.square})


def _with_pictures(located: Located, merged: Sequence[str]) -> Step:
    """Return the first step with some photographs in which the corners that were found are marked."""
    count = len(located.scene.photographs)
    chosen = sorted({round(place) for place in np.linspace(0, count - 1, min(_SHOWN, count))})
    some = [(located.scene.photographs[index], located.detections[index].pixels) for index in chosen]
    pictures = {f"{one.name}: the corners that were found": marked(one.linear(), pixels) for one, pixels in some}
    return replace(located.steps[0], pictures=pictures, notes=(*merged, *located.steps[0].notes))


def _texels(grid: Grid, texel: float | None) -> Step:
    how = "as the photographs resolve it" if texel is None else "as given"
    found = f"{grid.shape[1]} x {grid.shape[0]} of {grid.texel[1]:.3g} mm, {how}"
    figures = {"box_mm": list(grid.box), "rows": grid.shape[0], "columns": grid.shape[1], "height_mm": grid.height, "filter": FILTER}
    return Step("texels", found, "", figures, notes=(f"A texel's value is the {FILTER}",))


def _written(
    out: str | Path, scene: Scene, light: Photometry, grid: Grid, registered: Registered | None, steps: list[Step], left_out: dict[str, str],
    force: bool, show: bool | None,
) -> Captured:
    names = [f"{one.path.stem}.exr" for one in scene.photographs]
    thumbs: list[torch.Tensor] = []
    shares: list[float] = []

    def pictures() -> Iterator[Rectified]:
        for index in bar(range(len(names)), "resampling", show=show):
            one = texels_of(scene, light, index, grid, None if registered is None else registered.shifts[index])
            thumbs.append(thumb(one.values))
            shares.append(float(one.valid.float().mean()))
            yield one

    def all_steps() -> tuple[Step, ...]:
        sheet = {"All photographs on the texels": contact_sheet(thumbs)}
        residual = f"{np.mean(shares):.1%} of the samples are valid, at least {min(shares):.1%} of a photograph's"
        last = replace(steps[-1], pictures=sheet, residual=residual, figures={**steps[-1].figures, "valid": dict(zip(names, shares, strict=True))})
        return (*steps[:-1], last)

    near = light.position is not None
    lights = light.light if light.position is None else light.position
    views = stations(np.array([pose.position for pose in scene.poses]))
    manifest = manifest_text(names, grid, views, np.where(np.isfinite(lights), lights, _FAR * light.light), near)

    def record() -> dict[str, Any]:
        return {"steps": {step.name: _said(step) for step in all_steps()}}

    folder = write_capture(out, names, pictures(), manifest, record, lambda: capture_page(out, all_steps()), force)
    return Captured(folder, all_steps(), grid, tuple(one.name for one in scene.photographs), left_out)


def _said(step: Step) -> dict[str, Any]:
    return {"found": step.found, "residual": step.residual, **step.figures, "notes": list(step.notes)}
