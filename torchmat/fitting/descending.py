"""Descents from the maps of any material, flat or over the relief that it has, with a height that may move along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchmat.fitting.models.any_model import Prior, Seen, figures_of, run_descent
from torchmat.fitting.objective import DISPLAY_POWER, LINEAR, Objective, Residual, mean_value, power, white_of
from torchmat.fitting.relief.refine import refine_height
from torchmat.fitting.relief.surface import Surface, bring_onto
from torchmat.fitting.training import Fitted, Training
from torchmat.geometry import slopes_from_normals
from torchmat.models import Material
from torchmat.models.indirect import BETWEEN, BETWEEN_MAPS, between
from torchmat.models.unbounded import Unbounded
from torchmat.solvers import Stepping
from torchmat.solvers.stop_reasons import DIVERGED, NOT_FINITE, STEP_LIMIT

_HEIGHT = "height"


class _SeenOnSurface(Seen):
    """Samples on the surface of a height, where a texel's light may be shaded and other texels add to it."""

    def __init__(self, surface: Surface, bare: Material, whole: Material) -> None:
        super().__init__(surface.training, bare)
        self.surface, self.whole = surface, whole

    def predicted(self, maps: dict[str, Tensor], rows: Tensor) -> Tensor:
        own = {name: value for name, value in maps.items() if name not in BETWEEN}
        btf = self.surface.training.btf
        lit = self.surface.lit[btf.light_index[rows]]
        direct = super().predicted(own, rows) * lit
        light = btf.directions(rows, lit.dtype)[0]
        sent = between(self.whole, light, {**self.whole.maps, **maps})
        return direct if sent is None else direct + sent.whole()


class Descending:
    """A material whose maps, but those in `kept`, descend from what they are; and its height, if it is not kept.

    On a relief the samples are brought onto the surface, and the unknowns are the maps of that (`Material.surface`): a
    normal is the whole one, that of the height included, until the material is made. `surface` are the samples on that
    of the material where they are known already, `prior` what maps cost by themselves (`run_descent`).
    """

    def __init__(
        self, training: Training, material: Material, kept: Sequence[str], objective: str | Residual,
        surface: Surface | None = None, prior: Prior | None = None,
    ) -> None:
        self.training = training = replace(training, relief=material.relief)
        self.material, self.kept, self.objective, self.prior = material, kept, objective, prior
        self.surface = surface
        if surface is None and material.has_relief:
            self.surface = bring_onto(training, self._height)
        bare = material.surface()
        specs, values = list(bare.own_specs()), dict(bare.maps.items())
        for spec in BETWEEN_MAPS:
            if spec.name in material.maps:
                specs, values = [*specs, spec], {**values, spec.name: material.maps[spec.name]}
        free = [name for name in material.maps if name not in (*kept, _HEIGHT)]
        self.unknowns = Unbounded(specs, values, set(values) - set(free), training.btf.mask)
        self._see()

    @property
    def _height(self) -> Tensor:
        return self.material.maps[_HEIGHT].detach()

    @property
    def moves_height(self) -> bool:
        """Whether the height is an unknown too."""
        return self.material.has_relief and _HEIGHT not in self.kept

    def _see(self) -> None:
        bare = self.material.surface()
        own = bare.sharing({name: value.detach() for name, value in bare.maps.items()})
        if self.surface is None:
            self.seen = Seen(self.training, own)
        else:
            self.seen = _SeenOnSurface(self.surface, own, self.material)

    def made(self) -> Material:
        """Return the material as it stands; maps that are kept are the very ones that it had."""
        found = self.unknowns.made()
        return self.material.with_maps(**self.material.from_surface(found))

    def run(self, solver: Stepping, rounds: Sequence[float]) -> Fitted:
        """Descend in rounds that take their share of the solver's steps, moving a height that is free between them."""
        history: list[tuple[float, float]] = []
        figures: dict[str, Any] = {}
        reason, filled = STEP_LIMIT, solver.filled()
        assert filled.steps is not None
        for number, share in enumerate(rounds):
            if self.moves_height and (number > 0 or not self.unknowns.names):
                self.move_height()
            if self.unknowns.names:
                part = replace(filled, steps=max(1, round(filled.steps * share)))
                found = run_descent(part, self.seen.training, self.unknowns, self.seen, self.objective, self.made, self.prior)
                history, reason = history + found.history, found.reason
                taken = figures.get("steps", 0) + found.steps
                figures = {**figures_of(filled, found), "steps": taken}
            if reason in (NOT_FINITE, DIVERGED) or self.training.watch.spent:
                break
        return Fitted(self.made(), reason, None, figures, history=history)

    def move_height(self) -> None:
        """Bring the height to where the present appearance wants it, and the samples onto it."""
        surface, maps = self.surface, self.unknowns.made()
        assert surface is not None
        level = mean_value(surface.training)
        # The size of a residual by which outlying samples are told is that of values as a display shows them.
        white, darkest = white_of(level), Objective(LINEAR, level).darkest

        def steepness(values: Tensor) -> Tensor:
            return power(values.clamp(min=0) + darkest, DISPLAY_POWER - 1) * (DISPLAY_POWER * white**-DISPLAY_POWER)

        def predict(run: slice) -> Tensor:
            return self.seen.predicted(maps, torch.arange(run.start, run.stop))

        normal = {**self.seen.material.maps, **maps}.get("normal")
        slopes = surface.slopes if normal is None else slopes_from_normals(normal)
        height = refine_height(surface, self._height, slopes, predict, steepness)
        self.material = self.material.with_maps(height=height)
        self.surface = bring_onto(surface.source, height, into=surface)
        self._see()
