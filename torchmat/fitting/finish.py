"""The last steps of a fit on a relief: a loss on the pictures themselves, in which the height moves along.

Until here samples were brought onto the surface, which blurs them and knows of no silhouette. Now rendered pictures are
compared with the images, maps and height descend together, and the slopes hold the height as they do in `refine_height`:
without that tie shallow heights go wrong while the pictures get better. The result is kept only where training samples
that the steps did not see, and those that they did, both come out better.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchmat.fitting.evaluate import evaluate
from torchmat.fitting.objective import DISPLAY, LINEAR, Objective, mean_value
from torchmat.fitting.relief.followed import Followed
from torchmat.fitting.training import Fitted, Training
from torchmat.geometry.normals import pad_border
from torchmat.models import Material
from torchmat.models.fine_relief import FACTOR, seen_along
from torchmat.models.relief_maps import AMBIENT, FINE
from torchmat.models.unbounded import Unbounded
from torchmat.repeatable import one_thread
from torchmat.solvers import Minibatch, Problem
from torchmat.solvers.stop_reasons import DIVERGED, NOT_FINITE

_STEPS, _FEWEST = 160, 10
_RATE = 0.02  # of the maps' parameters, a third of that of a fit from the start
_TEXELS_A_STEP = 0.005  # of the height
_BATCH_VALUES, _FEWEST_IMAGES = 49152, 4  # texels x images of one step
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
        fitted, told = _Finish(training, fitted, moves).run(max(_FEWEST, round(_STEPS * effort)))
    return replace(fitted, figures={**fitted.figures, "finish": told})


def _left_out(training: Training, material: Material) -> dict[str, Any] | None:
    """Return why there is no finish, None where there is one."""
    btf = training.btf
    rays = (len(btf.lights) + 2 * len(btf.views)) * FACTOR**2 * material.texels
    if not material.has_relief or material.relief != FINE:
        why = "the surface has no relief that is followed finely"
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
        specs, values = list(self.bare.own_specs()), dict(self.bare.maps.items())
        if AMBIENT.name in self.material.maps:
            specs, values = [*specs, AMBIENT], {**values, AMBIENT.name: self.material.maps[AMBIENT.name]}
        self.unknowns = Unbounded(specs, values)
        self.height = self.material.maps["height"].detach().clone()
        self.values = values

    def run(self, steps: int) -> tuple[Fitted, dict[str, Any]]:
        """Return the better of the fits before and after, and what is told of it."""
        before = self._errors(self.material)
        reason, start = self._descend(steps), self.material.maps["height"].detach()
        found: dict[str, Any] = {"kept": False, "steps": steps, "before": before, "reason": reason}
        if reason in (NOT_FINITE, DIVERGED):
            return self.fitted, {**found, "why": f"the descent ended with {reason!r}"}
        material = self._made()
        after = self._errors(material)
        found |= {"after": after, "kept": _better(before, after)}
        if not found["kept"]:
            return self.fitted, {**found, "why": "samples that it did not see came out no better"}
        moved = float((self.height - start).square().mean().sqrt()) * start.shape[-1]
        shared = self.fitted.shared.moved_to(material)
        return replace(self.fitted, material=material, shared=shared), {**found, "height_moved_texels": moved}

    def _errors(self, material: Material) -> dict[str, dict[str, float]]:
        return {
            name: {key: evaluate(material, self.training.btf, rows, perceptual=False).report[key] for key in ("psnr_db", "relative_error")}
            for name, rows in (("kept back", self.back), ("training", self.seen))
        }

    def _made(self) -> Material:
        """Return the material of the present maps and height."""
        maps = self.unknowns.made()
        standing = self.material.with_maps(height=self.height)
        own = standing.from_surface({name: value for name, value in maps.items() if name != AMBIENT.name})
        return standing.with_maps(**own, **{name: maps[name] for name in (AMBIENT.name,) if name in maps})

    def _descend(self, steps: int) -> str:
        training, btf, dtype = self.training, self.training.btf, self.training.dtype
        lights, views = (d[:, :, None, None].to(dtype) for d in (btf.lights, btf.views))
        followed, taken = Followed(self.height, lights, views, training.tiles), 0
        parameters, rates = list(self.unknowns.parameters), [_RATE * rate for rate in self.unknowns.rates]
        scale = 1 / self.height.shape[-1]  # the height counts in texels
        offset = torch.zeros_like(self.height).requires_grad_()
        if self.moves:
            parameters, rates = [*parameters, offset], [*rates, _TEXELS_A_STEP]
        if not parameters:
            return NOT_FINITE
        tie, strength = _Tie.to(self.height, training.tiles), 0.0
        start = self.height.clone()

        def objective(rows: Tensor | None) -> float:
            nonlocal taken, strength
            assert rows is not None  # batches alone
            self.height = (start + scale * offset.detach())
            if taken > 0 and taken % _FOLLOWED == 0 and self.moves:
                followed.follow(self.height)
            with torch.enable_grad():
                height = start + scale * offset
                loss = self._loss(followed, height, rows)
                if taken == 0:
                    with one_thread():
                        strength = float(loss.detach()) / (_INDEPENDENT * 3 * len(self.rows))
                taken += 1
                total = loss + strength * tie.misfit(height) if self.moves else loss
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
        own = {name: value for name, value in maps.items() if name != AMBIENT.name}
        light, view = (d[rows][:, :, None, None].to(dtype) for d in (btf.light, btf.view))
        met = followed.on(height, btf.light_index[rows], btf.view_index[rows])
        shaded = self.bare.sharing(own).shade(light, view)
        seen = seen_along(shaded, maps.get(AMBIENT.name), met, self.training.tiles).clamp(min=0)
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
