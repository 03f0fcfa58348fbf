"""Fit of Phong + residual: Levenberg-Marquardt for the global lobe, one streamed least squares for the residual."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchmat.errors import FitError, RangeError, check_option, message
from torchmat.fitting.models.by_cell import cells_of
from torchmat.fitting.models.by_texel import fit_texels
from torchmat.fitting.models.linear import design_of
from torchmat.fitting.models.lobe import LobeProblem, by_differences, fit_lobe, limits_of, lobe_limits
from torchmat.fitting.models.streamed import Moments, solve_texels, stream_means, stream_moments
from torchmat.fitting.recipe import Recipe, Rung
from torchmat.fitting.shared import Shared
from torchmat.fitting.training import Fitted, Training
from torchmat.metrics import relative
from torchmat.models import PhongSrf
from torchmat.models.bases import BASES
from torchmat.models.lobes import LOBES, Lobe
from torchmat.models.phong_srf import RESIDUALS
from torchmat.models.storage import StoredAs
from torchmat.repeatable import one_thread
from torchmat.solvers import LevenbergMarquardt, VariableProjection
from torchmat.solvers.least_squares import Design
from torchmat.solvers.levenberg_marquardt import Solution, levenberg_marquardt
from torchmat.solvers.stop_reasons import CLOSED_FORM, CONVERGED

PHONG_WAYS = ("mean_brdf", "per_light")
_FEWEST_VIEWS = 3  # per light: seven parameters from nine numbers
_OUTLYING, _TRIMMED = 100.0, 50  # so many times brighter than the mean of all but one in 50


def fit_phong_srf(
    training: Training, *, residual: str = "half", phong: str = "mean_brdf", base: str = "phong",
    ridge: float = 1e-4, solver: LevenbergMarquardt = LevenbergMarquardt(), storage: str = "half",
) -> Fitted:
    """Fit the global lobe, then the residual maps.

    The paper fits each light's reflectance map texel by texel; all texels of an image share light and view here, so its
    sum of squares differs from ours by a constant. Both errors of `phong` are reported. One pass over the images serves both steps: the lobe is
    the same for all texels, so it can be subtracted from the summed products afterwards. A few texels a hundred times
    brighter than the rest (an HDR highlight on dark cloth) are left out of the lobe, by a second pass over the images:
    it would be theirs, and no residual takes it off the other texels again.

    Under one view `half_light` is nearly collinear: coefficients cancel each other, which 8-bit textures cannot hold and
    unseen views do not forgive. A `ridge` of 1e-4 costs the flat sample under one view 0.0016 of relative error and lets 8
    bits hold it; on well-conditioned data it changes nothing.

    Args:
        residual: what each texel adds to the lobe: "half", the paper's, linear in the half vector (9 numbers a texel);
            "half_light", linear in the light too (21); "quadratic" in both (45); "cosine", a colour times the light's
            cosine (3).
        phong: "mean_brdf" fits the lobe to each image's mean over the texels; "per_light" fits one for each light, which
            needs three views of it, and averages the parameters, exponents as logarithms.
        base: the lobe, "phong" or "ashikhmin_shirley" (anisotropic, with Fresnel).
        ridge: penalty on large coefficients of the residual, at least 0, as a share of the data's own weight.
        solver: "lm" (Levenberg-Marquardt) fits the lobe to the values themselves, as the paper does; "varpro" to what no
            residual can follow, which is the least error of lobe and residual together.
    """
    _check_options(residual, phong, base, ridge)
    if training.btf.near is not None:
        return _fit_near(training, residual, phong, base, ridge, solver, storage)
    design = design_of(training, residual, ridge)
    moments = stream_moments(training.btf, design, training.used, training.dtype, training.progress)
    lobe = LOBES[base]
    parameters, reason, figures = training.table("lobe"), CLOSED_FORM, {}
    if parameters is None:
        means, left_out = _common_means(training, moments)
        parameters, reason, errors = _global_lobe(_seen_of(training, means), lobe, phong, solver)
        figures = {"lobe_error_on_mean_brdf": errors, "texels_left_out_of_lobe": left_out}
        if isinstance(solver, VariableProjection):
            parameters, reason = _beside_residual(training, means, design, lobe, parameters, solver)
    explained = lobe.evaluate(parameters, training.light.double(), training.view.double())[:, :, 0, 0]
    solved = solve_texels(training.btf, design, moments, training.used, explained, reuse=True)
    maps = {"lobe": parameters.to(training.dtype), "residual": solved.coefficients.flatten(0, 1)}
    material = PhongSrf(maps, residual=residual, base=base, storage=storage)
    figures = {"lobe": material.parameters_by_name, **figures}
    return Fitted(material, reason, solved.coverage, figures, shared=Shared({"lobe": parameters}))


def _fit_near(
    training: Training, residual: str, phong: str, base: str, ridge: float, solver: LevenbergMarquardt, storage: str
) -> Fitted:
    """Fit the same where each texel has directions of its own: the lobe to means of cells, the residual texel by texel."""
    if isinstance(solver, VariableProjection):
        step = "Use solver='lm', or btf.far()."
        fact = "lights or cameras are near"
        raise RangeError(message("fit phong_srf", "solver='varpro'", "have directions that all texels share", fact, step))
    lobe, parameters, reason = LOBES[base], training.table("lobe"), CLOSED_FORM
    figures: dict[str, Any] = {}
    if parameters is None:
        common = _common_texels(_brightness(training), training.btf.mask)
        cells = cells_of(training, common)
        groups = training.btf.light_index[cells.sample]
        seen = _Seen(cells.light, cells.view, cells.values, cells.importance, groups, _FEWEST_VIEWS * len(cells.sample) // int(training.used.sum()))
        parameters, reason, errors = _global_lobe(seen, lobe, phong, solver)
        figures = {"lobe_error_on_mean_brdf": errors, "texels_left_out_of_lobe": int((~common).sum())}
    terms, evaluate = BASES[residual]
    shared: Tensor = parameters
    solved = fit_texels(
        training, len(terms), evaluate, ridge, explained=lambda light, view: lobe.evaluate(shared.double(), light, view)
    ).fit
    maps = {"lobe": parameters.to(training.dtype), "residual": solved.coefficients.flatten(0, 1)}
    material = PhongSrf(maps, residual=residual, base=base, storage=storage)
    figures = {"lobe": material.parameters_by_name, **figures}
    return Fitted(material, reason, solved.coverage, figures, shared=Shared({"lobe": parameters}))


def _brightness(training: Training) -> Tensor:
    """Return the sum of what each texel shows, [H, W] of the brightest channel."""
    total = torch.zeros(3, training.btf.height, training.btf.width, dtype=training.dtype)
    for block in training.btf.blocks(training.used, training.dtype):
        used = training.used[block.samples.start : block.samples.stop, None, None, None]
        total += (block.images * (used if block.weight is None else used * block.weight)).sum(dim=0)
    return total.abs().amax(dim=0)


class _Seen(NamedTuple):
    """What a lobe is fitted to: planes `light`, `view` [m, 3, 1, 1], `values` [m, 3], what each counts [m] (None: all alike), and
    of which light each is, [m]; `fewest` are enough for a lobe of a light's own."""

    light: Tensor
    view: Tensor
    values: Tensor
    importance: Tensor | None
    group: Tensor
    fewest: int


def _seen_of(training: Training, means: Tensor) -> _Seen:
    used = training.used
    light, view = training.light[used].double(), training.view[used].double()
    importance = None if training.importance is None else training.importance[used]
    return _Seen(light, view, means[used], importance, training.btf.light_index[used], _FEWEST_VIEWS)


def _common_means(training: Training, moments: Moments) -> tuple[Tensor, int]:
    """Return the mean colours [n, 3] over the texels that share the material's lobe, and how many others there are."""
    common = _common_texels(moments.product.abs().amax(dim=(0, 1)), training.btf.mask)
    if bool(common.all()):
        return moments.means, 0
    return stream_means(training.btf, training.used, common, training.dtype), int((~common).sum())


def _global_lobe(
    seen: _Seen, lobe: Lobe, phong: str, solver: LevenbergMarquardt
) -> tuple[Tensor, str, dict[str, float | None]]:
    """Return the parameters of the lobe that all texels share, the stop reason, and the error by each way to find it."""
    ways = _fit_lobe(seen, lobe, phong, solver)
    if phong not in ways:
        step = "Use phong='mean_brdf'."
        fact = f"no light has {_FEWEST_VIEWS} views among the fitted samples"
        raise FitError(message("fit phong_srf", "phong='per_light'", "have lights with at least 3 views", fact, step))
    errors = {way: _relative_error(seen, lobe, found) for way, (found, _) in ways.items()}
    return *ways[phong], {way: errors.get(way) for way in PHONG_WAYS}


def _beside_residual(
    training: Training, means: Tensor, design: Design, lobe: Lobe, start: Tensor, solver: LevenbergMarquardt
) -> tuple[Tensor, str]:
    """Return the lobe with which the residual leaves the least error: variable projection (Golub & Pereyra 1973).

    All texels share the design, so what the residual cannot follow is one projection for all; and the lobe is the same
    for all texels, so the sum over them differs from the projected error of the means by a constant. The images are not
    read again. The penalty on the residual's coefficients is part of the projection.
    """
    used = training.used
    basis, way = design.basis[used], design.back @ design.to_coefficients
    values, spread = torch.linalg.eigh(torch.eye(design.rank, dtype=torch.float64) - (way + way.T) / 2)
    left_over = torch.eye(design.rank, dtype=torch.float64) - spread * values.clamp(min=0).sqrt() @ spread.T
    light, view, means = training.light[used].double(), training.view[used].double(), means[used]
    weight = torch.ones(1, 1, dtype=torch.float64) if training.importance is None else training.importance[used, None].double().sqrt()

    def rest(rows: Tensor) -> Tensor:
        rows = rows * weight
        return rows - basis @ (left_over @ (basis.T @ rows))

    def residual(parameters: Tensor) -> Tensor:
        gaps = lobe.evaluate(parameters[:, None], light, view)[..., 0, 0] - means
        return torch.stack([rest(gap).flatten() for gap in gaps])

    def jacobian(parameters: Tensor) -> Tensor:
        assert lobe.jacobian is not None
        rows = lobe.jacobian(parameters[:, None], light, view)
        return torch.stack([rest(part.flatten(1)).reshape(-1, part.shape[-1]) for part in rows])

    low, high = lobe_limits(lobe, means)
    with one_thread():
        way_down = by_differences(residual) if lobe.jacobian is None else jacobian
        solution = levenberg_marquardt(residual, start[None], low, high, jacobian=way_down, **limits_of(solver))
    return solution.parameters[0], solution.reasons[0]


def _check_options(residual: str, phong: str, base: str, ridge: float) -> None:
    check_option("fit phong_srf", "residual", residual, RESIDUALS)
    check_option("fit phong_srf", "phong", phong, PHONG_WAYS)
    check_option("fit phong_srf", "base", base, LOBES)
    if not 0 <= ridge < math.inf:
        raise RangeError(message("fit phong_srf", "ridge", "be at least 0 and finite", f"it is {ridge}"))


def _common_texels(size: Tensor, mask: Tensor | None) -> Tensor:
    """Return which texels, of brightness `size` [H, W], share the material's lobe, bool [H, W]: all, or all but a few far brighter ones."""
    known = size.flatten() if mask is None else size[mask]
    bound = known.kthvalue(known.numel() - known.numel() // _TRIMMED).values
    return size <= _OUTLYING * known[known <= bound].double().mean()


def _relative_error(seen: _Seen, lobe: Lobe, parameters: Tensor) -> float | None:
    predicted = lobe.evaluate(parameters, seen.light, seen.view)[:, :, 0, 0]
    return relative(float((predicted - seen.values).square().sum()), float(seen.values.square().sum()))


def _fit_lobe(
    seen: _Seen, lobe: Lobe, phong: str, solver: LevenbergMarquardt
) -> dict[str, tuple[Tensor, str]]:
    """Return (parameters, stop reason) for each way that the data allows; where samples count unlike, for `phong` alone."""
    found = {"mean_brdf": fit_lobe(lobe, *seen[:3], differences=True, importance=seen.importance, solver=solver)}
    if seen.importance is not None and phong == "mean_brdf":
        return found
    per_light = _per_light(lobe, seen, found["mean_brdf"][0], solver)
    return found if per_light is None else found | {"per_light": per_light}


def _per_light(
    lobe: Lobe, seen: _Seen, start: Tensor, solver: LevenbergMarquardt
) -> tuple[Tensor, str] | None:
    light, view, values, groups = seen.light, seen.view, seen.values, seen.group
    rows = [(groups == number).nonzero()[:, 0] for number in groups.unique()]
    rows = [part for part in rows if len(part) >= seen.fewest]
    if not rows:
        return None
    longest = max(map(len, rows))
    # Problems of one batch have one length: short ones repeat their first sample with weight 0.
    index = torch.stack([torch.cat((part, part[:1].expand(longest - len(part)))) for part in rows])
    weight = torch.stack([(torch.arange(longest) < len(part)).double() for part in rows])[:, :, None]
    problem = LobeProblem(lobe, light[index], view[index], values[index], weight)
    way = {"jacobian": by_differences(problem.residual, own_data=True)} if lobe.jacobian is None else {}
    solution = problem.solve(start[None].repeat(len(rows), 1), **way, **limits_of(solver, steps=40, tolerance=1e-6))
    return _average(lobe, solution.parameters), _overall(solution)


def _average(lobe: Lobe, parameters: Tensor) -> Tensor:
    """Return the mean of parameters [light, P]; the angle of a line is averaged as a vector of twice the angle."""
    mean = parameters.mean(dim=0)
    if lobe.axis is not None:
        twice = 2 * parameters[:, lobe.axis]
        mean[lobe.axis] = torch.atan2(torch.sin(twice).mean(), torch.cos(twice).mean()) / 2
    return mean


def _overall(solution: Solution) -> str:
    """One reason for a batch: converged only if every problem did."""
    others = [reason for reason in solution.reasons if reason != CONVERGED]
    return others[0] if others else CONVERGED


_BRUSHED = {"residual": "cosine", "base": "ashikhmin_shirley"}
PHONG_SRF = Recipe(
    PhongSrf, fit_phong_srf, near=True, bytes_per_texel="18", solvers=("lm", "varpro"), solvers_differ=True,
    compared=("", "residual=half_light", "residual=quadratic", "base=ashikhmin_shirley"), rungs=(
        Rung("Phong", "phong_srf", 0, {"residual": "cosine"}, {"residual": StoredAs((1, 1))}),
        Rung("Phong + texture", "phong_srf", 3, {"residual": "cosine"}),
        Rung("Phong + residual of the half vector", "phong_srf", 9, {"residual": "half"}),
        Rung("Phong + residual of half vector and light", "phong_srf", 21, {"residual": "half_light"}),
        # Its lobe grows towards grazing, as that of a lacquer does.
        Rung("Ashikhmin-Shirley", "phong_srf", 0, _BRUSHED, {"residual": StoredAs((1, 1))}, late=True),
        Rung("Ashikhmin-Shirley + texture", "phong_srf", 3, _BRUSHED, late=True),
    ),
)
