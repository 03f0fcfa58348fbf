"""Corners as a detection would find them, without pictures: projected by the studio's own lens, with errors of a known size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tests.capturing.shots import Lamp, Lens, Shot, shots_around
from tests.capturing.simulated import Studio, matte_grey

from torchmat.capturing.board import Board
from torchmat.capturing.detect import Detection
from torchmat.capturing.photographs import Photograph
from torchmat.images import Exif

BOARD = Board()


def seen_from(shots: list[Shot], noise: float = 0.15, lens: Lens = Lens(), focal_35: float | None = None, seed: int = 0):
    """Return the photographs, of which nothing is read, and the detections of shots; `noise` in pixels an axis."""
    random, studio = np.random.default_rng(seed), Studio(matte_grey(), BOARD, lens, (2, 2))
    photographs, detections = [], []
    for number, shot in enumerate(shots):
        pixels = studio.pixels_of(shot, np.column_stack((BOARD.corners, np.zeros(len(BOARD.corners)))))
        pixels = pixels + noise * random.standard_normal(pixels.shape)
        inside = ((pixels > 0) & (pixels < np.array(lens.size) - 1)).all(1)
        detections.append(Detection(np.flatnonzero(inside), pixels[inside], 0.6))
        exif = Exif(lens.size, 1, "", None, focal_35, None, None, None)
        photographs.append(Photograph(Path(f"photo_{number}.jpg"), lens.size, 0, exif, None))
    return photographs, detections


def around(count: int, least: float, most: float, seed: int = 0, **more) -> list[Shot]:
    """Return shots from random directions between two polar angles in degrees, 400 mm away."""
    random = np.random.default_rng(seed)
    return shots_around(list(random.uniform(least, most, count)), list(random.uniform(0, 360, count)), 400, [Lamp((0, 0, 400))] * count, **{"roll": 90, **more})


def degrees_apart(first: np.ndarray, second: np.ndarray) -> float:
    """Return the angle between two vectors [3]."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second)), np.dot(first, second))))
