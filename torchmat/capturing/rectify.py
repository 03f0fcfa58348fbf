"""Photographs on the texels of the sample's plane: undistorted and seen from straight above in one resampling, matched to the texels' areas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchmat.capturing.board import Board
from torchmat.capturing.extra import opencv
from torchmat.capturing.view import Camera, Pose
from torchmat.errors import RangeError, check_positive, message

_RIM = 1.5  # mm of the window, at each side, that the paper's thickness and blurred edges spoil
_PER_PIXEL, _LEAST, _MOST = 2.0, 2, 16  # samples per pixel along a texel's side, and how many at least and at most
_TEXELS = 8192  # along a side: larger samples are a mistake in the texel's size
_BAND = 256  # rows of texels at once
FILTER = "mean over the texel's area of the picture between its pixels (cubic, a = -0.75), two samples or more a pixel along each side"


@dataclass(frozen=True)
class Grid:
    """Texels of the sample's plane: `box` (left, bottom, right, top) in mm, `shape` (rows, columns); row 0 is at the top.

    `height` in mm is that of the sample's plane above the board.
    """

    box: tuple[float, float, float, float]
    shape: tuple[int, int]
    height: float = 0.0

    @property
    def texel(self) -> tuple[float, float]:
        """A texel's height and width in mm."""
        left, bottom, right, top = self.box
        return (top - bottom) / self.shape[0], (right - left) / self.shape[1]

    def points(self, rows: slice = slice(None)) -> np.ndarray:
        """Return the middles [h, w, 3] of the texels, or of some rows of them, in mm of the board's frame."""
        step_y, step_x = self.texel
        y = self.box[3] - (np.arange(self.shape[0])[rows] + 0.5) * step_y
        x = self.box[0] + (np.arange(self.shape[1]) + 0.5) * step_x
        return np.stack((*np.meshgrid(x, y), np.full((len(y), len(x)), self.height)), axis=-1)


class Rectified(NamedTuple):
    """A photograph on the texels: `values` [C, h, w], `valid` [h, w] where all of a texel is seen, and `density` [h, w], how many
    of the photograph's pixels there are in a texel."""

    values: Tensor
    valid: Tensor
    density: Tensor


def choose_grid(board: Board, cameras: Sequence[Camera], poses: Sequence[Pose], texel: float | None = None, height: float = 0.0) -> Grid:
    """Return square texels that fill the window, but for its rim.

    Without a `texel` in mm it is a pixel's size at the window's middle: the median of the photographs, each the geometric mean of its two sides.
    Raises RangeError for a texel that would make more than 8192 of them along a side, or fewer than 4.
    """
    left, bottom, right, top = (float(one) for one in board.window)
    left, bottom, right, top = left + _RIM, bottom + _RIM, right - _RIM, top - _RIM
    if texel is None:
        middle = Grid((-0.5, -0.5, 0.5, 0.5), (1, 1), height)
        pixels = [float(_mapped(middle, camera, pose, slice(None))[2][0, 0]) ** 0.5 for camera, pose in zip(cameras, poses, strict=True)]
        texel = 1 / float(np.median(pixels))
    check_positive("capture", "the texel's size", texel, "It is in millimetres.")
    shape = (round((top - bottom) / texel), round((right - left) / texel))
    if not (4 <= min(shape) and max(shape) <= _TEXELS):
        fact = f"{texel:g} mm makes {shape[1]} x {shape[0]} of them in {right - left:g} x {top - bottom:g} mm"
        raise RangeError(message("capture", "the texel's size", f"make 4 to {_TEXELS} texels along a side", fact, "It is in millimetres."))
    wide, high = shape[1] * texel / 2, shape[0] * texel / 2
    return Grid((-wide, -high, wide, high), shape, height)


def rectify(
    pixels: Tensor, camera: Camera, pose: Pose, grid: Grid, board: Board | None = None, shift: np.ndarray | None = None,
) -> Rectified:
    """Return a photograph [C, H, W] on the texels of a grid.

    The filter is `FILTER`: on a texel that is large in the picture all its pixels are averaged, of one that is seen flat as many along each
    side as lie there, so that nothing aliases; where a texel is smaller than a pixel it is interpolated. With a `board` texels that its
    spheres hide are not valid. `shift` [2, 3] is an affine map of the texels, as `register` finds it: row and column of the picture as it is
    without it, by (column, row, 1).
    """
    height, width = grid.shape
    values, valid = torch.empty(len(pixels), height, width), torch.empty(height, width, dtype=torch.bool)
    density = torch.empty(height, width)
    planes = [np.ascontiguousarray(plane) for plane in pixels.float().numpy()]
    for top in range(0, height, _BAND):
        rows = slice(top, min(top + _BAND, height))
        at, jacobian, area = _mapped(grid, camera, pose, rows, shift)
        values[:, rows] = torch.from_numpy(_averaged(planes, at, jacobian, _count(jacobian[..., 0]), _count(jacobian[..., 1])))
        reach = np.abs(jacobian).sum(-1) / 2 + 1
        inside = ((at >= reach) & (at <= np.array(camera.size) - 1 - reach)).all(-1)
        if board is not None:
            inside &= ~_hidden(board, grid.points(rows), pose)
        valid[rows], density[rows] = torch.from_numpy(inside), torch.from_numpy(area.astype(np.float32))
    return Rectified(values, valid, density)


def _mapped(grid: Grid, camera: Camera, pose: Pose, rows: slice, shift: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pixels [h, w, 2] of texels' middles, by how much they move [h, w, 2, 2] with a column (last index 0) and a row, and the
    texels' areas [h, w] in pixels."""
    start, stop, _ = rows.indices(grid.shape[0])
    column, row = np.meshgrid(np.arange(grid.shape[1], dtype=float), np.arange(start, stop, dtype=float))
    move = np.eye(3)[:2] if shift is None else shift

    def at(across: float, down: float) -> np.ndarray:
        moved = np.stack((column + across, row + down), axis=-1) @ move[:, :2].T + move[:, 2]
        step_y, step_x = grid.texel
        x, y = grid.box[0] + (moved[..., 0] + 0.5) * step_x, grid.box[3] - (moved[..., 1] + 0.5) * step_y
        points = np.stack((x, y, np.full(x.shape, grid.height)), axis=-1)
        return np.nan_to_num(pose.project(camera, points), nan=-1e6)

    jacobian = np.stack((at(0.5, 0) - at(-0.5, 0), at(0, 0.5) - at(0, -0.5)), axis=-1)
    return at(0, 0), jacobian, np.abs(np.linalg.det(jacobian))


def _count(step: np.ndarray) -> int:
    """Return how many samples stand along a texel's side, whose steps [h, w, 2] in pixels are these."""
    return int(np.clip(np.ceil(_PER_PIXEL * float(np.linalg.norm(step, axis=-1).max())), _LEAST, _MOST))


def _averaged(planes: list[np.ndarray], at: np.ndarray, jacobian: np.ndarray, columns: int, rows: int) -> np.ndarray:
    """Return the means [C, h, w] of samples spread evenly over each texel."""
    cv2 = opencv()
    total = np.zeros((len(planes), *at.shape[:2]), np.float32)
    for across in (np.arange(columns) + 0.5) / columns - 0.5:
        for down in (np.arange(rows) + 0.5) / rows - 0.5:
            place = (at + jacobian @ np.array([across, down])).astype(np.float32)
            for channel, plane in enumerate(planes):
                total[channel] += cv2.remap(plane, place[..., 0], place[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return total / (columns * rows)


def _hidden(board: Board, points: np.ndarray, pose: Pose) -> np.ndarray:
    """Return from which points [h, w, 3] a sphere hides the camera."""
    view = pose.views(points)
    hidden = np.zeros(points.shape[:2], bool)
    for centre in board.sphere_centres:
        along = ((centre - points) * view).sum(-1)
        beside = ((centre - points) ** 2).sum(-1) - along**2
        hidden |= (along > 0) & (beside < (board.diameter / 2) ** 2)
    return hidden
