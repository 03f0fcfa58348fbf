"""Fits of every model over a relief: the same closed forms, on samples that are brought onto the surface."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import RangeError, ShapeError, check_finite, check_option, message
from torchmat.fitting.evaluate import evaluate
from torchmat.fitting.models.distribution.fit import fit_distribution_on_relief
from torchmat.fitting.models.linear import fit_lambert_on_relief
from torchmat.fitting.recipes import FITTERS
from torchmat.fitting.relief.recover import recover_relief
from torchmat.fitting.relief.surface import Sight, ambient_and_usual, bring_onto, without_shadow
from torchmat.fitting.relief.window import Window
from torchmat.fitting.training import Fitted, Training
from torchmat.geometry.normals import LARGEST_SCALE
from torchmat.solvers.clock import Watch
from torchmat.solvers.stop_reasons import BUDGET

GEOMETRIES = ("flat", "recover")
_VALIDATION, _VALIDATION_SAMPLES = 0.1, 200
_COMPARING = 0.2  # of the seconds that are left, for each of the two fits that say what a relief is worth
# What a relief is worth shows long before the last step of an iterative fit.
_QUICK = {
    "distribution": {"lobes": 1, "fresnel": "yes", "rotation": "yes", "effort": 0.15}, "neural": {"effort": 0.1},
}


def check_given_height(height: Tensor, training: Training) -> Tensor:
    """Return a height map that the user gives as [1, H, W]; raises ShapeError or RangeError when it cannot be one."""
    size = (training.btf.height, training.btf.width)
    height = height.detach()
    height = height[None] if height.ndim == 2 else height
    if height.shape != (1, *size):
        step = "Resample it, or crop the images: texel by texel they must show the same place."
        raise ShapeError(message("fit", "geometry", f"be [1, {size[0]}, {size[1]}]", f"it is {tuple(height.shape)}", step))
    check_finite("fit", "geometry", height)
    span = float(height.max() - height.min())
    reach = float(height.abs().max())
    if span == 0 or reach >= LARGEST_SCALE:
        fact = "it is the same everywhere" if span == 0 else f"it reaches {reach:g} texture widths"
        step = "Heights are in texture widths; leave geometry out for a flat surface."
        raise RangeError(message("fit", "geometry", "be a height map of a surface", fact, step))
    return height


# Models that fit shadow and ambient themselves; they return None for options that need the common way.
_OWN_WAYS: dict[str, Callable[..., Fitted | None]] = {
    "lambert": fit_lambert_on_relief, "distribution": fit_distribution_on_relief,
}


def fit_on_relief(
    training: Training, model: str, options: dict[str, Any], height: Tensor, window: Window | None = None,
    sight: Sight | None = None,
) -> Fitted:
    """Fit a model to the samples on the surface of `height` and return it on that relief.

    Of a `window` only its texels are fitted; `sight` is that of the whole height where it is known.
    """
    height = height.to(training.dtype)
    surface = bring_onto(training, height, window=window, sight=sight)
    height = height if window is None else window.crop(height)
    fitted = _OWN_WAYS[model](surface, height, **options) if model in _OWN_WAYS else None
    if fitted is not None:
        return fitted
    shadowed, usual = ambient_and_usual(surface)
    fitted = fit_flat(without_shadow(surface, shadowed), model, options)
    material = fitted.material.on_relief(height, shadowed)
    return replace(fitted, material=material, shared={**fitted.shared, "usual_ambient": usual})


def fit_flat(training: Training, model: str, options: dict[str, Any]) -> Fitted:
    """Fit a model to a flat surface, which repeats or not as the training says."""
    fitted = FITTERS[model](training, **options)
    return replace(fitted, material=fitted.material.repeating(training.tiles))


def fit_with_geometry(
    training: Training, model: str, options: dict[str, Any], geometry: str | Tensor,
    recovered_from: Training | None = None,
) -> Fitted:
    """Fit a model on a flat surface, on a given height map, or on the relief that the data shows ("recover").

    A relief that was recovered is kept if it makes the model better on training samples that neither fit has seen;
    what was compared stands in the figures. `recovered_from` are samples of the same texels that the relief is
    recovered from, where they are not those that are fitted.

    Recovery and comparison count as time of the fit. A recovery that ran out of it gives a coarser relief, and where no
    time is left for more the surface is flat: the reason is "budget spent" either way.
    """
    if isinstance(geometry, Tensor):
        return fit_on_relief(training, model, options, check_given_height(geometry, training))
    check_option("fit", "geometry", geometry, GEOMETRIES)
    if geometry == "flat":
        return fit_flat(training, model, options)
    start = time.perf_counter()
    relief, figures = recover_relief(recovered_from or training)
    figures = {**figures, "recovery_seconds": time.perf_counter() - start}
    height, raised = relief.height, float(relief.height.abs().max()) > 0
    cut = figures["stop_reason"] == BUDGET or (raised and training.watch.spent)
    if not raised or training.watch.spent:
        chosen = "flat"
    else:
        chosen, compared = compare_with_flat(training, model, options, height)
        figures |= {"chosen": chosen, "validation_psnr_db": compared}
    if chosen == "flat":
        fitted = fit_flat(training, model, options)
    else:
        fitted = replace(fit_on_relief(training, model, options, height), relief=relief)
    figures = {**fitted.figures, "geometry": {**figures, "chosen": chosen}}
    return replace(fitted, stop_reason=BUDGET if cut else fitted.stop_reason, figures=figures)


def compare_with_flat(training: Training, model: str, options: dict[str, Any], height: Tensor) -> tuple[str, dict[str, float]]:
    """Return "flat" or "recover", whichever is better on a tenth of the training samples, and the PSNR of both."""
    rows = training.used.nonzero()[:, 0]
    generator = torch.Generator().manual_seed(training.seed)
    kept_back = rows[torch.randperm(len(rows), generator=generator)[: max(1, round(_VALIDATION * len(rows)))]].sort().values
    used = training.used.clone()
    used[kept_back] = False
    if not bool(used.any()):
        return "recover", {}
    seconds = _COMPARING * max(0.0, training.watch.limit - training.watch.seconds)
    quick = {**options, **_QUICK.get(model, {})}

    def part() -> Training:
        return replace(training, used=used, watch=Watch(seconds))

    rivals = {"flat": fit_flat(part(), model, quick), "recover": fit_on_relief(part(), model, quick, height)}
    found = {
        way: evaluate(fitted.material, training.btf, kept_back, _VALIDATION_SAMPLES).report["psnr_db"]
        for way, fitted in rivals.items()
    }
    return max(found, key=found.__getitem__), found
