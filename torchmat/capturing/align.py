"""How pictures of one pattern under different lights lie to each other: features that lights change little, shifts, and what remains."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from torchmat.capturing.extra import opencv

_FINE, _COARSE = 0.8, 5.0  # texels, standard deviations of the band in which a pattern is looked at
_DARK = 0.05  # of the mean: what is added before the logarithm
_STEPS, _EPSILON = 60, 1e-5
_TILES = 3  # along a side, in which the remaining shift is measured
_CONDITION, _ALIKE = 0.05, 0.3  # of a tile's slopes, and the correlation that it needs
_REACH = 3.0  # texels: a remaining shift beyond it is no shift
IDENTITY = np.eye(3)[:2]


class Alignment(NamedTuple):
    """An affine map [2, 3] from (column, row, 1) to where a picture shows it, and the correlation with and without it."""

    shift: np.ndarray
    before: float
    after: float

    def moves(self, shape: tuple[int, int]) -> float:
        """Return by how many texels, rms over the picture, the map moves."""
        return moved_by(self.shift, shape)


def moved_by(shift: np.ndarray, shape: tuple[int, int]) -> float:
    """Return by how many texels, rms over a picture [h, w], an affine map moves."""
    column, row = np.meshgrid(np.linspace(0, shape[1] - 1, 9), np.linspace(0, shape[0] - 1, 9))
    moved = np.stack((column, row, np.ones_like(row)), axis=-1) @ (shift - IDENTITY).T
    return float(np.sqrt((moved**2).sum(-1).mean()))


def features(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return the pattern [h, w] of a picture [3, h, w]: its logarithm in a band of sizes, brought to one contrast everywhere.

    What light and fall-off do slowly drops out, and a dark place counts as much as a bright one; 0 where it is not `valid`.
    """
    cv2 = opencv()
    grey = values.mean(0)
    logarithm = np.log(np.maximum(grey, 0) + _DARK * max(float(grey[valid].mean()) if valid.any() else 0.0, 1e-6)).astype(np.float32)
    logarithm[~valid] = logarithm[valid].mean() if valid.any() else 0
    band = cv2.GaussianBlur(logarithm, (0, 0), _FINE) - cv2.GaussianBlur(logarithm, (0, 0), _COARSE)
    contrast = np.sqrt(cv2.GaussianBlur(band * band, (0, 0), 2 * _COARSE))
    floor = 0.1 * float(np.median(contrast)) + 1e-6
    found = band / (contrast + floor)
    found[cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0] = 0
    return found


def warped(picture: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return a picture [h, w] as an affine map [2, 3] looks into it; 0 outside."""
    cv2 = opencv()
    size = picture.shape[::-1]
    return cv2.warpAffine(picture, shift, size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Return the correlation of two patterns where both are known; 0 where either has none."""
    both = (first != 0) & (second != 0)
    product = float(np.linalg.norm(first[both]) * np.linalg.norm(second[both]))
    return float((first[both] * second[both]).sum()) / product if product > 0 else 0.0


def align(reference: np.ndarray, picture: np.ndarray, start: np.ndarray = IDENTITY) -> Alignment:
    """Return how a pattern [h, w] lies to a reference: a shift by phase correlation, then an affine map by enhanced correlation (Evangelidis
    and Psarakis 2008), the simplest that is nearly as good."""
    before = correlation(reference, warped(picture, start))
    best = Alignment(start, before, before)
    for guess in (start, _phase(reference, picture)):
        for affine in (False, True):
            shift = _enhanced(reference, picture, guess, affine)
            after = -1.0 if shift is None else correlation(reference, warped(picture, shift))
            if shift is not None and 1 - after**2 < (0.99 if affine else 1.0) * (1 - max(best.after, 0) ** 2) and after > best.after:
                best = Alignment(shift, before, after)
                guess = shift
    return best


def _phase(reference: np.ndarray, picture: np.ndarray) -> np.ndarray:
    cv2 = opencv()
    window = cv2.createHanningWindow(reference.shape[::-1], cv2.CV_32F)
    (across, down), _ = cv2.phaseCorrelate(reference.astype(np.float32), picture.astype(np.float32), window)
    return np.array([[1.0, 0, across], [0, 1, down]])


def _enhanced(reference: np.ndarray, picture: np.ndarray, guess: np.ndarray, affine: bool) -> np.ndarray | None:
    cv2 = opencv()
    kind = cv2.MOTION_AFFINE if affine else cv2.MOTION_TRANSLATION
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _STEPS, _EPSILON)
    known = (picture != 0).astype(np.uint8) * 255
    try:
        _, shift = cv2.findTransformECC(reference, picture, guess.astype(np.float32), kind, stop, known, 1)
    except cv2.error:  # it does not converge where there is nothing in common
        return None
    return shift.astype(np.float64) if np.isfinite(shift).all() else None


def remaining(reference: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Return the shifts [n, 2] (columns, rows) that remain between two patterns, in tiles that have a pattern and are alike.

    One step of Lucas and Kanade (1981) in each of 3 x 3 tiles.
    """
    found = []
    down, across = np.gradient(reference)
    for rows in np.array_split(np.arange(reference.shape[0]), _TILES):
        for columns in np.array_split(np.arange(reference.shape[1]), _TILES):
            part = np.ix_(rows, columns)
            both = (reference[part] != 0) & (picture[part] != 0)
            if both.mean() < 0.5 or correlation(reference[part], picture[part]) < _ALIKE:
                continue
            slopes = np.stack((across[part][both], down[part][both]), axis=1)
            gain = float((picture[part][both] * reference[part][both]).sum() / (reference[part][both] ** 2).sum())
            normal = slopes.T @ slopes
            if np.linalg.eigvalsh(normal)[0] > _CONDITION * np.trace(normal) / 2 and gain > 0:
                found.append(np.linalg.solve(normal, slopes.T @ (reference[part][both] - picture[part][both] / gain)))
    shifts = np.array(found).reshape(-1, 2)
    return shifts[np.abs(shifts).max(1) < _REACH] if len(shifts) else shifts
