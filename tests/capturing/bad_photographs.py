"""Photographs that cannot be used, made of good ones: each with the word that its reason must hold."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import convolve1d, gaussian_filter
from tests.capturing.shots import Lamp, Lens, Shot, shots_around
from tests.capturing.simulated import Studio, matte_grey

from torchmat.capturing.board import Board
from torchmat.capturing.extra import opencv

GOOD = ""


def photographs_of(board: Board, lens: Lens, count: int, seed: int = 0) -> list[np.ndarray]:
    """Return photographs [H, W, 3] of a board, linear, turned any way."""
    random = np.random.default_rng(seed)
    studio = Studio(matte_grey(0.4), board, lens, (4, 4))
    reach = 1.25 * lens.focal * board.page[1] / lens.size[0]
    shots: list[Shot] = []
    for _ in range(count):
        lamp = Lamp((random.uniform(-200, 200), random.uniform(-200, 200), 500))
        shots += shots_around([random.uniform(0, 45)], [random.uniform(0, 360)], reach, [lamp], roll=random.choice([90, 270]) + random.uniform(-15, 15))
    return [studio.one(shot).linear for shot in shots]


def bad_photographs(good: list[np.ndarray], other: list[np.ndarray], seed: int = 0) -> Iterator[tuple[str, str, np.ndarray]]:
    """Yield without end (what was done, a word of the reason, photograph [H, W, 3] in codes of 8 bits); `other` are of a board of another series."""
    random = np.random.default_rng(seed)
    while True:
        for name, (word, make) in KINDS.items():
            source = other if name == "another series" else good
            picture = make(source[random.integers(len(source))].copy(), random)
            yield name, word, _coded(picture + 0.002 * random.standard_normal(picture.shape))


def _coded(linear: np.ndarray) -> np.ndarray:
    linear = np.clip(linear, 0, 1)
    return np.round(255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)).astype(np.uint8)


def _no_board(picture, random):
    """Things on a table: boxes of any colour, sharp."""
    height, width = picture.shape[:2]
    table = np.full_like(picture, 0.3)
    for _ in range(40):
        top, left = random.integers(height), random.integers(width)
        table[top : top + random.integers(10, height // 3), left : left + random.integers(10, width // 3)] = random.uniform(0.02, 0.9, 3)
    return gaussian_filter(table, (0.6, 0.6, 0))


def _half(picture, random):
    """What is right of the board's middle is cut off, as when the camera is aimed beside it."""
    shift = int(picture.shape[1] * random.uniform(0.45, 0.6)) * random.choice([-1, 1])
    moved = np.full_like(picture, 0.12)
    if shift > 0:
        moved[:, shift:] = picture[:, :-shift]
    else:
        moved[:, :shift] = picture[:, -shift:]
    return moved


def _covered(picture, random):
    """A sheet of paper lies over a part."""
    width = picture.shape[1]
    edge = int(width * random.uniform(0.44, 0.55))
    picture[:, :edge] = random.uniform(0.2, 0.7)
    return picture


def _blurred(picture, random):
    deviation = random.uniform(2.8, 9.0) * max(1.0, np.hypot(*picture.shape[:2]) / 2500)
    return gaussian_filter(picture, (deviation, deviation, 0))


def _moved(picture, random):
    """The camera moved while it took the picture."""
    length = int(random.uniform(12, 25) * max(1.0, np.hypot(*picture.shape[:2]) / 2500))
    return convolve1d(picture, np.full(length, 1 / length), axis=int(random.integers(2)))


def _glare(picture, random):
    rows, columns = np.indices(picture.shape[:2])
    height, width = picture.shape[:2]
    beside = np.hypot(rows - height * random.uniform(0.42, 0.58), columns - width * random.uniform(0.42, 0.58)) / width
    return picture + 6 * np.exp(-((beside / 0.23) ** 2))[..., None]


def _white(picture, random):
    return picture * 40 + random.uniform(0.5, 1)


def _dark(picture, random):
    return picture * random.uniform(0, 5e-4)


def _mirrored(picture, random):
    return picture[:, ::-1]


def _upside_down(picture, random):
    return picture[::-1, ::-1]


def _other_family(picture, random):
    """A usual ChArUco board of 4 x 4 bits, as OpenCV draws it."""
    return _board_of_opencv(picture, opencv().aruco.DICT_4X4_250)


def _elsewhere(picture, random):
    """Markers that are called like ours, in other places: OpenCV's own board of the same family."""
    return _board_of_opencv(picture, opencv().aruco.DICT_5X5_1000)


def _board_of_opencv(picture, family):
    aruco = opencv().aruco
    board = aruco.CharucoBoard((9, 6), 1.0, 0.75, aruco.getPredefinedDictionary(family))
    height, width = picture.shape[:2]
    drawn = board.generateImage((int(width * 0.9), int(height * 0.9)), marginSize=10) / 255.0
    placed = np.full((height, width), 0.12)
    placed[: drawn.shape[0], : drawn.shape[1]] = 0.05 + 0.8 * drawn
    return gaussian_filter(placed, 0.6)[..., None].repeat(3, -1)


KINDS = {
    "no board": ("no board", _no_board),
    "half a board": ("too little of the board", _half),
    "a sheet over it": ("too little of the board", _covered),
    "blurred": ("blurred", _blurred),
    "moved": ("blurred", _moved),
    "glare": ("glare", _glare),
    "over-exposed": ("over-exposed", _white),
    "dark": ("too dark", _dark),
    "mirrored": ("mirrored", _mirrored),
    "another series": ("another board: its markers are of series", lambda picture, random: picture),
    "another family": ("another board: its markers are of the family 4X4", _other_family),
    "another layout": ("another board: its markers lie elsewhere", _elsewhere),
    "upside down": (GOOD, _upside_down),
}
