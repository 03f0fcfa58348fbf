"""Fit of a shading map: the chapter's resampling of images, or BRDF and slices together in closed form."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat.brdf.analytic import ANALYTIC
from torchmat.brdf.lobe import Lobe
from torchmat.errors import FitError, check_option, message
from torchmat.fitting.models.lobe import by_differences, fit_lobe, lobe_limits
from torchmat.fitting.models.streamed import solve_texels, stream_means, stream_moments
from torchmat.fitting.recipe import Recipe
from torchmat.fitting.shared import Shared
from torchmat.fitting.training import Fitted, Training
from torchmat.metrics import relative
from torchmat.models import ShadingMap
from torchmat.models.shading_map import (
    OVERFLOWS, SLICES, blend_brackets, brackets, check_azimuths, check_slices, layer_place, layer_weights,
    sector_weights,
)
from torchmat.repeatable import one_thread, wide_product
from torchmat.solvers.least_squares import make_design
from torchmat.solvers.levenberg_marquardt import levenberg_marquardt
from torchmat.solvers.stop_reasons import CLOSED_FORM

_WHERE = "fit shading_map"
# Slices are written as slope and bends: what no sample determines goes on straight. The slope of the whole stack is
# this many times cheaper than a bend.
_SLOPE, RIDGE = 10.0, 1e-3
# What parts the sectors is this many times dearer: less where each has lights of its own (found on a real wallpaper, an
# RTI set and two path-traced BTFs: 50 costs 1 dB), much more where one has none and must take the others' stack.
_PARTING, _PARTING_ALONE = 3.0, 50.0
_STEEP = 0.2  # sine of the polar angle below which a light is no sector's own
# The small problem in which the BRDF is refined: at most so many samples and texels, and curves for the texels.
_SAMPLES, _TEXELS, _CURVES = 600, 128, 16
_VALUES = 4_000_000  # decoded at a time
_ANCHOR = 0.1  # weight of the brightness being that of the images, beside their relative error
_STEPS, _TOLERANCE = 60, 1e-7


@dataclass(frozen=True)
class ShadingMapShared(Shared):
    """What all texels share: the lobe among the tables, and the images' `means` [sample, 3]."""

    means: Tensor | None = None


def fit_shading_map(
    training: Training, *, slices: int = SLICES, brdf: str = "phong", overflow: str = "clamp", azimuths: int = 1,
    joint: bool = True, storage: str = "half",
) -> Fitted:
    """Fit the BRDF to the images' means, then the slices to the images.

    `joint` False is the chapter's way (`_resample`): slices are blends of the images of one view, the BRDF is that of
    the means (of all views). `joint` True goes past it: the value is linear in the slices once the BRDF has said
    which layer each sample shows, so all samples of all views give them in one closed form; and the BRDF is the one
    with which that explains most (`_refined`). r comes from the BRDF there, not from the images' means: measured never
    worse. Slice 0 is black, negative coefficients become 0. Raises FitError when every image is black.

    Args:
        slices: images of a stack, sorted by brightness, the black one included: 2 to 64.
        brdf: what says which brightness a pair of directions has: "lambert", "phong" (the chapter's), "blinn",
            "ashikhmin_shirley", "ward", "cook_torrance", "ggx" or "ggx_anisotropic".
        overflow: above the brightest slice, "clamp" shows it, "scale" multiplies it on.
        azimuths: stacks, one for each sector of the light's azimuth, interpolated: 1 to 36; 1 for isotropic relief or few
            lights.
        joint: true fits BRDF and slices together to the samples of all views; false is the chapter's way, of one view.
    """
    check_slices(_WHERE, slices)
    check_azimuths(_WHERE, azimuths)
    check_option(_WHERE, "brdf", brdf, ANALYTIC)
    check_option(_WHERE, "overflow", overflow, OVERFLOWS)
    lobe = ANALYTIC[brdf]
    known, reason = training.shared, CLOSED_FORM
    if isinstance(known, ShadingMapShared) and known.means is not None:
        means, parameters = known.means, known.tables["lobe"]
    else:
        means, parameters, reason = _global_brdf(training, lobe, slices if joint else 0)
    used = training.used
    if joint:
        stack, brightest, coverage = _solved(training, _brightness(training, lobe, parameters), slices, azimuths)
    else:
        (stack, brightest), coverage = _resample(training, means.mean(dim=1), slices, azimuths), None
    maps = {"slices": stack, "lobe": parameters.to(training.dtype), "brightest": brightest.to(training.dtype)}
    material = ShadingMap(maps, slices=slices, brdf=brdf, overflow=overflow, azimuths=azimuths, storage=storage)
    figures = {
        "lobe": material.parameters_by_name, "brightest": float(brightest),
        "brightness_error": _error_of(_brightness(training, lobe, parameters)[used], means.mean(dim=1)[used]),
    }
    return Fitted(material, reason, coverage, figures, shared=ShadingMapShared({"lobe": parameters}, means=means))


def _global_brdf(training: Training, lobe: Lobe, slices: int) -> tuple[Tensor, Tensor, str]:
    """Return the images' means [sample, 3], the BRDF's parameters [P] and the stop reason; refined for so many slices."""
    everywhere = torch.ones(training.btf.height, training.btf.width, dtype=torch.bool)
    means = stream_means(training.btf, training.used, everywhere, training.dtype)
    _check_means(training, means)
    used = training.used
    light, view = training.light[used].double(), training.view[used].double()
    parameters, reason = fit_lobe(lobe, light, view, means[used], differences=True)
    return means, *(_refined(training, lobe, parameters, means, slices) if slices else (parameters, reason))


def _check_means(training: Training, means: Tensor) -> None:
    if not bool((means[training.used].mean(dim=1) > 0).any()):
        step = "Check exposure and encoding, and whether a mask covers everything."
        fact = f"all {int(training.used.sum())} fitted ones are"
        raise FitError(message(_WHERE, "the data", "have an image that is not black", fact, step))


def _error_of(found: Tensor, wanted: Tensor) -> float | None:
    return relative(float((found - wanted).square().sum()), float(wanted.square().sum()))


def _brightness(training: Training, lobe: Lobe, parameters: Tensor) -> Tensor:
    """Return r of each sample, [sample], float64."""
    value = lobe.evaluate(parameters, training.light.double(), training.view.double())[:, :, 0, 0]
    return value.mean(dim=1).clamp(min=0)


def _resample(training: Training, means: Tensor, count: int, azimuths: int) -> tuple[Tensor, Tensor]:
    """Return the chapter's stack and a_max, of the used images of the view nearest to the normal.

    Values below 0, which are noise, count as 0. Raises FitError for several azimuths, and for masked texels.
    """
    if azimuths > 1:
        step = "Use joint=true, or azimuths=1."
        raise FitError(message(_WHERE, "joint=false", "have azimuths=1", f"it is {azimuths}", step))
    btf = training.btf
    rows = (training.used & (means > 0)).nonzero()[:, 0]
    nearest = btf.view_index[rows[btf.view[rows, 2].argmax()]]
    rows = rows[btf.view_index[rows] == nearest]
    found = brackets(means[rows], count)
    chosen, places = torch.cat((found.lower.clamp(min=0), found.upper)).unique(return_inverse=True)
    missing = btf.weights(rows[chosen]) == 0
    masked = int((missing if btf.mask is None else missing[:, :, btf.mask]).sum())
    if masked:
        step = "Use joint=true, which takes every texel's own samples."
        fact = f"{masked} are masked"
        raise FitError(message(_WHERE, "joint=false", "have images without masked texels", fact, step))
    lower, upper = places.split(count - 1)
    lower = torch.where(found.lower < 0, found.lower, lower)
    images = btf.images(rows[chosen], training.dtype).clamp(min=0)
    return blend_brackets(images, found._replace(lower=lower, upper=upper)).flatten(0, 1), found.brightest


def _ramps(count: int) -> Tensor:
    """Return the matrix [count, count] that makes slices 1..count of the first slope and the bends after it."""
    steps = torch.arange(count, dtype=torch.float64)
    ramps = (steps[:, None] - steps + 1).clamp(min=0)
    ramps[:, 0] *= _SLOPE
    return ramps


def _parting(light: Tensor, count: int) -> float:
    """Return what parts `count` sectors costs, for lights [n, 3, 1, 1]."""
    sloping = light[light[:, :2, 0, 0].norm(dim=1) > _STEEP]
    nearest = sector_weights(sloping, count)[:, :, 0, 0].argmax(dim=1) if len(sloping) else torch.zeros(0)
    return _PARTING if len(nearest.unique()) == count else _PARTING_ALONE


def _sectors(count: int, parting: float) -> Tensor:
    """Return the matrix [count, count] that makes sectors of what they share, column 0, and of what parts them, scaled.

    The columns are those of the cosine transform; any orthogonal ones with the same first have the same solution.
    """
    steps = torch.arange(count, dtype=torch.float64)
    cosines = torch.cos(math.pi * (steps[:, None] + 0.5) * steps / count) * math.sqrt(2 / count)
    cosines[:, 0] = math.sqrt(1 / count)
    cosines[:, 1:] /= parting
    return cosines


def _weights(r: Tensor, brightest: Tensor, count: int) -> Tensor:
    """Return the weight [..., count - 1] of each slice above the black one for brightness r [...]."""
    place = layer_place(r[..., None, None, None], brightest[..., None, None, None], count)
    return layer_weights(place, count)[..., 1:, 0, 0]


def _solved(training: Training, r: Tensor, count: int, azimuths: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return stack [3 * azimuths * count, H, W], brightest [1] and coverage: least squares over all samples."""
    btf, used = training.btf, training.used
    brightest = r[used].max().clamp(min=1e-30)
    layers = _weights(r, brightest, count)
    light = training.light.double()
    sectors = sector_weights(light, azimuths)[:, :, 0, 0]
    shape = torch.kron(_sectors(azimuths, _parting(light[used], azimuths)), _ramps(count - 1))
    design = make_design((sectors[:, :, None] * layers[:, None, :]).flatten(1) @ shape, used, RIDGE, training.importance)
    moments = stream_moments(btf, design, used, training.dtype, training.progress)
    solved = solve_texels(btf, design, moments, used)
    ramps = solved.coefficients
    stack = wide_product(shape.to(training.dtype), ramps.flatten(1)).clamp(min=0)
    stack = stack.reshape(azimuths, count - 1, *ramps.shape[1:])
    stack = torch.cat((torch.zeros_like(stack[:, :1]), stack), dim=1)
    return stack.flatten(0, 2), brightest.reshape(1), solved.coverage


@dataclass(frozen=True)
class _Projection:
    """The BRDF against what the slices can explain with it: variable projection (Golub & Pereyra 1973).

    For each set of parameters the slices of `curves` [m, K] are solved for, so that only the BRDF's parameters are
    left. `light`, `view` [m, 3, 1, 1]; `means` [m] holds the brightness to the images', or its scale would be free.
    """

    lobe: Lobe
    light: Tensor
    view: Tensor
    curves: Tensor
    means: Tensor
    count: int

    def residual(self, parameters: Tensor) -> Tensor:
        """Return what is left [problem, m (K + 1)] of parameters [problem, P]."""
        value = self.lobe.evaluate(parameters[:, None], self.light, self.view)[..., 0, 0]
        r = value.mean(dim=-1).clamp(min=0)
        matrix = _weights(r, r.amax(dim=1, keepdim=True).clamp(min=1e-30), self.count) @ _ramps(self.count - 1)
        normal = matrix.transpose(1, 2) @ matrix
        penalty = RIDGE * normal.diagonal(dim1=1, dim2=2).mean(dim=1).clamp(min=1e-30)
        normal = normal + penalty[:, None, None] * torch.eye(self.count - 1, dtype=normal.dtype)
        slices = torch.linalg.solve(normal, matrix.transpose(1, 2) @ self.curves)
        left = (self.curves - matrix @ slices).flatten(1) / self.curves.norm().clamp(min=1e-30)
        return torch.cat((left, _ANCHOR * (r - self.means) / self.means.norm()), dim=1)


def _refined(training: Training, lobe: Lobe, start: Tensor, means: Tensor, count: int) -> tuple[Tensor, str]:
    """Return the BRDF's parameters with which one stack explains most of a choice of texels, and the stop reason."""
    rows = training.used.nonzero()[:, 0]
    rows = rows[torch.linspace(0, len(rows) - 1, min(len(rows), _SAMPLES)).round().long()]
    light, view = training.light[rows].double(), training.view[rows].double()
    with one_thread():
        problem = _Projection(lobe, light, view, _curves(training, rows, means), means[rows].mean(dim=1), count)
        low, high = lobe_limits(lobe, means[training.used])
        jacobian = by_differences(problem.residual)
        solution = levenberg_marquardt(
            problem.residual, start[None], low, high, jacobian=jacobian, max_steps=_STEPS, tolerance=_TOLERANCE
        )
    return solution.parameters[0], solution.reasons[0]


def _curves(training: Training, rows: Tensor, means: Tensor) -> Tensor:
    """Return the few curves over samples `rows` [m, K] that hold most of what texels, evenly chosen, do.

    Where a sample has little weight the image's mean stands in.
    """
    btf = training.btf
    texels, inside = btf.height * btf.width, btf.inside
    chosen = inside[torch.linspace(0, len(inside) - 1, min(len(inside), _TEXELS)).long()]
    parts = []
    for part in rows.split(max(1, _VALUES // (3 * texels))):
        values = btf.images(part, training.dtype).flatten(2)[:, :, chosen].double()
        weight = btf.weights(part).flatten(2)[:, :, chosen].double()
        parts.append(weight * values + (1 - weight) * means[part, :, None])
    found = torch.cat(parts).flatten(1)
    if min(found.shape) <= _CURVES:
        return found
    _, vectors = torch.linalg.eigh(found.T @ found)
    return found @ vectors[:, -_CURVES:]


# Slices are sorted by the brightness that the BRDF gives: moving it deals the samples out anew, which has no slope.
SHADING_MAP = Recipe(
    ShadingMap, fit_shading_map, near="centred", bytes_per_texel="48", shared=ShadingMapShared, descends=False,
    compared=("", "brdf=ggx,azimuths=4"),
)
