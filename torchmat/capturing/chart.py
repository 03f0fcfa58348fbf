"""Colour by a ColorChecker Classic: its 24 patches in a photograph, and the matrix that brings them to their true colours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchmat.capturing.develop import develop
from torchmat.capturing.extra import opencv
from torchmat.colour import ciede2000, linear_to_srgb, srgb_to_lab
from torchmat.errors import DataError, ShapeError, message

# CIE L*a*b* (D50, 2 degrees) of the ColorChecker Classic made before November 2014, by row from dark skin (X-Rite; in Pascale 2006).
# Charts made since differ from it by 1 to 2 of CIEDE2000.
_LAB = np.array([
    [37.986, 13.555, 14.059], [65.711, 18.130, 17.810], [49.927, -4.880, -21.925], [43.139, -13.095, 21.905], [55.112, 8.844, -25.399],
    [70.719, -33.397, -0.199], [62.661, 36.067, 57.096], [40.020, 10.410, -45.964], [51.124, 48.239, 16.248], [30.325, 22.976, -21.587],
    [72.532, -23.709, 57.255], [71.941, 19.363, 67.857], [28.778, 14.179, -50.297], [55.261, -38.342, 31.370], [42.101, 53.378, 28.190],
    [81.733, 4.039, 79.819], [51.935, 49.986, -14.574], [51.038, -28.631, -28.638], [96.539, -0.425, 1.186], [81.257, -0.638, -0.335],
    [66.766, -0.734, -0.504], [50.867, -0.153, -0.270], [35.656, -0.421, -1.231], [20.461, -0.079, -0.973],
])
NAMES = (
    "dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green", "orange", "purplish blue", "moderate red", "purple",
    "yellow green", "orange yellow", "blue", "green", "red", "yellow", "magenta", "cyan", "white", "neutral 8", "neutral 6.5", "neutral 5",
    "neutral 3.5", "black",
)
_ROWS, _COLUMNS = 4, 6
_NEUTRAL = slice(18, 23)
_D50 = np.array([0.9642, 1.0, 0.8249])
# XYZ adapted to D50 to linear Rec. 709 (Bradford; the inverse of Lindbloom's sRGB matrix for D50).
_TO_RGB = np.array([[3.1338561, -1.6168667, -0.4906146], [-0.9787684, 1.9161415, 0.0334540], [0.0719453, -0.2289914, 1.4052427]])
_SHARE = 0.4  # of a patch's side that is read
_SAMPLES = 9
_MOST_CLIPPED = 2
_WORST = 6.0  # mean CIEDE2000 after the fit: a camera's own matrix leaves 1 to 3
_UNEVEN = 0.15  # relative spread within a patch
_GIVE = "Give the middles of its corner patches: --chart-corners (chart_corners=...)."
_STEP = "Give the corners again: the middles of dark skin, bluish green, black and white, in this order, as (column, row)."


class Patches(NamedTuple):
    """What a photograph shows of a chart: `colours` [24, 3], linear, which of them are `clipped` [24], and `uneven` [24], the
    relative spread within each."""

    colours: np.ndarray
    clipped: np.ndarray
    uneven: np.ndarray


class Colour(NamedTuple):
    """The `matrix` [3, 3] that brings balanced camera colours to Rec. 709 and leaves white as it is; the `differences` [24] in
    CIEDE2000 that remain, their `mean` and `largest`, those `before` it (white balance alone), and `notes`."""

    matrix: np.ndarray
    differences: np.ndarray
    mean: float
    largest: float
    before: float
    notes: tuple[str, ...]


def reference_colours() -> np.ndarray:
    """Return the chart's colours [24, 3] as linear Rec. 709 under D65, white about 0.9."""
    level = (_LAB[:, :1] + 16) / 116
    f = level + np.column_stack((_LAB[:, 1] / 500, np.zeros(24), -_LAB[:, 2] / 200))
    xyz = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)) * _D50
    return xyz @ _TO_RGB.T


def colour_of_chart(path: str | Path, corners: Sequence[Sequence[float]] | None = None, encoding: str = "auto") -> Colour:
    """Return the matrix that a photograph of a chart tells; `corners` as `read_chart` has them, None searches them.

    Raises DataError or ShapeError, which names the file, where that cannot be.
    """
    developed = develop(path, encoding)
    try:
        places = find_chart(developed.linear) if corners is None else np.asarray(corners, float)
        return fit_colour(read_chart(developed.linear, developed.clipped, places))
    except (DataError, ShapeError) as error:
        raise type(error)(f"{path}: {error}") from error


def find_chart(linear: Tensor) -> np.ndarray:
    """Return the middles [4, 2] (column, row) of the corner patches of a chart in a photograph [3, H, W], found by OpenCV.

    In the order dark skin, bluish green, black, white. Raises DataError when none is found, or OpenCV has no such search.
    """
    cv2 = opencv()
    if not hasattr(cv2, "mcc"):
        fact, step = f"OpenCV {cv2.__version__} has no search for charts", _GIVE
        raise DataError(message("capture", "the chart", "be found", fact, step))
    codes = (linear_to_srgb(linear.clamp(0, 1)) * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()
    picture = np.ascontiguousarray(codes[..., ::-1])
    detector = cv2.mcc.CCheckerDetector_create()
    if hasattr(detector, "setColorChartType"):  # OpenCV 5
        detector.setColorChartType(cv2.mcc.MCC24)
        found = detector.process(picture, 1)
    else:
        found = detector.process(picture, cv2.mcc.MCC24, 1)
    checkers = detector.getListColorChecker() if found else []
    if not len(checkers):
        raise DataError(message("capture", "the chart", "be found in its photograph", "no ColorChecker Classic is seen", _GIVE))
    middles = np.asarray(checkers[0].getColorCharts(), dtype=float).reshape(24, 4, 2).mean(1)
    return middles[[0, 5, 23, 18]]


def read_chart(linear: Tensor, clipped: Tensor, corners: np.ndarray) -> Patches:
    """Return the patches of a chart in a photograph [3, H, W]; `corners` [4, 2] are the middles of its corner patches.

    Each (column, row), in the order dark skin, bluish green, black, white. Raises DataError when they leave the photograph.
    """
    corners = np.asarray(corners, float)
    if corners.shape != (4, 2):
        raise ShapeError(message("capture", "the chart's corners", "be four points", f"their shape is {corners.shape}", _STEP))
    height, width = linear.shape[-2:]
    row, column = (one.ravel() for one in np.indices((_ROWS, _COLUMNS)))
    offset = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    v, u = (one.ravel() * _SHARE for one in np.meshgrid(offset, offset, indexing="ij"))
    places = _by_corners(corners, column[:, None] + u, row[:, None] + v)  # [24, samples, 2]
    if not ((places >= 0) & (places <= np.array([width, height]) - 1)).all():
        fact = f"they are {corners.round().tolist()} in {width} x {height}"
        raise DataError(message("capture", "the chart's corners", "lie in its photograph", fact, _STEP))
    x, y = np.round(places).astype(int).reshape(-1, 2).T
    values = linear.numpy()[:, y, x].reshape(3, 24, -1)
    spread = 1.4826 * np.median(np.abs(values - np.median(values, axis=2, keepdims=True)), axis=2)
    middle = np.median(values, axis=2)
    uneven = (spread / np.maximum(middle, 0.02)).max(0)
    return Patches(middle.T.astype(float), clipped.numpy()[y, x].reshape(24, -1).mean(1) > 0.05, uneven)


def _by_corners(corners: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Return the pixels of places on the chart, 0 to 5 across and 0 to 3 down, by the homography of its corner patches."""
    plane = np.array([[0, 0], [_COLUMNS - 1, 0], [_COLUMNS - 1, _ROWS - 1], [0, _ROWS - 1]], float)
    rows = []
    for (x, y), (u, v) in zip(plane, corners, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, u], [0, 0, 0, x, y, 1, -v * x, -v * y, v]]
    system = np.array(rows)
    try:
        numbers = np.linalg.solve(system[:, :8], system[:, 8])
    except np.linalg.LinAlgError as error:
        raise DataError(message("capture", "the chart's corners", "span a quadrilateral", f"they are {corners.tolist()}", _STEP)) from error
    mapped = np.stack((column, row, np.ones_like(column)), axis=-1) @ np.append(numbers, 1.0).reshape(3, 3).T
    return mapped[..., :2] / mapped[..., 2:]


def fit_colour(patches: Patches) -> Colour:
    """Return the matrix that brings a chart's patches to their true colours.

    The neutral patches give the balance; then least squares in linear light, each patch weighted as lightness is (Y^(-2/3)),
    over the matrices whose rows sum to 1, so that white stays white. Raises DataError for a chart that is turned, clipped on
    more than two patches, unevenly lit within its patches, or left with a mean CIEDE2000 above 6.
    """
    true, good = reference_colours(), ~patches.clipped
    if (~good).sum() > _MOST_CLIPPED or not good[_NEUTRAL].any():
        names = [name for name, fine in zip(NAMES, good, strict=True) if not fine]
        fact = f"{len(names)} are: {', '.join(names)}"
        raise DataError(message("capture", "the chart's patches", "not be clipped", fact, "Expose the chart less."))
    matrix, off, before = _matrix(patches.colours, true, good)
    for name, order in _turned().items():
        other = _matrix(patches.colours[order], true, good[order])[1]
        if other[good[order]].mean() < 0.5 * off[good].mean():
            fact = f"{name} it fits with {other[good[order]].mean():.1f} of CIEDE2000 in place of {off[good].mean():.1f}"
            raise DataError(message("capture", "the chart's corners", "start at dark skin", fact, _STEP))
    mean = float(off[good].mean())
    if not mean < _WORST:
        worst = NAMES[int(np.where(good, off, -1).argmax())]
        fact = f"{mean:.1f} of CIEDE2000 remain on average, most at {worst}"
        step = "Check that it is a ColorChecker Classic, its corners, and that no glare lies on it."
        raise DataError(message("capture", "the chart", f"fit within {_WORST:g}", fact, step))
    notes = [f"the patch {name!r} is clipped: left out" for name, fine in zip(NAMES, good, strict=True) if not fine]
    spread = float(np.median(patches.uneven))
    if spread > _UNEVEN:
        notes.append(f"the patches vary by {100 * spread:.0f} % within: glare, noise or wrong corners")
    return Colour(matrix, off, mean, float(off[good].max()), before, tuple(notes))


def _matrix(colours: np.ndarray, true: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the matrix, the differences [24] that it leaves, and the mean one without it."""
    neutral = np.zeros(24, bool)
    neutral[_NEUTRAL] = True
    used = neutral & good
    gains = (true[used] ** 2).sum(0) / np.maximum((colours[used] * true[used]).sum(0), 1e-9)
    balanced = colours * gains
    weight = np.where(good, np.maximum(true @ [0.2126, 0.7152, 0.0722], 0.01) ** (-2 / 3), 0)[:, None]
    free = np.array([[1.0, 1.0], [-1.0, 1.0], [0.0, -2.0]]) / np.sqrt([2, 6])  # what leaves a row's sum
    rows = [
        np.eye(3)[c] + free @ np.linalg.lstsq(weight * (balanced @ free), weight[:, 0] * (true[:, c] - balanced[:, c]), rcond=None)[0] for c in range(3)
    ]
    matrix = np.stack(rows)
    return matrix, _differences(balanced @ matrix.T, true), float(_differences(balanced, true)[good].mean())


def _differences(colours: np.ndarray, true: np.ndarray) -> np.ndarray:
    labs = [srgb_to_lab(linear_to_srgb(torch.from_numpy(one.T[:, :, None]).clamp(0, 1))) for one in (colours, true)]
    return ciede2000(*labs)[:, 0].numpy()


def _turned() -> dict[str, np.ndarray]:
    places = np.arange(24).reshape(_ROWS, _COLUMNS)
    return {"turned by 180 degrees": places[::-1, ::-1].ravel(), "mirrored": places[:, ::-1].ravel(), "upside down": places[::-1].ravel()}
