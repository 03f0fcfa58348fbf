"""Fits of every model over a relief: the same closed forms, on samples that are brought onto the surface."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import FitError, RangeError
from torchmat.fitting.between import settled
from torchmat.fitting.evaluate import evaluate
from torchmat.fitting.finish import finish
from torchmat.fitting.geometry import FLAT, Flat, Geometry, Given, check_height
from torchmat.fitting.recipe import recipe_of
from torchmat.fitting.relief.recover import recover_relief
from torchmat.fitting.relief.surface import Sight, ambient_and_usual, bring_onto, without_shadow
from torchmat.fitting.relief.window import Window
from torchmat.fitting.training import Fitted, Training
from torchmat.models import Material
from torchmat.models.relief_maps import FINE
from torchmat.progress import working
from torchmat.solvers.clock import Watch
from torchmat.solvers.stop_reasons import BUDGET

_VALIDATION, _VALIDATION_SAMPLES = 0.1, 200
_PSNR, _RELATIVE = "psnr_db", "relative_error"
_COMPARING = 0.2  # of the seconds that are left, for each of the two fits that say what a relief is worth


def fit_on_relief(
    training: Training, model: str, options: dict[str, Any], height: Tensor, window: Window | None = None,
    sight: Sight | None = None,
) -> Fitted:
    """Fit a model to the samples on the surface of `height` and return it on that relief.

    The height stays as it is. Of a `window` only its texels are fitted; `sight` is that of the whole height where it is known.
    """
    height = height.to(training.dtype)
    surface = bring_onto(training, height, window=window, sight=sight)
    height = height if window is None else window.crop(height)
    fitted = recipe_of(model).run_on_relief(surface, height, options)
    if fitted is not None:
        return fitted.with_material(fitted.material.with_relief(training.relief))
    shadowed, usual = ambient_and_usual(surface)
    fitted = fit_flat(without_shadow(surface, shadowed), model, options)
    material = fitted.material.on_relief(height, shadowed)
    return replace(fitted, material=material, shared=replace(fitted.shared, usual_ambient=usual))


def fit_flat(training: Training, model: str, options: dict[str, Any]) -> Fitted:
    """Fit a model to a flat surface, which repeats, and is followed where it gets a height, as the training says."""
    fitted = recipe_of(model).run(training, **options)
    return replace(fitted, material=fitted.material.repeating(training.tiles).with_relief(training.relief))


def fit_with_geometry(
    training: Training, model: str, options: dict[str, Any], geometry: Geometry,
    recovered_from: Training | None = None,
) -> Fitted:
    """Fit a model on a flat surface, on a given height map, or on the relief that the data shows ("recover").

    A relief that was recovered is kept if it makes the model better on training samples that neither fit has seen;
    what was compared stands in the figures. `recovered_from` are samples of the same texels that the relief is
    recovered from, where they are not those that are fitted.

    Recovery and comparison count as time of the fit. A recovery that ran out of it gives a coarser relief, and where no
    time is left for more the surface is flat: the reason is "budget spent" either way.
    """
    if isinstance(geometry, Given):
        fitted = fit_on_relief(training, model, options, check_height(geometry.height, training.btf))
        return _finished(training, fitted, options, moves=False)
    if isinstance(geometry, Flat):
        return fit_flat(training, model, options)
    start = time.perf_counter()
    try:
        with working("recovering the relief", training.progress):
            recovery = recover_relief(recovered_from or training)
    except (FitError, RangeError) as error:
        if not geometry.or_flat:
            raise
        fitted = fit_flat(training, model, options)
        return replace(fitted, figures={**fitted.figures, "geometry": not_recovered(error)})
    relief = recovery.relief
    figures = {**recovery.figures(), "recovery_seconds": time.perf_counter() - start}
    height, raised = relief.height, float(relief.height.abs().max()) > 0
    cut = recovery.stop_reason == BUDGET or (raised and training.watch.spent)
    if not raised or training.watch.spent:
        chosen = "flat"
    else:
        with working("comparing the relief with a flat surface", training.progress):
            chosen, rivals = compare_with_flat(training, model, options, height)
        compared = {way: errors[_PSNR] for way, errors in rivals.items()}
        figures |= {"chosen": chosen, "validation_psnr_db": compared}
    if chosen == "flat":
        fitted = fit_flat(training, model, options)
    else:
        fitted = replace(fit_on_relief(training, model, options, height), relief=relief)
        if compared and recipe_of(model).iterates:
            fitted, told = _or_flat(training, model, options, fitted, rivals)
            figures, chosen = figures | told, told.get("chosen", chosen)
        if chosen != FLAT:
            fitted = _finished(training, fitted, options, moves=True)
    figures = {**fitted.figures, "geometry": {**figures, "chosen": chosen}}
    return replace(fitted, stop_reason=BUDGET if cut else fitted.stop_reason, figures=figures)


def _finished(training: Training, fitted: Fitted, options: dict[str, Any], moves: bool) -> Fitted:
    """Return a fit after its finish, where one is wanted; of as many steps as the effort of the fit says."""
    fitted = settled(training, fitted)
    wanted = training.finish and training.relief == FINE
    return finish(training, fitted, moves, options.get("effort", 1.0)) if wanted else fitted


def not_recovered(error: Exception) -> dict[str, str]:
    """Return what the report says of a surface that is flat because nothing else could be found."""
    return {"chosen": "flat", "not_recovered": str(error)}


def _or_flat(
    training: Training, model: str, options: dict[str, Any], fitted: Fitted, rivals: dict[str, dict[str, float]]
) -> tuple[Fitted, dict[str, Any]]:
    """Return the fit on a relief, or that on a flat surface where it ended worse than even the short one, and why.

    Both errors count, in dB: that on a display sees no highlight above white, the relative one little else.
    """
    rows = _kept_back(training)

    def errors_of(material: Material) -> dict[str, float]:
        return evaluate(material, training.btf, rows, _VALIDATION_SAMPLES, perceptual=False).report

    ended = errors_of(fitted.material)
    if _decibels(ended) >= _decibels(rivals[FLAT]) or training.watch.spent:
        return fitted, {}
    flat = fit_flat(training, model, options)
    found = errors_of(flat.material)
    if _decibels(found) <= _decibels(ended):
        return fitted, {}
    said = (
        f"the fit on the relief ended ({fitted.stop_reason}) at {ended[_PSNR]:.1f} dB and a relative error of "
        f"{ended[_RELATIVE]:.3g} on training samples, the flat one at {found[_PSNR]:.1f} dB and {found[_RELATIVE]:.3g}"
    )
    return flat, {"chosen": FLAT, "fell_back": said}


def _decibels(errors: dict[str, float]) -> float:
    """Return the sum of both errors in dB."""
    return errors[_PSNR] - 10 * math.log10(max(errors[_RELATIVE] or 0.0, 1e-20))


def _kept_back(training: Training) -> Tensor:
    """Return the training samples that say what a relief is worth."""
    rows = training.used.nonzero()[:, 0]
    generator = torch.Generator().manual_seed(training.seed)
    return rows[torch.randperm(len(rows), generator=generator)[: max(1, round(_VALIDATION * len(rows)))]].sort().values


def compare_with_flat(
    training: Training, model: str, options: dict[str, Any], height: Tensor
) -> tuple[str, dict[str, dict[str, float]]]:
    """Return "flat" or "recover", whichever has more dB on a tenth of the training samples, and the errors of both."""
    kept_back = _kept_back(training)
    used = training.used.clone()
    used[kept_back] = False
    if not bool(used.any()):
        return "recover", {}
    seconds = _COMPARING * max(0.0, training.watch.limit - training.watch.seconds)
    quick = {**options, **recipe_of(model).quick}

    def part() -> Training:
        return replace(training, used=used, watch=Watch(seconds))

    rivals = {"flat": fit_flat(part(), model, quick), "recover": fit_on_relief(part(), model, quick, height)}
    found = {
        way: evaluate(fitted.material, training.btf, kept_back, _VALIDATION_SAMPLES, perceptual=False).report
        for way, fitted in rivals.items()
    }
    return max(found, key=lambda way: found[way][_PSNR]), found
