"""What photographs show of the board's paper: where it is white or a patch, and the light that comes from there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates, maximum_filter

from torchmat.capturing.board import WHITE, Board
from torchmat.capturing.light import blocked
from torchmat.capturing.view import Camera, Pose

_SPACING = 2.0  # mm between points
_MARGIN = 0.9  # mm that they keep from print, and _EDGE from the paper's edge: blur and a paper that curls
_EDGE = 4.0
_INSET = 0.15  # of a patch's side
_ROOM = 1.0  # diameters around a sphere's middle, in which its reflections lie


class Reading(NamedTuple):
    """What a photograph shows at points of the board: `values` [n, 3], linear, and which are to be trusted (`good` [n]): in the
    picture, not hidden by a sphere, not clipped."""

    values: np.ndarray
    good: np.ndarray
    pixels: np.ndarray


def white_points(board: Board) -> np.ndarray:
    """Return points [n, 3] in mm, on a grid, at which the board shows bare paper, away from print, window and spheres."""
    width, height = (side * board.scale / 2 - _EDGE for side in board.page)
    x, y = np.meshgrid(np.arange(-width, width, _SPACING), np.arange(-height, height, _SPACING))
    x, y = x.ravel(), y.ravel()
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    around_x, around_y = x + _MARGIN * np.cos(turn)[:, None], y + _MARGIN * np.sin(turn)[:, None]
    white = (board.reflectance(x, y) == np.float32(WHITE)) & (board.reflectance(around_x, around_y) == np.float32(WHITE)).all(0)
    left, bottom, right, top = board.window
    white &= ~((x > left - _MARGIN) & (x < right + _MARGIN) & (y > bottom - _MARGIN) & (y < top + _MARGIN))
    for centre in board.sphere_centres:
        white &= np.hypot(x - centre[0], y - centre[1]) > _ROOM * board.diameter
    return np.stack((x[white], y[white], np.zeros(int(white.sum()))), axis=1)


def patch_points(board: Board, name: str) -> np.ndarray:
    """Return points [patch, n, 3] in mm on the patches "white" or "grey", away from their edges."""
    boxes = board.patches[name]
    share = np.linspace(_INSET, 1 - _INSET, 12)
    u, v = (one.ravel() for one in np.meshgrid(share, share))
    x = boxes[:, :1] + (boxes[:, 2:3] - boxes[:, :1]) * u
    y = boxes[:, 1:2] + (boxes[:, 3:4] - boxes[:, 1:2]) * v
    return np.stack((x, y, np.zeros_like(x)), axis=-1)


def sample_points(board: Board, count: int) -> np.ndarray:
    """Return count x count points [n, 3] in mm in the largest square of the window, away from its rim, in rows from the top."""
    left, bottom, right, top = board.window
    half = min(right - left, top - bottom) / 2 - _EDGE / 2
    place = ((np.arange(count) + 0.5) / count * 2 - 1) * half
    x, y = np.meshgrid(place, -place)
    return np.stack((x.ravel(), y.ravel(), np.zeros(count**2)), axis=1)


def read_paper(
    linear: np.ndarray, clipped: np.ndarray, camera: Camera, pose: Pose, points: np.ndarray, spheres: np.ndarray, radius: float
) -> Reading:
    """Return what a photograph `linear` [3, H, W] shows at points [n, 3] in mm; `spheres` [m, 3] of a `radius` may hide some."""
    pixels = pose.project(camera, points)
    height, width = clipped.shape
    inside = np.asarray(((pixels >= 1) & (pixels <= np.array([width, height]) - 2)).all(axis=1))
    places = np.where(inside[:, None], pixels, 1.0)
    values = np.stack([map_coordinates(plane, places.T[::-1], order=1, output=np.float64) for plane in linear], axis=1)
    row, column = np.round(places.T[::-1]).astype(int)
    full: np.ndarray = maximum_filter(clipped, size=3)
    hidden = blocked(points, pose.views(points), spheres, radius)
    return Reading(values, inside & ~full[row, column] & ~hidden, pixels)
