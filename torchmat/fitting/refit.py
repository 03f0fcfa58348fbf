"""Refit of an edited material: some maps stay as they were painted, the others follow the BTF.

The refinement that Liao 2011 names by hand (section 5.3), for every model: a descent from the material's own maps, which
moves the height as well. Maps that are kept are no unknowns: the result holds the very tensors.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from torchmat.btf import Btf, Split, split_samples
from torchmat.errors import check_positive
from torchmat.fitting.evaluate import evaluate
from torchmat.fitting.descending import Descending
from torchmat.fitting.from_material import check_free, kept_names, onward_of
from torchmat.fitting.objective import Residual, described
from torchmat.fitting.training import Fitted, make_training
from torchmat.models import Material
from torchmat.progress import working
from torchmat.solvers import Minibatch, Solver, Stepping

_CHECKED = 512  # training samples on which the new maps must be the better ones
_ROUNDS = (5 / 14, 9 / 14)  # of the steps, before and after a move of the height
_STEPS, _STEPS_IN_ROUNDS, _RATE = 900, 1400, 0.04  # of a descent on batches


@dataclass(frozen=True)
class Refit:
    """What a refit gives back: the material, and `report`.

    The report holds `held_out_before` and `held_out_after` (as in a fit's report; None without held-out samples),
    `train_before` and `train_after`, `kept` (names of maps), `improved`, `stop_reason`, `seconds`, `samples`, `seed`,
    and `options` (solver and objective).
    """

    material: Material
    report: dict[str, Any]


def refit(
    btf: Btf, material: Material, keep: Sequence[str] = (), *, solver: str | Solver | None = None, steps: int | None = None,
    effort: float = 1.0, objective: str | Residual | None = None, holdout: float = 0.2, holdout_by: str = "pair",
    seed: int = 0, progress: bool | None = None,
) -> Refit:
    """Fit the maps of a material that are not kept anew, starting from what they hold.

    A height that is not kept moves along, and stays where that makes nothing better. When the new maps are no better on the
    training samples, the old ones are returned.

    Args:
        btf: the images, in the material's size.
        material: the material, painted over or not.
        keep: names of maps that have the same bits in the result, as have those that no fit finds anew (`tilt`, the
            directions of a table).
        solver: Minibatch, Adam or LBFGS, or its name; None is Minibatch.
        steps: as many as it takes in all, at least 1; None is as usual.
        effort: factor on the usual number of steps, above 0.
        objective: "linear", "display" or a callable residual(predicted, target, weight); None is that of the model's own
            fit.
        holdout: share of the samples that are measured and never fitted, in [0, 1); give that of the first fit, and its
            `holdout_by` and `seed`, or it has seen them.
        holdout_by: "pair", "light", "view", "both" or "arc" (`split_samples`).
        seed: seed of the split and of the solver, from 0.
        progress: whether to show a bar; None shows it on a terminal.

    Raises RangeError for unknown names or nothing to fit, ShapeError when the sizes differ.
    """
    check_positive("refit", "effort", effort)
    how = onward_of(btf, material, {"solver": solver, "steps": steps, "keep": keep, "objective": objective}, "refit")
    kept = kept_names(material, how.keep, relief=False)
    check_free(material, kept, "refit")
    split = split_samples(btf, holdout, holdout_by, seed)
    training = make_training(btf, split.train, seed, material.tiles, material.dtype, progress)
    before = _measured(material, btf, split, progress)

    seconds = 0.0

    def descended(fixed: Sequence[str]) -> tuple[Fitted, dict[str, Any], Stepping]:
        nonlocal seconds
        start = time.perf_counter()
        with torch.no_grad():
            run = Descending(training, material, fixed, how.objective)
            chosen = _with_usual(how.solver, effort, run.moves_height)
            fitted = run.run(chosen, _ROUNDS if run.moves_height else (1.0,))
        seconds += time.perf_counter() - start
        return fitted, _measured(fitted.material, btf, split, progress), chosen

    fitted, after, chosen = descended(kept)
    free = {spec.name for spec in material.specs()} - set(kept)
    if not _better(after, before) and "height" in free and free != {"height"}:
        fitted, after, chosen = descended([*kept, "height"])  # what the height did may be what made it worse
    improved = _better(after, before)
    found, after = (fitted.material, after) if improved else (material, before)
    report: dict[str, Any] = {
        "kept": kept, "samples": len(btf), "seed": seed, "stop_reason": fitted.stop_reason, "seconds": seconds,
        "improved": improved, "options": described({"solver": chosen, "objective": how.objective}),
    }
    for part in ("train", "held_out"):
        report |= {f"{part}_before": before[part], f"{part}_after": after[part]}
    return Refit(found, report)


def _with_usual(solver: Stepping, effort: float, rounds: bool) -> Stepping:
    """Return the solver with the steps and the rate that are usual where it has none of its own."""
    steps = solver.usual["steps"]
    if isinstance(solver, Minibatch):
        solver, steps = replace(solver, rate=solver.rate or _RATE), _STEPS_IN_ROUNDS if rounds else _STEPS
    return solver.filled(steps=max(1, round(steps * effort)))


def _better(after: dict[str, Any], before: dict[str, Any]) -> bool:
    return after["train"]["psnr_db"] > before["train"]["psnr_db"]


def _measured(material: Material, btf: Btf, split: Split, progress: bool | None) -> dict[str, Any]:
    with working("measuring", progress):
        held_out = evaluate(material, btf, split.held_out, None, progress).report if len(split.held_out) else None
        return {"train": evaluate(material, btf, split.train, _CHECKED, progress).report, "held_out": held_out}
