"""What light and colour are found from, taken from each photograph in one go: paper, patches, and cut-outs of mirror spheres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from torchmat.capturing.outline import Placed, outline, refined_centre
from torchmat.capturing.paper import Reading, patch_points, read_paper, sample_points, white_points
from torchmat.capturing.scene import Scene
from torchmat.progress import progress

CELLS, FINE = 128, 3  # along a side of the window, and points along a side of each cell
_ROOM = 0.4  # of a sphere's size around its cut-out: it may stand beside its place


class Cutout(NamedTuple):
    """A part of a photograph from `corner` [2] (column, row) on: `linear` [3, h, w] and `clipped` [h, w]."""

    corner: np.ndarray
    linear: np.ndarray
    clipped: np.ndarray


@dataclass(frozen=True, eq=False)
class Observed:
    """What one photograph shows: its `paper` at the board's white points, its `white` and `grey` patches, the `sample` where that is
    asked for, and of each sphere the cut-out (None: outside of the picture) and where it stands; `notes` on how its file was read."""

    paper: Reading
    white: Reading
    grey: Reading
    sample: Reading
    spheres: tuple[Cutout | None, ...]
    placed: tuple[Placed | None, ...]
    notes: tuple[str, ...]


class Places(NamedTuple):
    """The points of a board at which photographs are read, in mm: `paper`, `white`, `grey` and `sample` [n, 3], these in rows from the
    top, `FINE` x `FINE` of them in each of `CELLS` x `CELLS` cells; none where the sample is not read."""

    paper: np.ndarray
    white: np.ndarray
    grey: np.ndarray
    sample: np.ndarray


def places_of(scene: Scene, sample: bool = False) -> Places:
    """Return where the photographs of a scene are read; `sample` says that the sample is, too."""
    board = scene.board
    points = sample_points(board, CELLS * FINE) if sample else np.zeros((0, 3))
    white, grey = (patch_points(board, name).reshape(-1, 3) for name in ("white", "grey"))
    return Places(white_points(board), white, grey, points)


def observe(scene: Scene, places: Places, show: bool | None = None) -> list[Observed]:
    """Return what each photograph of a scene shows; each is read once."""
    return [_observed(scene, places, index) for index in progress(range(len(scene.photographs)), "reading the light", show=show)]


def _observed(scene: Scene, places: Places, index: int) -> Observed:
    board, camera, pose = scene.board, scene.cameras[index], scene.poses[index]
    developed = scene.photographs[index].developed()
    linear, clipped = developed.linear.numpy(), developed.clipped.numpy()
    radius = board.diameter / 2
    paper, white, grey, sample = (read_paper(linear, clipped, camera, pose, points, board.sphere_centres, radius) for points in places)
    cutouts: list[Cutout | None] = []
    placed: list[Placed | None] = []
    for centre in board.sphere_centres:
        around = outline(camera, pose, centre, radius)
        room = _ROOM * np.ptp(around, axis=0).max()
        low = np.floor(around.min(0) - room).astype(int)
        high = np.ceil(around.max(0) + room).astype(int) + 1
        low, high = np.maximum(low, 0), np.minimum(high, camera.size)
        whole = (around >= 0).all() and (around <= np.array(camera.size) - 1).all()
        if not whole:
            cutouts.append(None)
            placed.append(None)
            continue
        window = (slice(low[1], high[1]), slice(low[0], high[0]))
        part = np.ascontiguousarray(linear[:, *window])
        cutouts.append(Cutout(low, part, clipped[window].copy()))
        placed.append(refined_centre(part.mean(0), camera, pose, centre, radius, board.reflectance, low))
    return Observed(paper, white, grey, sample, tuple(cutouts), tuple(placed), developed.notes)
