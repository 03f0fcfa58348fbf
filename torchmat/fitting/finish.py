"""The last steps of a fit on a relief: a loss on the pictures themselves, in which the height moves along.

Until here samples were brought onto the surface, which blurs them and knows of no silhouette. Now rendered pictures are
compared with the images. Short runs say how light between texels is told, and whether the height moves along, held by its
slopes as in `refine_height`: without that tie shallow heights go wrong while the pictures get better. The result is kept
only where training samples that the steps did not see, and those that they did, both come out better.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchmat.fitting.between import chosen, rivals, way_of
from torchmat.fitting.evaluate import evaluate
from torchmat.fitting.objective import DISPLAY, LINEAR, Objective, mean_value
from torchmat.fitting.relief.followed import Followed
from torchmat.fitting.training import Fitted, Training
from torchmat.geometry.normals import pad_border
from torchmat.models import Material
from torchmat.models.fine_relief import FACTOR, seen_along
from torchmat.models.indirect import BETWEEN, BETWEEN_MAPS, Between, between
from torchmat.models.relief_maps import FINE
from torchmat.models.unbounded import Unbounded
from torchmat.repeatable import one_thread
from torchmat.solvers import Minibatch, Problem
from torchmat.solvers.stop_reasons import DIVERGED, NOT_FINITE, STEP_LIMIT

_STEPS, _FEWEST = 240, 10
_RATE = 0.02  # of the maps' parameters, a third of that of a fit from the start
_TEXELS_A_STEP = 0.01  # of the height
_BATCH_VALUES, _FEWEST_IMAGES = 24576, 4  # texels x images of one step
_TRIED = 0.2  # of the steps, to choose the way
_WORTH_DB, _MOVES_DB = 0.1, 0.3  # what the bytes of an ambient map are worth; what a height must bring to move
_FOLLOWED = 40  # steps on rays that were followed once
_KEPT_BACK, _MOST, _FEWEST_BACK = 0.1, 64, 4  # of the training samples
_HIGHLIGHTS = 0.1  # of the linear relative error beside that on a display, whose root lets highlights overshoot
_SLOPE_ERROR, _SLOPE_SHARE, _INDEPENDENT = 0.03, 0.1, 0.03  # as in `refine_height`
_MOST_VALUES = 40_000_000  # of the rays of all lights and views


def finish(training: Training, fitted: Fitted, moves: bool, effort: float = 1.0) -> Fitted:
    """Return a fit after its finish, or as it is where that pays nothing; its figures say which.

    `moves` says that the height may move. Only a relief that is followed finely is finished: in the fast way nothing of a
    silhouette or a shadow is known between texels.
    """
    material = fitted.material
    told = _left_out(training, material)
    if told is None:
        steps = max(_FEWEST, round(_STEPS * effort))
        fitted, told = _in_the_best_way(training, fitted, moves, steps)
    return replace(fitted, figures={**fitted.figures, "finish": told})


def _in_the_best_way(training: Training, fitted: Fitted, moves: bool, steps: int) -> tuple[Fitted, dict[str, Any]]:
    """Return the finish in the way that short ones show to be best: how light between texels is told, and whether the height moves.

    A height that moves takes up what the appearance cannot say as well, and gets worse by it: it moves only where that brings
    much, which appearance alone cannot be what is wrong.
    """
    standing, short = fitted.material, max(1, round(_TRIED * steps))
    ways = rivals(training, standing)
    runs = [_Finish(training, replace(fitted, material=one), False) for one in ways]
    told: dict[str, Any] = {}
    if len(runs) == 1 and not moves:
        run = runs[0]
    else:
        errors = [run.tried(short) for run in runs]
        best, steps = chosen(errors, _WORTH_DB), steps - short
        run, told["light_between"] = runs[best], {way_of(one.material): error for one, error in zip(runs, errors, strict=True)}
        if moves:
            moving = _Finish(training, replace(fitted, material=ways[best]), True)
            gained = moving.tried(short) - errors[best]
            told["height_moves"], told["height_gains_db"] = gained > _MOVES_DB, gained
            run = moving if gained > _MOVES_DB else run
    finished, figures = run.run(steps, standing)
    return replace(finished, figures={**finished.figures, "indirect": way_of(finished.material)}), {**figures, **told}


def _left_out(training: Training, material: Material) -> dict[str, Any] | None:
    """Return why there is no finish, None where there is one."""
    btf = training.btf
    rays = (len(btf.lights) + 2 * len(btf.views)) * FACTOR**2 * material.texels
    if not material.has_relief or material.relief != FINE:
        why = "the surface has no relief that is followed finely"
    elif btf.near is not None:
        why = "lights or cameras are near: its rays are those of far ones"
    elif training.watch.spent:
        why = "no seconds were left"
    elif rays > _MOST_VALUES:
        why = f"{rays:,} rays are too many to be kept"
    elif int(training.used.sum()) < 2 * _FEWEST_BACK:
        why = "there are too few samples to keep some back"
    else:
        return None
    return {"kept": False, "why": why}


@dataclass(frozen=True)
class _Tie:
    """What holds a height: its slopes [2, H, W] from texel to texel as they were found, and how much each counts.

    The normals of the appearance and the images have agreed on them (`refine_height`).
    """

    slope: Tensor
    trust: Tensor
    tiles: bool

    @classmethod
    def to(cls, height: Tensor, tiles: bool) -> _Tie:
        """Tie to a height [1, H, W], where it is steep less tightly: slopes are off by a share of themselves."""
        slope = _steps(height, tiles)
        return cls(slope, 1 / (_SLOPE_ERROR + _SLOPE_SHARE * slope.abs()).square(), tiles)

    def misfit(self, height: Tensor) -> Tensor:
        """Return the mean over texels of squared differences of slopes, in their variances."""
        return (self.trust * (_steps(height, self.tiles) - self.slope).square()).mean() * 2


def _steps(height: Tensor, tiles: bool) -> Tensor:
    """Return the slopes [2, H, W] from each texel to its right and its upper neighbour; 0 across an open border."""
    wide = pad_border(height[None], tiles)[0]
    return torch.cat((wide[:, 1:-1, 2:] - height, wide[:, :-2, 1:-1] - height)) * height.shape[-1]


class _Finish:
    """One finish in progress."""

    def __init__(self, training: Training, fitted: Fitted, moves: bool) -> None:
        self.training, self.fitted, self.material, self.moves = training, fitted, fitted.material, moves
        rows = training.used.nonzero()[:, 0]
        order = rows[torch.randperm(len(rows), generator=torch.Generator().manual_seed(training.seed + 1))]
        count = min(_MOST, max(_FEWEST_BACK, round(_KEPT_BACK * len(rows))))
        self.back, self.rows = order[:count].sort().values, order[count:].sort().values
        self.seen = self.rows[torch.linspace(0, len(self.rows) - 1, min(count, len(self.rows))).round().long()]
        level = mean_value(training)
        self.objectives = Objective(DISPLAY, level), Objective(LINEAR, level)
        self.sizes = [self._size_of_black(objective) for objective in self.objectives]
        self.bare = self.material.surface()
        more = [spec for spec in BETWEEN_MAPS if spec.name in self.material.maps]
        self.values = {**self.bare.maps, **{spec.name: self.material.maps[spec.name] for spec in more}}
        self.unknowns = Unbounded([*self.bare.own_specs(), *more], self.values)
        self.height = self.material.maps["height"].detach().clone()
        self.tie, self.strength = _Tie.to(self.height, training.tiles), 0.0

    def tried(self, steps: int) -> float:
        """Go so many steps on, and return the dB of samples that they did not see."""
        self._descend(steps)
        self.material = self._made()
        return self._error(self.material, self.back)["psnr_db"]

    def run(self, steps: int, standing: Material) -> tuple[Fitted, dict[str, Any]]:
        """Return the better of the finished fit and that of the `standing` material, and what is told of it."""
        before = self._errors(standing)
        reason = self._descend(steps)
        found: dict[str, Any] = {"kept": False, "steps": steps, "before": before, "reason": reason}
        fitted = replace(self.fitted, material=standing)
        if reason in (NOT_FINITE, DIVERGED):
            return fitted, {**found, "why": f"the descent ended with {reason!r}"}
        material = self._made()
        after = self._errors(material)
        found |= {"after": after, "kept": _better(before, after)}
        if not found["kept"]:
            return fitted, {**found, "why": "samples that it did not see came out no better"}
        moved = float((self.height - standing.maps["height"].detach()).square().mean().sqrt()) * self.height.shape[-1]
        shared = self.fitted.shared.moved_to(material)
        return replace(self.fitted, material=material, shared=shared), {**found, "height_moved_texels": moved}

    def _errors(self, material: Material) -> dict[str, dict[str, float]]:
        return {name: self._error(material, rows) for name, rows in (("kept back", self.back), ("training", self.seen))}

    def _error(self, material: Material, rows: Tensor) -> dict[str, float]:
        report = evaluate(material, self.training.btf, rows, perceptual=False).report
        return {key: report[key] for key in ("psnr_db", "relative_error")}

    def _made(self) -> Material:
        """Return the material of the present maps and height."""
        maps = self.unknowns.made()
        standing = self.material.with_maps(height=self.height)
        return standing.with_maps(**standing.from_surface(maps))

    def _descend(self, steps: int) -> str:
        training, btf, dtype = self.training, self.training.btf, self.training.dtype
        lights, views = (d[:, :, None, None].to(dtype) for d in (btf.lights, btf.views))
        followed, taken = Followed(self.height, lights, views, training.tiles), 0
        parameters, rates = list(self.unknowns.parameters), [_RATE * rate for rate in self.unknowns.rates]
        scale = 1 / self.height.shape[-1]  # the height counts in texels
        offset = torch.zeros_like(self.height).requires_grad_()
        if self.moves:
            parameters, rates = [*parameters, offset], [*rates, _TEXELS_A_STEP]
        if not parameters or steps < 1:
            return NOT_FINITE if not parameters else STEP_LIMIT
        start = self.height.clone()

        def objective(rows: Tensor | None) -> float:
            nonlocal taken
            assert rows is not None  # batches alone
            self.height = (start + scale * offset.detach())
            if taken > 0 and taken % _FOLLOWED == 0 and self.moves:
                followed.follow(self.height)
                self.material = self._made()  # light between texels is that of the present height and colours
            with torch.enable_grad():
                height = start + scale * offset
                loss = self._loss(followed, height, rows)
                if self.strength == 0:
                    with one_thread():
                        self.strength = float(loss.detach()) / (_INDEPENDENT * 3 * len(self.rows))
                taken += 1
                total = loss + self.strength * self.tie.misfit(height) if self.moves else loss
            if math.isfinite(float(total.detach())):
                total.backward()
            return float(total.detach())

        batch = max(_FEWEST_IMAGES, _BATCH_VALUES // self.material.texels)
        found = Minibatch(steps, _RATE).descend(Problem(
            parameters, objective, [rate / _RATE for rate in rates], lambda generator: training.drawn(self.rows, generator), batch,
            training.seed, watch=training.watch, show=training.progress,
        ))
        self.height = (start + scale * offset.detach()) if self.moves else start
        return found.reason

    def _loss(self, followed: Followed, height: Tensor, rows: Tensor) -> Tensor:
        """Return the mean squared error of the pictures of some samples, on a display and linear."""
        btf, dtype = self.training.btf, self.training.dtype
        maps: Mapping[str, Tensor] = {**self.values, **self.unknowns.maps()}
        own = {name: value for name, value in maps.items() if name not in BETWEEN}
        light, view = (d[rows][:, :, None, None].to(dtype) for d in (btf.light, btf.view))
        met = followed.on(height, btf.light_index[rows], btf.view_index[rows])
        shaded = self.bare.sharing(own).shade(light, view)
        sent: Between | None = between(self.material, light, maps)
        seen = seen_along(shaded, sent, met, self.training.tiles).clamp(min=0)
        target = btf.images(rows, dtype)
        weight = btf.weights(rows).to(dtype)
        on_display, linear = (
            objective.squares(seen, target, weight).mean() / size
            for objective, size in zip(self.objectives, self.sizes, strict=True)
        )
        return on_display + _HIGHLIGHTS * linear

    def _size_of_black(self, objective: Objective) -> float:
        """Return the mean square that a black picture leaves, the unit of a relative error."""
        total = 0.0
        for part in self.seen.split(_FEWEST_IMAGES):
            images = self.training.btf.images(part, self.training.dtype)
            weight = self.training.btf.weights(part).to(images.dtype)
            total += float(objective.squares(torch.zeros_like(images), images, weight).mean(dtype=torch.float64)) * len(part)
        return max(total / len(self.seen), 1e-30)


def _better(before: dict[str, dict[str, float]], after: dict[str, dict[str, float]]) -> bool:
    """Return whether both parts come out better on a display, and neither worse in relative error."""
    return all(
        after[part]["psnr_db"] > before[part]["psnr_db"] and after[part]["relative_error"] <= before[part]["relative_error"]
        for part in before
    )
