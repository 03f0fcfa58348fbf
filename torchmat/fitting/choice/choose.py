"""The choice among models: the smallest material that is as true as wanted, or the best one within a budget.

It climbs from cheap to dear: a constant, a texture, Lambert, Phong, residuals and polynomials, all in closed form; the
same on a relief that is recovered once; then what is built part by part, the distribution material. What is tried is
measured, as its textures would bring it back, on training samples that no candidate was fitted to, and every decision
is written down with its numbers. The material chosen is stored as small as the target allows (`shrink`).
"""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from typing import Any

from torch import Tensor

from torchmat.errors import FitError, RangeError, message
from torchmat.fitting.choice.candidate import Option, fit_rung
from torchmat.fitting.choice.climb import SPENT, Climb
from torchmat.fitting.choice.decisions import gain_db
from torchmat.fitting.choice.ladder import built_by_parts, last_rungs, named
from torchmat.fitting.choice.measured import MARGIN, most_on_highlights
from torchmat.fitting.choice.shrink import Shrunk, total_bytes
from torchmat.fitting.finish import finish
from torchmat.fitting.geometry import Geometry, Given, Recover, check_height
from torchmat.fitting.recipe import recipe_of
from torchmat.fitting.relief.recover import Recovery, recover_relief
from torchmat.fitting.training import Fitted, Training
from torchmat.fitting.wanted import Target
from torchmat.models import Material
from torchmat.models.relief_maps import FINE

MET, NOT_MET, WITHIN = "target met", "target not met", "best within the budget"
_FINISH_DB = 3.0  # more than a finish has ever brought (0.6 to 1.7)
_RECOVERY = 10  # times the seconds of all flat candidates: what a recovery took at least on the data measured so far


def fit_auto(training: Training, target: Target, geometry: Geometry) -> Fitted:
    """Return the smallest material that meets the target, bytes that all texels share included.

    With `bytes` or `seconds` alone it is the best one within them. A target that nothing meets gives the nearest
    material and the stop reason "target not met". Samples kept back must be better than wanted by a margin of 5 % of
    the error, 0.22 dB. A wish in dB is met where highlights are kept besides (`Target.highlights`). A `geometry` of
    Recover leaves the relief to the data, Flat forbids it, a Given one is taken as it is. Closed forms are fitted again to
    all training samples once they are chosen; what takes steps stays as it was fitted without those kept back. The report's
    figures say under "auto" what was tried, what it brought, and why it was kept or left. Deterministic for a seed unless
    the `seconds` run out.
    Raises RangeError when nothing is wanted or fewer bytes than a constant takes, FitError when the seconds do not
    suffice for one.
    """
    _check_target(target, training)
    given = check_height(geometry.height, training.btf).to(training.dtype) if isinstance(geometry, Given) else None
    climb = Climb(training, target)
    if given is not None:
        climb.relief(given)
        _check_seconds(climb)
        for recipe in built_by_parts():
            if _goes_on(climb, recipe.name):
                climb.by_parts(recipe, given)
        _try_finished(climb, moves=False)
        _try_the_last(climb, given)
        return _finished(climb, _delivered(climb, None), moves=False)
    climb.flat()
    _check_seconds(climb)
    recovery = _recovered(climb) if isinstance(geometry, Recover) and _goes_on(climb, "relief") else None
    if recovery is not None and _goes_on(climb, "the closed forms on a relief"):
        climb.relief(recovery.relief.height)
    for recipe in built_by_parts():
        if _goes_on(climb, recipe.name):
            helps = recovery is not None and _relief_helps(climb, recipe.name)
            climb.by_parts(recipe, recovery.relief.height if recovery and helps else None)
    _try_finished(climb, moves=True)
    _try_the_last(climb, recovery.relief.height if recovery and climb.best.height is not None else None)
    return _finished(climb, _delivered(climb, recovery), moves=True)


def _try_finished(climb: Climb, moves: bool) -> None:
    """Finish the truest candidate on a relief where none is what is wanted: that is worth a decibel or two, and its maps can be painted."""
    rivals = [one for one in climb.options if one.height is not None and not (one.short or one.thin)]
    if climb.limit is None or climb.met or not rivals or not climb.training.finish:
        return
    truest = min(rivals, key=lambda option: option.cost_in_full)
    name, start = f"the finish of {truest.name}", climb.watch.seconds
    if gain_db(truest.cost_in_full, climb.limit) > _FINISH_DB:
        climb.log.skip(name, f"the target is more than {_FINISH_DB:g} dB away")
        return
    if climb.watch.spent:
        climb.log.skip(name, SPENT)
        return
    done = _after_finish(climb, truest.fitted, moves)
    if not done.figures["finish"]["kept"]:
        climb.log.skip(name, done.figures["finish"]["why"])
        return
    climb.finished(truest, done, start)


def _after_finish(climb: Climb, fitted: Fitted, moves: bool) -> Fitted:
    """Return what a finish makes of a material on a relief, followed finely, by the samples that candidates are fitted to."""
    training = replace(climb.part, relief=FINE, progress=climb.training.progress)
    return finish(training, replace(fitted, material=fitted.material.with_relief(FINE)), moves)


def _try_the_last(climb: Climb, height: Tensor | None) -> None:
    """Try what no map of can be painted, where nothing that can is what is wanted."""
    for rung in last_rungs():
        if _goes_on(climb, named(rung, height)):
            climb.at_last(rung, height)


def _finished(climb: Climb, fitted: Fitted, moves: bool) -> Fitted:
    """Return the material chosen after its finish, followed finely, where samples kept back come out better as it is stored."""
    material = fitted.material
    if not climb.training.finish or not material.has_relief or climb.watch.spent or "finish" in fitted.figures:
        return fitted
    done = _after_finish(climb, fitted, moves)
    if not done.figures["finish"]["kept"]:
        return replace(fitted, figures=done.figures)
    found = climb.examiner.measure(done.material)
    before, after = (one.cost(climb.target) for one in (climb.examiner.measure(material), found))
    larger = total_bytes(done.material) > max(total_bytes(material), climb.most_bytes)
    if after >= before or larger:
        told = {**done.figures["finish"], "kept": False, "why": "stored as small as it is, it came out no better"}
        return replace(fitted, figures={**done.figures, "finish": told})
    chosen = {**fitted.figures["auto"]["chosen"], **found._asdict()}
    met = climb.limit is not None and fitted.stop_reason == NOT_MET and after <= climb.limit
    auto = {**fitted.figures["auto"], "chosen": chosen, **({"outcome": MET, "short_by_db": None} if met else {})}
    return replace(done, stop_reason=MET if met else fitted.stop_reason, figures={**done.figures, "auto": auto})


def _check_target(target: Target, training: Training) -> None:
    if replace(target, highlights=None) == Target():
        step = "Give error, psnr, bytes or seconds."
        raise RangeError(message("fit auto", "the target", "say what is wanted", "it says nothing", step))
    least = 12 / (training.btf.height * training.btf.width)
    if target.bytes is not None and target.bytes < least:
        step = f"Give at least {least:.3g}, which holds one colour for all texels."
        raise RangeError(message("fit auto", "bytes", "hold a material", f"it is {target.bytes:.3g} a texel", step))


def _check_seconds(climb: Climb) -> None:
    """Raise FitError when the first candidate alone took longer than is allowed."""
    seconds = climb.log.rows[0]["at_seconds"]
    if climb.target.seconds is not None and seconds > climb.target.seconds:
        step = f"Allow at least {seconds:.2g} seconds."
        fact = f"a constant colour alone took {seconds:.2g} of {climb.target.seconds:g}"
        raise FitError(message("fit auto", "seconds", "suffice for the cheapest material", fact, step))


def _goes_on(climb: Climb, what: str) -> bool:
    """Return whether the climb goes on with `what`; note why if it does not."""
    if climb.watch.spent:
        climb.log.skip(what, SPENT)
    elif climb.met:
        climb.log.skip(what, "what is cheaper meets the target")
    elif what == "relief" and climb.watch.limit - climb.watch.seconds < _RECOVERY * climb.watch.seconds:
        climb.log.skip(what, "its recovery would not be done in time")
    else:
        return True
    return False


def _recovered(climb: Climb) -> Recovery | None:
    """Return the relief of the samples that candidates are fitted to; None if there is none, noting why."""
    start = climb.watch.seconds
    try:
        recovery = recover_relief(climb.part)
    except (FitError, RangeError) as error:
        climb.log.skip("relief", str(error))
        return None
    seconds = climb.watch.seconds - start
    if float(recovery.relief.height.abs().max()) == 0:
        climb.log.skip("relief", f"the images agree best on a flat surface ({seconds:.1f} s)")
        return None
    climb.log.note("relief", f"recovered in {seconds:.1f} s, {recovery.method}", seconds)
    return recovery


def _relief_helps(climb: Climb, model: str) -> bool:
    """Return whether the truest of the closed forms on the relief is truer there than flat.

    Like beside like: what follows highlights, which no closed form on a relief does, may be truer flat than all of them, and
    says nothing of the relief.
    """
    flat = {option.rung.name: option for option in climb.options if option.height is None}
    on_relief = [option for option in climb.options if option.height is not None and option.rung.name in flat]
    if not on_relief:
        return False
    truest = min(on_relief, key=lambda option: option.cost_in_full)
    helps = truest.cost_in_full < flat[truest.rung.name].cost_in_full
    if not helps:
        climb.log.skip(f"{model} on relief", f"{flat[truest.rung.name].name} is no truer on the relief than flat")
    return helps


def _delivered(climb: Climb, recovery: Recovery | None) -> Fitted:
    """Return the material chosen, fitted to all samples if that is a closed form, and stored as was measured."""
    best = climb.whole(climb.best)
    if best.shrunk is None:
        too_large = climb.bytes_of(best) > climb.most_bytes
        in_time = too_large or not climb.watch.spent
        best = climb.shrunk(best) if in_time else replace(best, shrunk=Shrunk(best.material, best.cost))
    fitted, material = best.fitted, best.material
    takes_steps = recipe_of(best.rung.model).iterates or "finish" in fitted.figures
    if not takes_steps and not climb.watch.spent:
        fitted = fit_rung(climb.knowing(climb.training, best), best.rung, best.height)
        material = fitted.material.stored_at(material.stored)
    relief = recovery.relief if recovery is not None and best.height is not None else None
    reason = WITHIN if climb.limit is None else MET if climb.meets(best) else NOT_MET
    figures = {**fitted.figures, "auto": _figures(climb, best, reason)}
    if recovery is not None:
        figures["geometry"] = {**recovery.figures(), "chosen": "flat" if best.height is None else "recover"}
    return replace(fitted, material=material, stop_reason=reason, figures=figures, relief=relief, options=best.rung.settings)


def _figures(climb: Climb, best: Option, reason: str) -> dict[str, Any]:
    """Return what the report says of the choice."""
    measured = climb.examiner.measure(best.material)
    return {
        "target": dataclasses.asdict(climb.target), "margin": MARGIN, "outcome": reason,
        "short_by_db": measured.short_by_db(climb.target) if reason == NOT_MET else None,
        "decided_by": measured.decided_by(climb.target),
        "highlights": {
            "from": climb.examiner.highlights_from, "at_most": most_on_highlights(climb.target),
            "lost": measured.loses_highlights(climb.target),
        },
        "validation_samples": climb.examiner.samples, "candidates": climb.log.rows,
        "chosen": {
            "candidate": best.name, "model": best.rung.model, "options": best.rung.settings,
            "fit_stopped": best.fitted.stop_reason, "relief": best.height is not None,
            "bytes": total_bytes(best.material), "bytes_per_texel": best.material.bytes_per_texel,
            "shared_bytes": best.material.shared_bytes,
            **measured._asdict(), "maps": _stored_maps(best.material),
        },
        "shrinking": [_told(climb, step) for step in (best.shrunk.steps if best.shrunk else ())],
    }


def _told(climb: Climb, step: dict[str, Any]) -> dict[str, Any]:
    """Return a step of shrinking with its errors."""
    told = {name: step[name] for name in ("map", "stored", "bytes")}
    return {**told, **climb.examiner.measure(step["alone"])._asdict()}


def _stored_maps(material: Material) -> list[dict[str, Any]]:
    """Return how each texture of the material is stored."""
    rows = [
        {"map": spec.name, "texture": name, "size": list(value.shape[-2:]), "channels": len(value), "storage": storage}
        for spec, name, value, storage, _ in material.textures()
    ]
    return rows + [{"map": spec.name, "numbers": value.tolist()} for spec, value in material.numbers()]
