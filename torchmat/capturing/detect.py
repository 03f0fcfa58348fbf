"""Where the board's corners are in a photograph, or in words why it cannot be used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchmat.capturing.board import MARKER, Board
from torchmat.capturing.extra import opencv
from torchmat.capturing.markers import LEAST, Markers, find_markers, foreign_markers, is_mirrored, series_of
from torchmat.capturing.photographs import grey_codes

_FEWEST, _COVERED = 12, 0.75  # corners, and the share of the window that they must surround
_WINDOW = (0.095, 2, 12)  # of a square, and pixels: half the side of what a corner is refined in; a marker begins at 0.125
_RING = 0.1  # of a square: where it is checked that black and white alternate around a corner
_ALIKE, _CONTRAST = 0.8, 12.0  # correlation and codes of that
_BLUR, _BLUR_SHARE = 2.0, 8e-4  # pixels, and of the diagonal: the largest standard deviation of an edge
_WHITE, _WASHED, _GLARE = 0.995, 0.4, 0.12  # linear value that is over-exposed; shares of a picture and of a board that are too much
_DARK = 0.004
_BLOCK, _HIGH = 32, 0.4  # pixels, and the share of a picture's range that makes an edge a high one
_TEN_TO_NINETY = 2.563  # widths of an edge in its standard deviations


@dataclass(frozen=True, eq=False)
class Detection:
    """What a photograph shows of the board.

    Args:
        corners: [k], which of `Board.corners` are seen.
        pixels: [k, 2], column and row of each.
        blur: standard deviation of edges in pixels; NaN where none were seen.
        reason: why the photograph cannot be used; "" where it can.
    """

    corners: np.ndarray
    pixels: np.ndarray
    blur: float
    reason: str = ""


def detect(board: Board, linear: Tensor, clipped: Tensor | None = None) -> Detection:
    """Return what a photograph shows of the board, however it is turned.

    Args:
        board: the board.
        linear: the photograph [3, H, W], linear.
        clipped: bool [H, W], which of its pixels are over-exposed; None takes those that are white.
    """
    if min(linear.shape[-2:]) < 64:
        return _nothing(f"it is {linear.shape[-1]} x {linear.shape[-2]} pixels")
    clipped = (linear >= _WHITE).all(0) if clipped is None else clipped
    grey = grey_codes(linear)
    markers = find_markers(board, grey)
    if markers.homography is None:
        return _nothing(_why_no_board(board, linear, clipped, grey, markers))
    index, pixels = _corners(board, grey, markers)
    blur = _blur(board, grey, index, pixels, markers.homography)
    return Detection(index, pixels, blur, _why_not(board, clipped, markers, index, blur))


def _nothing(reason: str) -> Detection:
    return Detection(np.zeros(0, int), np.zeros((0, 2)), np.nan, reason)


def _why_no_board(board: Board, linear: Tensor, clipped: Tensor, grey: np.ndarray, markers: Markers) -> str:
    washed = float(clipped.float().mean())
    if washed > _WASHED:
        return f"over-exposed: {washed:.0%} of the picture is white"
    small = torch.nn.functional.avg_pool2d(linear.amax(0)[None], 8)  # without its noise
    if float((small > _DARK).float().mean()) < 0.01:
        return f"too dark: 99% of it is below {_DARK:.1%} of white"
    if len(markers.others) >= LEAST:
        ours = series_of(markers.others) == board.series
        return "another board: its markers lie elsewhere" if ours else f"another board: its markers are of series {series_of(markers.others)}"
    if is_mirrored(board, grey):
        return "mirrored: the board is there when it is turned over"
    family = foreign_markers(grey)
    if family:
        return f"another board: its markers are of the family {family}"
    blur, limit = _sharpest(grey), _blur_limit(grey)
    if blur > limit:
        return f"blurred: the sharpest edges are {blur * _TEN_TO_NINETY:.0f} pixels wide, and no marker is seen"
    return "no board: no marker of it is seen"


def _why_not(board: Board, clipped: Tensor, markers: Markers, index: np.ndarray, blur: float) -> str:
    limit = _blur_limit(clipped)
    covered = _covered(board, board.corners[index])
    if blur > limit:
        return f"blurred: edges are {blur * _TEN_TO_NINETY:.0f} pixels wide, and {limit * _TEN_TO_NINETY:.0f} would do"
    if len(index) >= _FEWEST and covered >= _COVERED:
        return ""
    washed = _washed(board, clipped, markers)
    if washed > _GLARE:
        return f"glare: {washed:.0%} of the board is over-exposed, {len(index)} of {len(board.corners)} corners are seen"
    return f"too little of the board: {len(index)} of {len(board.corners)} corners are seen, around {covered:.0%} of the window"


def _blur_limit(picture: np.ndarray | Tensor) -> float:
    return max(_BLUR, _BLUR_SHARE * float(np.hypot(*picture.shape)))


def _sharpest(grey: np.ndarray) -> float:
    """Return the standard deviation in pixels of a picture's sharp edges, the larger one across and along it; 0 where it has none.

    The height of an edge over its steepest slope, as in `_edge_widths`, in each block that is crossed by a high one.
    """
    height, width = (side // _BLOCK * _BLOCK for side in grey.shape)
    codes = grey[:height, :width].astype(np.float32)
    high = _HIGH * float(np.subtract(*np.percentile(codes, (99, 1))))
    found = []
    for picture in (codes, codes.T):
        blocks = picture.reshape(picture.shape[0] // _BLOCK, _BLOCK, -1, _BLOCK)
        heights = (blocks.max(3) - blocks.min(3)).max(1)
        slopes = np.abs(np.diff(blocks, axis=3)).max((1, 3))
        edges = (heights > max(high, _CONTRAST)) & (slopes > 0)
        found.append(float(np.median(heights[edges] / slopes[edges])) / np.sqrt(2 * np.pi) if edges.any() else 0.0)
    return max(found)


def _covered(board: Board, places: np.ndarray) -> float:
    """Return which share of the window places [k, 2] surround."""
    if len(places) < 3:
        return 0.0
    left, bottom, right, top = board.window
    window = np.array([[left, bottom], [right, bottom], [right, top], [left, top]], np.float32)
    hull = opencv().convexHull(places.astype(np.float32))
    area = opencv().intersectConvexConvex(hull, window)[0] if len(hull) > 2 else 0.0
    return area / ((right - left) * (top - bottom))


def _washed(board: Board, clipped: Tensor, markers: Markers) -> float:
    """Return which share of the board around the window, as far as it is in the picture, is over-exposed."""
    reach = np.abs(board.corners).max(0)
    x, y = np.meshgrid(np.linspace(-reach[0], reach[0], 60), np.linspace(-reach[1], reach[1], 80))
    outside = (np.abs(x) > board.window[2]) | (np.abs(y) > board.window[3])
    assert markers.homography is not None
    pixels = np.round(_moved(markers.homography, np.stack((x[outside], y[outside]), axis=1))).astype(int)
    height, width = clipped.shape
    pixels = pixels[(pixels >= 0).all(1) & (pixels < (width, height)).all(1)]
    return float(clipped[pixels[:, 1], pixels[:, 0]].float().mean()) if len(pixels) else 0.0


def _moved(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return where a homography [..., 3, 3] takes points [..., 2]."""
    moved = (homography[..., :2] @ points[..., None])[..., 0] + homography[..., 2]
    return moved[..., :2] / moved[..., 2:]


def _corners(board: Board, grey: np.ndarray, markers: Markers) -> tuple[np.ndarray, np.ndarray]:
    """Return which corners are seen, [k], and their pixels [k, 2]: each is looked for beside the markers that touch its squares."""
    rim = (1 - MARKER) / 2 * board.square
    away = np.abs(board.corners[:, None, None] - board.marker_corners[None, markers.which])  # [corner, marker, 4, 2]
    beside = (np.abs(away - rim) < 1e-6 * board.square).all(-1).any(-1)
    index = np.flatnonzero(beside.any(1))
    if not len(index):
        return index, np.zeros((0, 2))
    own = _four_point_homographies(board.marker_corners[markers.which], markers.pixels)
    guesses = np.stack([_moved(own[beside[one]], board.corners[one]).mean(0) for one in index])
    across = _jacobians(board, markers, board.corners[index])
    sizes = _half_windows(board, across)
    refined = guesses.astype(np.float32)
    cv2 = opencv()
    inside = _within(guesses, grey.shape, sizes + 2)
    for size in np.unique(sizes[inside]):
        chosen = inside & (sizes == size)
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
        refined[chosen] = cv2.cornerSubPix(grey, refined[chosen][:, None].copy(), (int(size), int(size)), (-1, -1), stop)[:, 0]
    kept = inside & (np.abs(refined - guesses).max(1) < 1.5 * sizes + 1)
    kept &= _alternates(board, grey, index, refined, across)
    return index[kept], refined[kept].astype(np.float64)


def _four_point_homographies(places: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the homographies [m, 3, 3] that take four places [m, 4, 2] to four pixels each."""
    x, y, u, v = places[..., 0], places[..., 1], pixels[..., 0], pixels[..., 1]
    one, zero = np.ones_like(x), np.zeros_like(x)
    rows = np.concatenate((
        np.stack((x, y, one, zero, zero, zero, -u * x, -u * y), axis=-1), np.stack((zero, zero, zero, x, y, one, -v * x, -v * y), axis=-1),
    ), axis=1)
    found = np.linalg.solve(rows, np.concatenate((u, v), axis=1)[..., None])[..., 0]
    return np.concatenate((found, np.ones((len(found), 1))), axis=1).reshape(-1, 3, 3)


def _jacobians(board: Board, markers: Markers, places: np.ndarray) -> np.ndarray:
    """Return by how many pixels [k, 2, 2] the picture moves with a square's side to the right (first) and up at places in mm."""
    assert markers.homography is not None
    steps = board.square / 2 * np.array([[1, 0], [0, 1]])
    return np.stack([_moved(markers.homography, places + step) - _moved(markers.homography, places - step) for step in steps], axis=1)


def _half_windows(board: Board, across: np.ndarray) -> np.ndarray:
    share, least, most = _WINDOW
    height = np.abs(np.linalg.det(across)) / np.linalg.norm(across, axis=-1).max(1)
    return np.clip(np.floor(share * height), least, most).astype(int)


def _within(pixels: np.ndarray, shape: tuple[int, ...], margin: np.ndarray) -> np.ndarray:
    limits = np.array(shape[::-1]) - 1 - margin[:, None]
    return ((pixels >= margin[:, None]) & (pixels <= limits)).all(1)


def _alternates(board: Board, grey: np.ndarray, index: np.ndarray, pixels: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return around which pixels black and white alternate as the board has them."""
    angles = np.radians([quarter + within for quarter in (0, 90, 180, 270) for within in (25, 45, 65)])
    ring = _RING * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    values = _sampled(grey, pixels[:, None] + ring @ across)
    wanted = board.corner_signs[index, None] * np.sign(ring[:, 0] * ring[:, 1])
    centred = values - values.mean(1, keepdims=True)
    length = np.linalg.norm(centred, axis=1)
    return ((centred * wanted).sum(1) > _ALIKE * length * np.sqrt(len(angles))) & (length > _CONTRAST * np.sqrt(len(angles)) / 2)


def _sampled(grey: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the picture, between its pixels, at pixels [n, m, 2]."""
    maps = pixels.astype(np.float32)
    cv2 = opencv()
    return cv2.remap(grey, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)


def _blur(board: Board, grey: np.ndarray, index: np.ndarray, pixels: np.ndarray, homography: np.ndarray) -> float:
    """Return the standard deviation, in pixels, of edges between squares: the larger of the two ways that edges run."""
    places, found = (board.corners[index], pixels) if len(index) >= _FEWEST else (board.corners, _moved(homography, board.corners))
    widths = []
    for step in board.square * np.array([[1.0, 0], [0, 1]]):
        apart = np.abs(places[:, None] + step - places[None]).max(-1) < 1e-6 * board.square
        first, second = np.nonzero(apart)
        if not len(first):
            continue
        middle, along = (found[first] + found[second]) / 2, found[second] - found[first]
        # Across the edge: what the other way of the board is in the picture.
        other = _moved(homography, places[first] + step[::-1]) - _moved(homography, places[first])
        inner = _within(middle, grey.shape, np.full(len(middle), 3))
        widths.append(_edge_widths(grey, middle[inner], along[inner], other[inner]))
    known = [float(np.median(some)) for some in widths if len(some)]
    return max(known, default=np.nan)


def _edge_widths(grey: np.ndarray, middle: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return the standard deviations [n], in pixels, of edges: their height over their steepest slope (of a normal distribution's integral)."""
    normal = np.stack((-along[:, 1], along[:, 0]), axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    height = np.abs((normal * across).sum(1))  # of a square, in pixels
    steps = np.linspace(-0.4, 0.4, 65)
    values = _sampled(grey, middle[:, None] + steps[:, None] * height[:, None, None] * normal[:, None])
    near = np.abs(steps) <= 0.11
    slope = np.abs(np.diff(values[:, near], axis=1)).max(1) / ((steps[1] - steps[0]) * height)
    return (values.max(1) - values.min(1)) / np.maximum(slope, 1e-9) / np.sqrt(2 * np.pi)
