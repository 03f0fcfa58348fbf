"""What lens and lamp do to even light: vignetting that all photographs share, and light that is stronger to one side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import RangeError, message

_ORDERS = 3  # r^2, r^4, r^6
_DEGREE = 4  # of a flat field's polynomial
_BLOCKS = 48  # along the longer side of a flat field
_ROUNDS = 12
_TUKEY = 4.0
_REACH = 0.55  # of the half diagonal that the paper must reach, or vignetting is not looked for


@dataclass(frozen=True, eq=False)
class Vignetting:
    """How bright each place of a sensor shows even light, 1 in its middle: exp of even powers of the radius, or of a polynomial.

    `size` is (width, height); `powers` [m, 2] are exponents of column and row, from the middle in half diagonals, `radial`
    says that they are of the radius instead (`powers` [m, 1]); `weights` [m]. `sigma` is the standard error in the corner,
    relative, and `how` says what it was found from.
    """

    size: tuple[int, int]
    weights: np.ndarray
    radial: bool
    sigma: float
    how: str

    def at(self, pixels: np.ndarray) -> np.ndarray:
        """Return the brightness [...] at pixels [..., 2] (column, row)."""
        return np.exp(_terms(self.size, pixels, self.radial) @ self.weights)

    @property
    def corner(self) -> float:
        """The mean brightness of the four corners."""
        right, bottom = self.size[0] - 1.0, self.size[1] - 1.0
        return float(self.at(np.array([[0.0, 0], [right, 0], [0, bottom], [right, bottom]])).mean())

    def taken_out(self, planes: Tensor) -> Tensor:
        """Return a photograph [..., H, W] as it would be under even light; raises RangeError for one of another size."""
        width, height = self.size
        if tuple(planes.shape[-2:]) != (height, width):
            fact = f"it is {planes.shape[-2]} x {planes.shape[-1]}, the flat field {height} x {width}"
            raise RangeError(message("vignetting", "the photograph", "have the size of the flat field", fact, "Use one camera and format."))
        # Smooth: known at every eighth pixel, it is known between them.
        columns, rows = (np.linspace(0, side - 1, max(2, side // 8)) for side in (width, height))
        coarse = self.at(np.stack(np.meshgrid(columns, rows), axis=-1))
        shade = torch.nn.functional.interpolate(torch.from_numpy(coarse)[None, None], (height, width), mode="bilinear", align_corners=True)
        return planes / shade[0, 0].to(planes.dtype)


def _terms(size: tuple[int, int], pixels: np.ndarray, radial: bool) -> np.ndarray:
    away = (pixels - (np.array(size) - 1) / 2) / (np.hypot(*size) / 2)
    if radial:
        square = (away**2).sum(-1)
        return np.stack([square**order for order in range(1, _ORDERS + 1)], axis=-1)
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i) if i + j > 0]
    return np.stack([away[..., 0] ** i * away[..., 1] ** j for i, j in powers], axis=-1)


def flat_field(linear: Tensor, clipped: Tensor) -> Vignetting:
    """Return the vignetting that a photograph [3, H, W] of evenly lit white shows, as a polynomial of degree 4 of its logarithm.

    Raises RangeError when it is clipped, dark, or no even white (more than a tenth of it deviates by more than 5 %).
    """
    height, width = clipped.shape
    if float(clipped.float().mean()) > 0.001:
        raise RangeError(message("flat field", "the photograph", "not be clipped", f"{float(clipped.float().mean()):.1%} is", "Expose less."))
    step = max(1, max(height, width) // _BLOCKS)
    rows, columns = height // step, width // step
    blocks = linear.mean(0)[: rows * step, : columns * step].reshape(rows, step, columns, step).double().mean((1, 3)).numpy()
    centres = [np.arange(count) * step + (step - 1) / 2 for count in (columns, rows)]
    pixels = np.stack(np.meshgrid(*centres), axis=-1).reshape(-1, 2)
    level = blocks.ravel()
    if level.min() < 0.02:
        raise RangeError(message("flat field", "the photograph", "be of lit white", f"its darkest part is {level.min():.3g}", "Expose more."))
    design = np.column_stack((np.ones(len(level)), _terms((width, height), pixels, False)))
    weights, _, off = _robust(design, np.log(level))
    share = float((np.abs(off) > 0.05).mean())
    if share > 0.1:
        fact, hint = f"{share:.0%} of it deviates from a smooth course by more than 5 %", "Photograph bare paper, out of focus, in even light."
        raise RangeError(message("flat field", "the photograph", "be of even white", fact, hint))
    return Vignetting((width, height), weights[1:], False, float(off.std() / np.sqrt(len(off) / design.shape[1])), "a flat field")


def _robust(design: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return weights, their covariance and residuals of least squares with Tukey's weights."""
    trust = np.ones(len(target))
    for _ in range(_ROUNDS):
        normal = design.T @ (trust[:, None] * design)
        found = np.linalg.solve(normal + 1e-12 * np.trace(normal) * np.eye(len(normal)), design.T @ (trust * target))
        off = target - design @ found
        spread = max(1.4826 * float(np.median(np.abs(off))), 1e-6)
        trust = np.clip(1 - (off / (_TUKEY * spread)) ** 2, 0, 1) ** 2
    return found, np.linalg.inv(normal + 1e-12 * np.trace(normal) * np.eye(len(normal))) * spread**2, off


@dataclass(frozen=True, eq=False)
class Course:
    """How the paper of one photograph is lit beside what its lamp explains: `slope` [2] per mm of the logarithm along x and y,
    `level` [3] the values of white paper in the window's middle across the light, and the relative rms `residual`."""

    level: np.ndarray
    slope: np.ndarray
    residual: float

    def at(self, points: np.ndarray) -> np.ndarray:
        """Return by what the light at points [..., 3] is stronger than the lamp alone explains, 1 in the middle."""
        return np.exp(points[..., :2] @ self.slope)


def fit_courses(
    size: tuple[int, int], points: Sequence[np.ndarray], pixels: Sequence[np.ndarray], values: Sequence[np.ndarray], expected: Sequence[np.ndarray],
    known: Vignetting | None = None, sloped: bool = True,
) -> tuple[list[Course], Vignetting | None]:
    """Return how each photograph's paper is lit, and the vignetting that all share (None where the paper does not reach far enough).

    The logarithm of a photograph's paper is a_j + g_j . (x, y) + v1 r^2 + v2 r^4 + v3 r^6 beside the irradiance that its lamp
    explains: a level and a slope of each photograph, and one course of the radius, by robust least squares together. What
    differs from photograph to photograph is the lamp's, what stays on the sensor the lens's.

    Args:
        size: width and height of the photographs.
        points, pixels: where in mm [n_j, 3] and on the sensor [n_j, 2] each photograph shows white paper.
        values: the light [n_j, 3] that comes from there.
        expected: the irradiance [n_j] there by the lamp, 1 in the window's middle across the light.
        known: vignetting that is known; it is then divided out, and none is looked for.
        sloped: whether light may be stronger to one side.
    """
    counts = [len(one) for one in points]
    where = np.repeat(np.arange(len(counts)), counts)
    place, pixel = np.concatenate(points), np.concatenate(pixels)
    grey = np.concatenate([np.log(np.maximum(one.mean(1), 1e-6)) - np.log(np.maximum(e, 1e-6)) for one, e in zip(values, expected, strict=True)])
    shared = np.zeros((len(grey), 0))
    if known is not None:
        grey = grey - np.log(known.at(pixel))
    elif np.sqrt(_terms(size, pixel, True)[:, 0].max(initial=0)) > _REACH:
        shared = _terms(size, pixel, True)
    own = np.column_stack((np.ones(len(grey)), place[:, :2] / 100)) if sloped else np.ones((len(grey), 1))
    design = np.zeros((len(grey), len(counts) * own.shape[1] + shared.shape[1]))
    for column in range(own.shape[1]):
        design[np.arange(len(grey)), where * own.shape[1] + column] = own[:, column]
    design[:, len(counts) * own.shape[1] :] = shared
    found, covariance, off = _robust(design, grey)
    vignetting = known
    if shared.shape[1]:
        weights = found[-_ORDERS:]
        corner = np.ones(_ORDERS)  # r = 1
        # Neighbouring points share their errors: about one in nine counts.
        sigma = float(np.sqrt(corner @ covariance[-_ORDERS:, -_ORDERS:] @ corner * 9))
        vignetting = Vignetting(size, weights, True, sigma, "the board's white paper")
    courses = []
    for number, count in enumerate(counts):
        mine = where == number
        part = found[number * own.shape[1] : (number + 1) * own.shape[1]]
        slope = part[1:] / 100 if sloped else np.zeros(2)
        even = np.log(np.maximum(values[number], 1e-6)) - (grey - off)[mine][:, None] - np.log(np.maximum(expected[number], 1e-6))[:, None] + part[0]
        if known is not None:
            even = even - np.log(known.at(pixels[number]))[:, None]
        near = np.abs(off[mine]) < 3 * max(1.4826 * float(np.median(np.abs(off[mine]))), 1e-6)
        level = np.exp(np.median(even[near], axis=0)) if count else np.full(3, np.nan)
        courses.append(Course(level, slope, float(np.sqrt(np.mean(off[mine][near] ** 2)))))
    return courses, vignetting
