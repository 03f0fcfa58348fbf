"""The markers of a board in a photograph: found at the scale that serves, and held to where they lie on the board."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from torchmat.capturing.board import DICTIONARY, PER_SERIES, Board
from torchmat.capturing.extra import opencv

_SIDE = 1600  # pixels along the longer side suffice for markers
_LEVELS = (1.0, 0.5, 0.25, 0.125)  # of that; blurred markers are found where the blur is small
_ENOUGH, LEAST = 8, 3  # markers with which no other scale is tried, and with which a board is known
_TOLERANCE = 0.012  # of the picture's diagonal: what a lens bends
# Other families, and how many of their markers are no chance.
_FOREIGN = {"DICT_4X4_1000": 6, "DICT_6X6_1000": 4, "DICT_7X7_1000": 4, "DICT_ARUCO_ORIGINAL": 6, "DICT_APRILTAG_36h11": 4}


class Markers(NamedTuple):
    """Markers of the board: `which` [m] of each in `Board.marker_ids`, its `pixels` [m, 4, 2], and the homography [3, 3] from millimetres
    to pixels that they agree on; `others` are the ids of what does not belong to it."""

    which: np.ndarray
    pixels: np.ndarray
    homography: np.ndarray | None
    others: np.ndarray


def find_markers(board: Board, grey: np.ndarray) -> Markers:
    """Return the board's markers in a picture [H, W] of 8-bit codes; fewer than `LEAST` mean that it is not there."""
    best = Markers(np.zeros(0, int), np.zeros((0, 4, 2)), None, np.zeros(0, int))
    others = best.others
    start = min(1.0, _SIDE / max(grey.shape))
    scales = [start * level for level in _LEVELS]
    if start < 1:
        scales.insert(1, 1.0)
    for scale in scales:
        found = _belonging(board, *_at_scale(grey, scale, DICTIONARY), _TOLERANCE * float(np.hypot(*grey.shape)))
        others = found.others if len(found.others) > len(others) else others
        best = found if len(found.which) > len(best.which) else best
        if len(best.which) >= _ENOUGH:
            break
    return best._replace(others=others)


def foreign_markers(grey: np.ndarray) -> str:
    """Return of which family a picture shows markers that no board of ours has; "" for none."""
    for name, least in _FOREIGN.items():
        if len(_at_scale(grey, min(1.0, _SIDE / max(grey.shape)), name)[0]) >= least:
            return name.removeprefix("DICT_")
    return ""


def is_mirrored(board: Board, grey: np.ndarray) -> bool:
    """Return whether the board is there when the picture is mirrored."""
    ids, pixels = _at_scale(np.ascontiguousarray(grey[:, ::-1]), min(1.0, _SIDE / max(grey.shape)), DICTIONARY)
    return len(_belonging(board, ids, pixels, _TOLERANCE * float(np.hypot(*grey.shape))).which) > LEAST


@cache
def _detector(name: str):
    aruco = opencv().aruco
    return aruco.ArucoDetector(aruco.getPredefinedDictionary(getattr(aruco, name)))


def _at_scale(grey: np.ndarray, scale: float, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the ids [m] and the corners [m, 4, 2], in pixels of the whole picture, of markers in a smaller one."""
    if scale < 1:
        size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
        small = opencv().resize(grey, size, interpolation=opencv().INTER_AREA)
    else:
        small = grey
    corners, ids, _ = _detector(name).detectMarkers(small)
    if ids is None:
        return np.zeros(0, int), np.zeros((0, 4, 2))
    stretch = np.array(grey.shape[::-1]) / np.array(small.shape[::-1])
    return ids.reshape(-1), (np.stack(corners).reshape(-1, 4, 2) + 0.5) * stretch - 0.5


def _belonging(board: Board, ids: np.ndarray, pixels: np.ndarray, tolerance: float) -> Markers:
    """Return those markers that are called like the board's and lie to each other as they do there."""
    called = np.flatnonzero((ids >= board.marker_ids[0]) & (ids <= board.marker_ids[-1]))
    nothing = Markers(np.zeros(0, int), np.zeros((0, 4, 2)), None, ids)
    if len(called) < LEAST:
        return nothing
    places = board.marker_corners[ids[called] - board.marker_ids[0]]
    homography, inside = opencv().findHomography(places.reshape(-1, 2), pixels[called].reshape(-1, 2), opencv().RANSAC, tolerance)
    good = np.zeros(len(called), bool) if homography is None else inside.reshape(-1, 4).all(1)
    # Chance lets any four points fit: a board that is another one has its markers elsewhere.
    if good.sum() < LEAST or good.sum() < 0.5 * len(called) or np.linalg.det(homography) * homography[2, 2] > 0:
        return nothing
    chosen = called[good]
    return Markers(ids[chosen] - board.marker_ids[0], pixels[chosen], homography, np.delete(ids, chosen))


def series_of(ids: np.ndarray) -> int:
    """Return the series that most of some markers belong to."""
    return int(np.bincount(ids // PER_SERIES).argmax())
