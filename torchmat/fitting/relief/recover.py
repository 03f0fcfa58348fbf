"""From a BTF to a height map: slopes from the lights, scale and offset from the views, then both together.

Photometric stereo on the most frontal view gives slopes that are right in detail but wrong by a factor where the surface
shines. The other views say how high each texel stands, blurred by what they cannot tell apart. The height is the one
that agrees best with both (a screened Poisson equation), found over again as the images are brought onto it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat import frames
from torchmat.btf import Btf
from torchmat.btf.lambert import relief_of_one_view
from torchmat.btf.tiling import decided
from torchmat.errors import FitError, message
from torchmat.fitting.fewer_texels import shrunk_mask
from torchmat.fitting.relief.agreement import Agreement, Captured, agreement, capture, on_surface
from torchmat.fitting.relief.refine import image_gradient, limited
from torchmat.fitting.training import Training, make_training
from torchmat.geometry import Relief, poisson, slopes_from_normals
from torchmat.geometry.normals import pad_border
from torchmat.geometry.tiling import AUTO_TILES
from torchmat.progress import Activity, progress, whole
from torchmat.repeatable import one_thread, product
from torchmat.solvers.clock import Watch
from torchmat.solvers.stop_reasons import BUDGET, CONVERGED

_FLATTEST_DEG = 45  # the view of photometric stereo may lean no further: texels of other views are not where it sees them
_FEWEST_VIEWS, _FEWEST_SAMPLES = 6, 24  # below, there is no parallax to speak of
_WIDEST = 0.3  # and none if no view leans further than this (tangent of its polar angle)
_GAIN = 0.98  # a relief must bring the disagreement of the images below this share of a flat surface's
_REFINEMENTS = 4
_SEARCHED = 35  # heights that the search looks at: 13, then by turns 6 and 5
_COMPARISONS = 45  # of all images on a height, that is what search and refinement take
_SHARE = 0.5  # of a limit of seconds: the rest is for what is fitted on the relief
# A slope of photometric stereo is off by so much, and steep ones by so much of themselves.
_SLOPE_ERROR, _SLOPE_SHARE = 0.05, 0.15
# What a low rank leaves over is no noise: neighbours in angle and space share it. It counts like 3 independent in 1000.
_INDEPENDENT = 0.003
_FINE = 4.0  # coarse texels: what is finer is the slopes' alone


class _Spent(Exception):
    """Raised where the seconds of a recovery are over."""


@dataclass(frozen=True)
class Recovery:
    """The relief, its height over the plane of the images, and how it was found.

    `scale` is what the slopes of photometric stereo were multiplied with and `offset` the mean height, which
    `scale_from` says the source of; `disagreement` is that of the images on the relief, `disagreement_flat` on a flat
    surface, None where no views were compared. `stop_reason` is "converged", or "budget spent" where the seconds did
    not suffice for all of the search.
    """

    relief: Relief
    method: str
    scale: float
    offset: float
    scale_from: str
    stop_reason: str = CONVERGED
    disagreement: float | None = None
    disagreement_flat: float | None = None
    images_compared: int | None = None

    def figures(self) -> dict[str, Any]:
        """Return what a report says of it."""
        found = {one.name: getattr(self, one.name) for one in dataclasses.fields(self) if one.name != "relief"}
        return {name: value for name, value in found.items() if value is not None}


def recover_relief(training: Training) -> Recovery:
    """Recover height and normals from the training samples of a BTF.

    The height is in texture widths over the plane on which the images are registered. A surface whose images agree
    best without relief comes out exactly flat. With fewer than six views there is no parallax: then the height has
    the scale of photometric stereo and mean 0. Raises FitError when no view is near enough to the normal, RangeError
    when its lights lie in one plane.

    Half of the watch's limit of seconds is the most that is spent on scale, offset and refinement. It comes out coarser
    then: from fewer views, with what was found by that time, and flat where that is not so much as an offset.
    """
    found = _stereo(training)
    until = _SHARE * training.watch.limit
    if not _has_parallax(training):
        source = "photometric stereo: too few views, or too close to each other, for parallax"
        return Recovery(found, "photometric stereo", 1.0, 0.0, source)
    captured = capture(training)
    size = captured.images.shape[-2:]
    slopes, confidence = slopes_from_normals(found.normal), found.confidence
    assert confidence is not None  # photometric stereo gives it
    mask = training.btf.mask
    coarse = _Slopes(_shrink(slopes, size), _shrink(confidence, size), training.tiles, shrunk_mask(mask, size))
    start = _shrink(found.height, size).float()  # views are compared in single precision, whatever the fit runs in
    start = start - (start if coarse.mask is None else start[:, coarse.mask]).mean()
    captured, flat = _in_time(captured, start, training.watch, until)
    with whole("finding scale and offset", _SEARCHED, show=training.progress) as bar:
        scale, offset, best = _search(captured, start, flat, bar, training.watch, until)
    level = Recovery(
        _flattened(found), "photometric stereo and views", 0.0, 0.0, "agreement of the views",
        BUDGET if training.watch.seconds >= until else CONVERGED, flat, flat, len(captured.images),
    )
    if scale == 0 or best > _GAIN * flat:
        return level
    height = scale * start + offset
    for _ in progress(range(_REFINEMENTS), "refining the height", show=training.progress):
        if training.watch.seconds >= until:
            level = replace(level, stop_reason=BUDGET)
            break
        height = _refined(captured, height, coarse)
    reached = agreement(captured, height).error
    # Between texels interpolation averages noise away, which the search takes for agreement: refined, it is gone.
    if reached > _GAIN * flat:
        return level
    if tuple(size) != tuple(found.height.shape[-2:]):
        height = _sharpened(height, _Slopes(slopes, confidence, training.tiles, mask))
    relief = found._replace(height=height.to(found.height.dtype))
    return replace(level, relief=relief, scale=scale, offset=offset, disagreement=reached)


def recover_geometry(
    btf: Btf, *, tiles: bool | str = AUTO_TILES, seed: int = 0, dtype: torch.dtype = torch.float32, progress: bool | None = None
) -> Recovery:
    """Recover height and normals of a BTF from all its samples; see `recover_relief`.

    Args:
        btf: the images.
        tiles: whether the surface repeats at its borders; "auto" asks the images.
        seed: chooses the samples that are looked at, from 0.
        dtype: precision of the search, torch.float32 or torch.float64.
        progress: whether to show a bar; None shows it on a terminal.
    """
    with torch.no_grad():
        repeats, _ = decided("recover_geometry", btf, tiles)
        return recover_relief(make_training(btf, torch.arange(len(btf)), seed, repeats, dtype, progress))


def _in_time(captured: Captured, height: Tensor, watch: Watch, until: float) -> tuple[Captured, float]:
    """Return what is compared, fewer views where the seconds demand it, and their disagreement on a flat surface."""
    begun = watch.seconds
    flat = agreement(captured, torch.zeros_like(height)).error
    if until == math.inf:
        return captured, flat
    share = max(0.0, until - watch.seconds) / max(_COMPARISONS * (watch.seconds - begun), 1e-9)
    if share >= 1:
        return captured, flat
    captured = captured.few(share)
    return captured, agreement(captured, torch.zeros_like(height)).error


def _stereo(training: Training) -> Relief:
    btf = training.btf
    first = int(btf.view_index[training.used].min())  # views run from the pole outward
    polar = float(torch.rad2deg(frames.to_polar(btf.views[first].double())[0]))
    if polar > _FLATTEST_DEG:
        fact = f"the most frontal one is at {polar:.0f} degrees"
        step = "Pass a height map, or geometry='flat'."
        requirement = f"have a view within {_FLATTEST_DEG} degrees of the normal to recover its geometry"
        raise FitError(message("fit", "the data", requirement, fact, step))
    rows = (training.used & (btf.view_index == first)).nonzero()[:, 0]
    with one_thread():
        return relief_of_one_view(btf, rows, training.dtype, training.tiles)


def _has_parallax(training: Training) -> bool:
    views = training.btf.views[training.btf.view_index[training.used].unique()]
    lean = views[:, :2].norm(dim=1) / views[:, 2]
    enough = len(views) >= _FEWEST_VIEWS and int(training.used.sum()) >= _FEWEST_SAMPLES
    return enough and float(lean.max()) >= _WIDEST


def _flattened(found: Relief) -> Relief:
    up = torch.zeros_like(found.normal)
    up[2] = 1
    return found._replace(height=torch.zeros_like(found.height), normal=up)


def _shrink(maps: Tensor, size: Sequence[int]) -> Tensor:
    return functional.adaptive_avg_pool2d(maps, (size[0], size[1]))


def _search(
    captured: Captured, shape: Tensor, flat: float, bar: Activity, watch: Watch, until: float
) -> tuple[float, float, float]:
    """Return scale, offset and disagreement of the best height ``scale * shape + offset``.

    At the watch's second `until` it is what whole turns have found; scale 0 says that there was none.
    """
    span = float(shape.max() - shape.min())
    if span < 1e-6:
        return 0.0, 0.0, flat

    def error(scale: float, offset: float) -> float:
        if watch.seconds >= until:
            raise _Spent
        found = agreement(captured, scale * shape + offset).error
        bar.advance()
        return found

    scale, offset, best = 0.0, 0.0, flat
    try:
        for turn in range(5):
            if turn == 0:
                offset, best = _lowest(lambda x: error(1.0, x), [span * step / 4 for step in range(-6, 7)])
                scale = 1.0
            elif turn % 2 == 1:
                scale, best = _lowest(lambda x: error(x, offset), [scale * s for s in (0.3, 0.55, 0.8, 1, 1.25, 1.6)])  # noqa: B023
            else:
                reach = 0.2 * span * scale / turn
                offset, best = _lowest(lambda x: error(scale, x), [offset + reach * s for s in (-1, -0.5, 0, 0.5, 1)])  # noqa: B023
    except _Spent:
        pass
    return scale, offset, best


def _lowest(error: Callable[[float], float], at: list[float]) -> tuple[float, float]:
    """Return where `error` is lowest, by the parabola through the lowest of the points `at` and its neighbours."""
    values = [error(x) for x in at]
    lowest = min(range(len(at)), key=values.__getitem__)
    middle = min(max(lowest, 1), len(at) - 2)
    (a, b, c), (fa, fb, fc) = at[middle - 1 : middle + 2], values[middle - 1 : middle + 2]
    left, right = (fb - fa) / (b - a), (fc - fb) / (c - b)
    if right <= left:
        return at[lowest], values[lowest]
    bend = (right - left) / (c - a)
    found = min(max((a + b) / 2 - left / (2 * bend), a), c)
    return found, values[lowest]


class _Slopes(NamedTuple):
    """Slopes [2, H, W] and their confidence [1, H, W], of an object inside `mask`, bool [H, W]."""

    slopes: Tensor
    confidence: Tensor
    tiles: bool
    mask: Tensor | None = None

    @property
    def trust(self) -> Tensor:
        """Inverse variance of each slope, [1, H, W]."""
        spread = _SLOPE_ERROR + _SLOPE_SHARE * self.slopes.square().sum(dim=0, keepdim=True).sqrt()
        return self.confidence.clamp(min=1e-3) / spread**2


def _refined(captured: Captured, height: Tensor, slopes: _Slopes) -> Tensor:
    """Return the height after one Gauss-Newton step toward the low rank, held together by the slopes."""
    found = agreement(captured, height)
    slope = captured.slope[captured.view_index]
    across, up = on_surface(captured, image_gradient(captured.images, captured.tiles), height).split(3, dim=1)
    change = -(across * slope[:, :1] + up * slope[:, 1:]).flatten(1) * found.scale * found.weight
    # What the subspace can follow by itself says nothing of the height.
    change = change - product(found.subspace, product(found.subspace.T, change))
    known, step = _normal_equations(found, change, height.shape[-2:])
    with one_thread():
        return poisson(slopes.slopes, slopes.trust, slopes.tiles, limited(height, step), known, slopes.mask).to(height.dtype)


def _normal_equations(found: Agreement, change: Tensor, size: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Return the inverse variance of each texel's height by the views alone and the step that they ask for, [1, h, w]."""
    with one_thread():
        spread = 1.5 * float((found.residual.abs() * found.weight).sum() / found.weight.sum().clamp(min=1)) + 1e-6
        robust = found.weight / (1 + (found.residual / spread) ** 2)  # Cauchy's weights

        def gathered(values: Tensor) -> Tensor:
            return values.sum(dim=0).reshape(3, *size).sum(dim=0, keepdim=True)

        curvature = gathered(robust * change * change)
        step = -gathered(robust * change * found.residual) / curvature.clamp(min=1e-6 * float(curvature.mean()) + 1e-30)
    return curvature.clamp(min=1e-30) * (_INDEPENDENT / spread**2), step


def _sharpened(coarse: Tensor, fine: _Slopes) -> Tensor:
    """Return `coarse` at the size of the slopes, with their detail."""
    size = fine.slopes.shape[-2:]
    wide = pad_border(coarse[None], fine.tiles, 2)
    grown = functional.interpolate(
        wide, scale_factor=(size[0] / coarse.shape[-2], size[1] / coarse.shape[-1]), mode="bicubic", align_corners=False
    )
    margin = (grown.shape[-2] - size[0]) // 2, (grown.shape[-1] - size[1]) // 2
    anchor = grown[0, :, margin[0] : margin[0] + size[0], margin[1] : margin[1] + size[1]]
    frequency = 2 * math.pi * coarse.shape[-1] / _FINE
    with one_thread():
        weight = torch.full_like(anchor, float(fine.trust.mean()) * frequency**2)
        return poisson(fine.slopes, fine.trust, fine.tiles, anchor, weight, fine.mask)
