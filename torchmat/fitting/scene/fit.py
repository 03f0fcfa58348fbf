"""Fit of what a scene uses: its texels, at its resolution, under its lights and views, as much as they are used."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import RangeError, message
from torchmat.fitting.config import FitConfig
from torchmat.fitting.fewer_texels import averaged
from torchmat.fitting.geometry import Flat, Geometry, Given, Recover
from torchmat.fitting.on_relief import fit_with_geometry
from torchmat.fitting.recipes import AUTO
from torchmat.fitting.scene.share import SceneShare
from torchmat.fitting.training import Fitted, Training
from torchmat.models.cutout import Cutout
from torchmat.models.masked import cut_out
from torchmat.scene_use import SceneUse

# Of the use: from 99.9 to 90 % the error inside of a scene is the same to a hundredth, and the time falls by half.
KEPT = 0.95
_ONE_IN = 32  # of the other samples: what the scene does not ask for stays bounded
_BASE = 0.2  # of the whole count, spread over all that are kept: with less, highlights that the scene lacks run away
_FRONTAL = 0.02  # the same, over the most frontal view
_LEAST_EFFORT = 0.2  # below, the steps do not suffice to leave the start
_RECOVERY = 160  # samples that a relief is recovered from: it correlates at 0.999 with that from all of them


@dataclass(frozen=True)
class Choice:
    """What is fitted: samples `rows` [k], what each counts [k], mean 1; texels as top, left, height, width (None: all).

    The images are halved `level` times; `outside` is the share of the use beyond the measured directions.
    """

    rows: Tensor
    importance: Tensor
    window: tuple[int, int, int, int] | None
    level: int
    outside: float


def fit_for_scene(
    training: Training, config: FitConfig, options: dict[str, Any], geometry: Geometry, use: SceneUse,
    work: str | Path | None = None,
) -> Fitted:
    """Fit a model to what a scene uses of the training samples.

    Of the samples those that carry 95 % of the use are fitted, each as much as it is used; beside them, for little, one
    in 32 of the others, so that the material stays one outside of the scene, and the most frontal view, from which
    normals come. Least squares, lobes, factorisations and the images that the distribution draws are weighed so;
    "neural" and the BRDF of "shading_map" take the chosen samples all alike. An iterative fit takes as many steps as
    show it each sample as often as before.

    Texels that no point touches are left out where the others form a window and the surface is flat: on a relief
    parallax and shadow reach across. Where the scene sees the texture from afar the images are averaged first, and the
    material has the smaller size, unless a height map is given. To recover a relief 160 of all samples are looked at.
    """
    _check_together(config, work)
    choice = choose(training, use, geometry)
    part = _training_of(training, choice)
    share = len(choice.rows) / max(1, int(training.used.sum()))
    recovered_from = _for_recovery(training, choice) if isinstance(geometry, Recover) else None
    fitted = fit_with_geometry(part, config.model, _lighter(options, share), geometry, recovered_from)
    fitted = replace(fitted, material=cut_out(fitted.material, part.btf.mask))
    btf, size = training.btf, (part.btf.height, part.btf.width)
    cutout = Cutout(*(choice.window or (0, 0, btf.height, btf.width)), btf.height, btf.width, training.tiles)
    if choice.window is not None or choice.level:
        fitted = replace(fitted, material=fitted.material.cut_from(cutout))
    texels_share = cutout.height * cutout.width / (btf.height * btf.width)
    found = SceneShare(
        len(choice.rows), share, math.prod(size), texels_share, choice.level, choice.window, choice.outside,
    )
    return replace(fitted, scene=found)


def _check_together(config: FitConfig, work: str | Path | None) -> None:
    if config.model == AUTO or config.tile_size or config.memory_mb or work is not None:
        fact = f"the model is {AUTO}" if config.model == AUTO else "tiles are wanted"
        step = "Name a model, and leave tile_size, memory_mb and work out: a scene makes the work small itself."
        raise RangeError(message("fit", "scene", "name its model and come without tiles", fact, step))


def choose(training: Training, use: SceneUse, geometry: Geometry) -> Choice:
    """Return which samples and texels a fit for a scene needs, and what they count."""
    btf = training.btf
    rows = training.used.nonzero()[:, 0]
    weight, outside = use.sample_weights(btf.light[rows], btf.view[rows])
    ordered, order = weight.sort(descending=True, stable=True)
    most = int((ordered.cumsum(0) < KEPT * ordered.sum()).sum()) + 1
    kept = torch.zeros(len(rows), dtype=torch.bool)
    kept[order[:most]] = True
    kept[order[most::_ONE_IN]] = True
    frontal = btf.view_index[rows] == int(btf.view_index[rows].min())
    count = weight + _BASE * kept / kept.sum() + _FRONTAL * frontal / frontal.sum()
    kept |= frontal
    given = isinstance(geometry, Given)
    level = 0 if given else use.level(btf.height, btf.width)
    window = use.window(btf.height, btf.width, training.tiles) if isinstance(geometry, Flat) else None
    return Choice(rows[kept], count[kept] / count[kept].mean(), window, level, outside)


def _for_recovery(training: Training, choice: Choice) -> Training:
    """Return the training that a relief is recovered from: a scene's own samples lack the views that tell its scale."""
    view_index = training.btf.view_index
    rows = training.used.nonzero()[:, 0]
    generator = torch.Generator().manual_seed(training.seed)
    few = rows[torch.randperm(len(rows), generator=generator)[:_RECOVERY]]
    frontal = rows[view_index[rows] == int(view_index[rows].min())]
    rows = torch.cat((few, frontal)).unique()
    return replace(_training_of(training, replace(choice, rows=rows)), importance=None)


def _training_of(training: Training, choice: Choice) -> Training:
    """Return the training over the chosen samples and texels alone."""
    btf = training.btf if choice.window is None else training.btf.window(*choice.window)
    size = tuple(math.ceil(side / 2**choice.level) for side in (btf.height, btf.width))
    btf = averaged(btf, choice.rows, size, training.dtype) if choice.level else btf.picked(choice.rows)
    used = torch.ones(len(btf), dtype=torch.bool)
    tiles = training.tiles and choice.window is None
    return replace(training, btf=btf, used=used, tiles=tiles, importance=choice.importance)


def _lighter(options: dict[str, Any], share: float) -> dict[str, Any]:
    """Return options of an iterative fit that takes the fewer steps the fewer samples there are to agree with."""
    if "effort" not in options:
        return options
    return {**options, "effort": options["effort"] * max(_LEAST_EFFORT, share)}
