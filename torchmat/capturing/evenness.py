"""What lens and lamp do to even light: vignetting that all photographs share, and light that is stronger to one side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchmat.capturing.sheen import Sheen, find_sheen
from torchmat.errors import RangeError, message

_ORDERS = 3  # r^2, r^4, r^6
_DEGREE = 6  # of a flat field's polynomial
_BLOCKS = 48  # along the longer side of a flat field
_LOPSIDED = 0.08  # of a flat field's logarithm, beside a course about the middle: more is a lamp's, or a highlight
_ROUNDS = 12
_TUKEY = 4.0
_DARKEST = 1e-6
LENSES = np.array([0.5, 0.2, 0.1])  # standard deviations of the terms of real lenses' vignetting: what paper leaves open is decided by them
_ALIKE = 9.0  # neighbouring points share their errors: about one in so many counts
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
        return np.exp(vignetting_terms(self.size, pixels, self.radial) @ self.weights)

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


def vignetting_terms(size: tuple[int, int], pixels: np.ndarray, radial: bool) -> np.ndarray:
    """Return what a vignetting's logarithm is a sum of [..., m] at pixels [..., 2]: powers of the radius, or of column and row."""
    away = (pixels - (np.array(size) - 1) / 2) / (np.hypot(*size) / 2)
    if radial:
        square = (away**2).sum(-1)
        return np.stack([square**order for order in range(1, _ORDERS + 1)], axis=-1)
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i) if i + j > 0]
    return np.stack([away[..., 0] ** i * away[..., 1] ** j for i, j in powers], axis=-1)


def flat_field(linear: Tensor, clipped: Tensor) -> Vignetting:
    """Return the vignetting that a photograph [3, H, W] of evenly lit white shows, as a polynomial of degree 6 of its logarithm.

    Raises RangeError when it is clipped, dark, or no even white: more than a tenth of it deviates by more than 5 %, or it is somewhere
    8 % beside what is alike all around the middle, as a highlight or a lamp beside makes it.
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
    design = np.column_stack((np.ones(len(level)), vignetting_terms((width, height), pixels, False)))
    weights, _, off = _robust(design, np.log(level))
    share = float((np.abs(off) > 0.05).mean())
    if share > 0.1:
        fact, hint = f"{share:.0%} of it deviates from a smooth course by more than 5 %", "Photograph bare paper, out of focus, in even light."
        raise RangeError(message("flat field", "the photograph", "be of even white", fact, hint))
    centred = np.column_stack((np.ones(len(level)), vignetting_terms((width, height), pixels, True)))
    smooth = design @ weights
    beside = smooth - centred @ _robust(centred, smooth)[0]
    worst = int(np.abs(beside).argmax())
    if np.abs(beside[worst]) > _LOPSIDED:
        column, row = pixels[worst].round().astype(int)
        fact = f"about pixel ({column}, {row}) it is {100 * (np.exp(beside[worst]) - 1):+.0f} % beside what a lens does, which is alike all around"
        hint = "Photograph bare matte paper in even light, without a highlight or a shadow, or leave it out: the board's paper tells vignetting too."
        raise RangeError(message("flat field", "the photograph", "be evenly lit", fact, hint))
    return Vignetting((width, height), weights[1:], False, float(off.std() / np.sqrt(len(off) / design.shape[1])), "a flat field")


def _robust(design: np.ndarray, target: np.ndarray, prior: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return weights, their covariance and residuals of least squares with Tukey's weights; `prior` is 1 / variance of the weights."""
    trust, spread = np.ones(len(target)), 0.02
    for _ in range(_ROUNDS):
        normal = design.T @ (trust[:, None] * design)
        normal += np.diag(1e-12 * np.trace(normal) + (0 if prior is None else prior * spread**2 * _ALIKE) + np.zeros(len(normal)))
        found = np.linalg.solve(normal, design.T @ (trust * target))
        off = target - design @ found
        spread = max(1.4826 * float(np.median(np.abs(off))), 1e-6)
        trust = np.clip(1 - (off / (_TUKEY * spread)) ** 2, 0, 1) ** 2
    return found, np.linalg.inv(normal) * spread**2 * _ALIKE, off


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
    known: Vignetting | None = None, sloped: bool = True, mirror: Sequence[np.ndarray] | None = None,
) -> tuple[list[Course], Vignetting | None, Sheen | None]:
    """Return how each photograph's paper is lit, the vignetting that all share (None where the paper does not reach far enough), and the
    paper's gloss (None where it has none).

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
        mirror: cosines [n_j, 2] that gloss depends on there (`mirrored`); None takes paper for matte.
    """
    counts = [len(one) for one in points]
    where, pixel = np.repeat(np.arange(len(counts)), counts), np.concatenate(pixels)
    lit = np.concatenate(expected)[:, None]
    colours = np.log(np.maximum(np.concatenate(values), _DARKEST)) - np.log(np.maximum(lit, _DARKEST))
    if known is not None:
        colours = colours - np.log(known.at(pixel))[:, None]
    place = np.concatenate(points)[:, :2] / 100
    own = np.column_stack((np.ones(len(place)), place)) if sloped else np.ones((len(place), 1))
    radial = vignetting_terms(size, pixel, True)
    seeks = known is None and np.sqrt(radial[:, 0].max(initial=0)) > _REACH
    design = np.zeros((len(place), len(counts) * own.shape[1] + (_ORDERS if seeks else 0)))
    for column in range(own.shape[1]):
        design[np.arange(len(place)), where * own.shape[1] + column] = own[:, column]
    if seeks:
        design[:, -_ORDERS:] = radial
    sheen = None if mirror is None else find_sheen(design, colours.mean(1), where, np.concatenate(mirror))
    if sheen is not None and mirror is not None:
        colours = colours - np.log(sheen.at(np.concatenate(mirror)))[:, None]
    prior = np.zeros(design.shape[1])
    if seeks:
        prior[-_ORDERS:] = 1 / LENSES**2
    found, covariance, off = _robust(design, colours.mean(1), prior)
    if seeks:
        sigma = float(np.sqrt(covariance[-_ORDERS:, -_ORDERS:].sum()))  # at the corner, r = 1, all terms are 1
        known = Vignetting(size, found[-_ORDERS:], True, sigma, "the board's white paper")
        colours = colours - (radial @ found[-_ORDERS:])[:, None]
    slopes = found[: len(counts) * own.shape[1]].reshape(len(counts), -1)[:, 1:] / 100
    slopes = slopes if sloped else np.zeros((len(counts), 2))
    return [_course(colours[where == j], place[where == j] * 100, off[where == j], slopes[j]) for j in range(len(counts))], known, sheen


def _course(colours: np.ndarray, place: np.ndarray, off: np.ndarray, slope: np.ndarray) -> Course:
    """Return one photograph's course of logarithms [n, 3] at places [n, 2] in mm, whose common fit is `off` [n] away."""
    if not len(off):
        return Course(np.full(3, np.nan), slope, np.nan)
    near = np.abs(off) < 3 * max(1.4826 * float(np.median(np.abs(off))), 1e-6)
    level = np.exp(np.median(colours[near] - (place[near] @ slope)[:, None], axis=0))
    return Course(level, slope, float(np.sqrt(np.mean(off[near] ** 2))))
