"""The plan of a fit by tiles: what all texels share, found once on few of them, and the windows fitted after that."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.btf import Btf
from torchmat.errors import FitError, RangeError, message
from torchmat.fitting.fewer_texels import averaged
from torchmat.fitting.geometry import Flat, Geometry, Given, check_height
from torchmat.fitting.on_relief import compare_with_flat, fit_flat, fit_on_relief, not_recovered
from torchmat.fitting.recipe import recipe_of
from torchmat.fitting.relief.recover import recover_relief
from torchmat.fitting.relief.surface import Sight, look_along
from torchmat.fitting.relief.window import Window
from torchmat.fitting.tiles.memory import choose_side, most_texels, require_recovery
from torchmat.fitting.shared import Shared
from torchmat.fitting.training import Fitted, Training
from torchmat.geometry import Relief
from torchmat.models import Material
from torchmat.solvers import Stepping
from torchmat.solvers.clock import Watch

# What all texels share is found on every so-manieth row and column. Odd steps meet every part of a
# pattern that repeats after a power of two.
_STEPS = (1, 3, 5, 7, 11, 13, 17, 23, 31, 41, 61, 83, 127, 255, 511, 1023, 2047, 4095)
_COMPARED, _COMPARED_SAMPLES = 96, 600  # texels along the longer side, and images, that flat and relief are compared on
_PLANNING = 0.25  # of the seconds that a fit may take


@dataclass(frozen=True)
class TilePlan:
    """What a tile's fit needs besides its texels, the same for all tiles.

    `shared` is what all texels have in common, found on `shared_from` of them, and `template` a material of those; `height`
    [1, H, W] the relief of all (None: flat), `relief` how it was recovered. `side` is a tile's, `size` the whole's.
    """

    model: str
    options: dict[str, Any]
    template: Material
    shared: Shared
    side: int
    size: tuple[int, int]
    reason: str
    figures: dict[str, Any]
    height: Tensor | None = None
    relief: Relief | None = None
    shared_from: int = 0
    kept: dict[str, Sight] = field(default_factory=dict, repr=False, compare=False)

    @property
    def windows(self) -> list[Window]:
        """The tiles, row by row."""
        height, width = self.size
        return [
            Window(top, left, min(self.side, height - top), min(self.side, width - left))
            for top in range(0, height, self.side) for left in range(0, width, self.side)
        ]

    def sight(self, training: Training) -> Sight | None:
        """Return what lights and views see of the height, found when first asked for."""
        if self.height is not None and "sight" not in self.kept:
            self.kept["sight"] = look_along(training, self.height)
        return self.kept.get("sight")

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "kept": {}}  # what is seen is found anew more cheaply than sent


class TilePart(NamedTuple):
    """What a tile's fit found: `maps` of its texels, `coverage` [1, h, w] or None, and why it stopped."""

    window: Window
    maps: dict[str, Tensor]
    coverage: Tensor | None
    reason: str


def fit_part(
    training: Training, model: str, options: dict[str, Any], height: Tensor | None, window: Window, sight: Sight | None
) -> Fitted:
    """Fit a model to the texels of a window, flat or on the relief of the whole."""
    if height is None:
        return fit_flat(replace(training, btf=window.of(training.btf)), model, options)
    return fit_on_relief(training, model, options, height, window, sight)


def plan_tiles(
    training: Training, model: str, options: dict[str, Any], geometry: Geometry, tile_size: int, memory_mb: float
) -> TilePlan:
    """Find what all texels share on an even choice of them, and how large tiles may be.

    `tile_size` is their side, 0 as large as `memory_mb` allows; with `memory_mb` 0 memory is no concern. Raises RangeError
    when that memory is too little, and for models that are not fitted by tiles.
    """
    recipe = recipe_of(model)
    if recipe.tiling.refused is not None:
        fact, step = recipe.tiling.refused
        raise RangeError(message("fit", "tiles", "suit the model", f"{model} {fact}", step))
    usual = recipe.all_solvers[0]
    solver = recipe.solver_of(options)
    if isinstance(solver, Stepping) and solver.name != usual:
        step = f"Leave it out: tiles take {usual}."
        fact = f"it is {solver.name!r}, which fits what all texels share along with them"
        raise RangeError(message("fit", "solver", "suit tiles", fact, step))
    btf = training.btf
    own = replace(training, watch=Watch(training.watch.limit * _PLANNING))
    height, relief, found = _height(own, model, options, geometry, memory_mb)
    most = most_texels(training, model, height is not None, memory_mb)
    spacing = _step(btf, min(most, recipe.tiling.sharing_texels))
    some = Window(0, 0, btf.height, btf.width, spacing)
    sight = None if height is None else look_along(own, height)
    fitted = fit_part(own, model, options, height, some, sight)
    if recipe.tiling.settle is not None:
        options, fitted = recipe.tiling.settle(options, fitted)
    side = choose_side(training, model, fitted.material, height is not None, tile_size, memory_mb)
    texels = -(-btf.height // spacing) * -(-btf.width // spacing)
    figures = {**fitted.figures, **found}
    size, reason = (btf.height, btf.width), fitted.stop_reason
    plan = TilePlan(model, options, fitted.material, fitted.shared, side, size, reason, figures, height, relief, texels)
    if sight is not None:
        plan.kept["sight"] = sight
    return plan


def _step(btf: Btf, most: int) -> int:
    for step in _STEPS:
        if -(-btf.height // step) * -(-btf.width // step) <= most:
            return step
    return _STEPS[-1]


def _height(
    training: Training, model: str, options: dict[str, Any], geometry: Geometry, memory_mb: float
) -> tuple[Tensor | None, Relief | None, dict[str, Any]]:
    """Return height and relief as the geometry asks for, None for a flat surface, and figures."""
    if isinstance(geometry, Given):
        return check_height(geometry.height, training.btf).to(training.dtype), None, {}
    if isinstance(geometry, Flat):
        return None, None, {}
    try:
        require_recovery(memory_mb)
        recovery = recover_relief(training)
    except (FitError, RangeError) as error:
        if not geometry.or_flat:
            raise
        return None, None, {"geometry": not_recovered(error)}
    relief, figures = recovery.relief, recovery.figures()
    chosen = "flat"
    if float(relief.height.abs().max()) > 0 and not training.watch.spent:
        small, height = _reduced(training, relief.height)
        chosen, compared = compare_with_flat(small, model, options, height)
        figures = {**figures, "validation_psnr_db": {way: errors["psnr_db"] for way, errors in compared.items()}}
    figures = {"geometry": {**figures, "chosen": chosen}}
    return (None, None, figures) if chosen == "flat" else (relief.height.to(training.dtype), relief, figures)


def _reduced(training: Training, height: Tensor) -> tuple[Training, Tensor]:
    """Return some training samples and the height in few texels: enough to tell what a relief is worth."""
    btf = training.btf
    factor = max(btf.height, btf.width) / _COMPARED
    rows = training.used.nonzero()[:, 0]
    if factor <= 1:
        return training, height
    size = (max(1, round(btf.height / factor)), max(1, round(btf.width / factor)))
    rows = rows[torch.linspace(0, len(rows) - 1, min(len(rows), _COMPARED_SAMPLES)).round().long()]
    small = averaged(btf, rows, size, training.dtype)
    used = torch.ones(len(rows), dtype=torch.bool)
    importance = None if training.importance is None else training.importance[rows]
    small_training = replace(training, btf=small, used=used, importance=importance)
    return small_training, functional.adaptive_avg_pool2d(height, size)
