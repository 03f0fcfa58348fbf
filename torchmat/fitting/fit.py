"""fit: a BTF and the name of a model in, a material and an honest report out."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat.btf import Btf, Split, split_samples
from torchmat.btf.lambert import lambert_of
from torchmat.btf.lit import paired_lights
from torchmat.btf.tiling import decided
from torchmat.errors import RangeError, check_option, message
from torchmat.fast import road_taken
from torchmat.fitting.between import AUTO as LIGHT_AUTO
from torchmat.fitting.between import MAP as LIGHT_MAP
from torchmat.fitting.certainty.estimate import uncertainty as uncertainty_of
from torchmat.fitting.choice.choose import fit_auto
from torchmat.fitting.config import FitConfig, load_config
from torchmat.fitting.evaluate import MEASURES, evaluate, shading_rate
from torchmat.fitting.from_material import check_free, fit_from, kept_names, onward_of
from torchmat.fitting.geometry import AUTO_RELIEF, RECOVER, Geometry, Recover, resolve_geometry
from torchmat.fitting.objective import described
from torchmat.fitting.on_relief import fit_with_geometry
from torchmat.fitting.recipe import recipe_of
from torchmat.fitting.recipes import AUTO, resolve_options
from torchmat.fitting.scene.fit import fit_for_scene
from torchmat.fitting.scene.report import scene_figures
from torchmat.fitting.tiles.fit import fit_tiled
from torchmat.fitting.tiles.work import clear_work
from torchmat.fitting.training import Fitted, Training, make_training
from torchmat.fitting.unseen import measured, unseen_of, unseen_source
from torchmat.fitting.wanted import beside_mask, make_target
from torchmat.geometry import Relief
from torchmat.machine import peak_memory_mb, versions
from torchmat.models import Material
from torchmat.models.masked import cut_out
from torchmat.models.relief_maps import FAST, FINE
from torchmat.models.uncertainty import Uncertainty, check_sure
from torchmat.progress import working
from torchmat.scene_use import SceneUse, Usable, as_use
from torchmat.solvers import Stepping
from torchmat.solvers.clock import Watch

NONE, _, FULL, AUTO_MEASURE = MEASURES
_CURVE_SAMPLES = 400  # held-out ones that a curve is measured on; of a few, chance decides whether they hold a highlight


@dataclass(frozen=True)
class FitResult:
    """What a fit gives back.

    Args:
        material: the material, ready to shade, save and render.
        stop_reason: why the solver stopped, such as "converged", "step limit" or "budget spent".
        report: what `report.json` holds: bytes, seconds, and the errors under "train", "held_out",
            "held_out_after_export", and of test images "test" and "test_after_export".
        split: the numbers of the samples that were fitted and held out.
        coverage: [1, H, W], the share of the unknowns that each texel's samples determine; None where it has no meaning.
        held_out_errors: [m], the display error of each held-out sample; None if not all were measured.
        relief: the geometry that was recovered and used; None on a flat surface or a given height.
        uncertainty: standard errors of the maps; None where they were not asked for, or the model that was chosen has none.
        history: (seconds, error) as the fit went on: of an iterative solver in its own terms, or with `curve` the relative
            error on held-out samples.
    """

    material: Material
    stop_reason: str
    report: dict[str, Any]
    split: Split
    coverage: Tensor | None = None
    held_out_errors: Tensor | None = None
    relief: Relief | None = None
    history: list[tuple[float, float]] = field(default_factory=list)
    uncertainty: Uncertainty | None = None


def fit(
    btf: Btf,
    model: str | Path | FitConfig | Material = "phong_srf",
    *,
    holdout: float | None = None,
    holdout_by: str | None = None,
    seed: int | None = None,
    test: Btf | str | Path | None = None,
    geometry: Geometry | str | Path | Tensor | np.ndarray | None = None,
    relief: str | None = None,
    finish: bool | None = None,
    indirect: str | None = None,
    tiles: bool | str | None = None,
    error: float | None = None,
    psnr: float | None = None,
    bytes: float | None = None,
    seconds: float | None = None,
    highlights: float | None = None,
    scene: SceneUse | Usable | Sequence[SceneUse | Usable] | None = None,
    tile_size: int | None = None,
    memory_mb: float | None = None,
    work: str | Path | None = None,
    curve: bool = False,
    uncertainty: bool | None = None,
    dtype: torch.dtype = torch.float32,
    measure: str | bool = "auto",
    progress: bool | None = None,
    **options: Any,
) -> FitResult:
    """Fit a material to a BTF and measure it on samples that it never saw.

    Deterministic for a seed, unless seconds stop it. What is None here is as the config says, or has its usual value.

    Args:
        btf: the images, from `load_btf` or `Btf.from_tensors`.
        model: name of a model (`describe_models` lists them), "auto", a FitConfig, a TOML config (`load_config`), or a
            material: an instance of any Material, registered or not, whose maps then descend from what they are; a height
            and its ambient light stay as they are.
        holdout: share of the samples held out, in [0, 1); usually 0.2.
        holdout_by: what is held out: "pair" (usual), "light", "view", "both" or "arc" (`split_samples`).
        seed: seed of the split and of the solver, from 0; usually 0.
        test: other images of the same texels, or the path of them, measured beside those held out and never fitted, such as
            directions that the grid of `btf` does not hold; "sample" is ``sample_path("random")``. A path is read with those of the
            config's [data] that say how pixels are read.
        geometry: "flat" takes texels for what they seem; "recover" finds height and normals from the training samples and
            puts the model on that relief, with parallax, shadow and ambient light, if that makes it better; a height map
            [1, H, W] in texture widths over the plane of the images, or the path of one, is taken as it is. None is the
            config's, or the model's own way (`Recipe.geometry`): "recover" for "distribution" and "neural", where there is
            anything to recover it from, and "flat" for most.
        relief: how a surface that has a height is followed, in the fit and whenever the material is shaded: "fast", texel by texel,
            or "fine", between texels, with shadow where each ray ends. None is fine for a whole fit of one model on a relief that
            is recovered, else fast.
        finish: whether a fit on a fine relief ends with steps whose loss is taken on the pictures themselves, in which a height
            that was recovered moves along; kept where it pays. Usually True.
        indirect: how light between the texels of a relief is told: "map" by an ambient map, "radiosity" by the relief and the
            diffuse colours, which takes no bytes, "none" not at all. Usually "auto": what a finish shows to be best, or a map.
        tiles: whether the surface repeats at its borders; usually "auto", which asks the images and says so in the report.
        error, psnr: of "auto", the relative error or the dB on held-out samples that the smallest material must reach.
        bytes: of "auto", the most bytes a texel, shared tables included.
        seconds: what the fit may take; an iterative solver then stops with the best so far.
        highlights: of "auto", the relative error on highlights that is kept beside `psnr`, and weighed with `bytes` or `seconds`
            alone (0.1); 1 lets them go, as dB alone would: they are few, and above white a display shows none.
        scene: a Scene or several: fit only the texels, lights and views that they use, weighted as they use them; the report
            then says what that saves and costs.
        tile_size: texels on a side that are fitted at a time; None is all, or as many as `memory_mb` allows.
        memory_mb: what the fit may take, in MB, beside the 250 of Python and torch.
        work: folder that keeps finished tiles, where a run that was stopped goes on.
        curve: whether to record the held-out error against seconds as `history`.
        uncertainty: whether the result has standard errors of its maps (`tm.uncertainty`), which a folder and its report then
            show; usually False.
        dtype: torch.float32, or torch.float64 for the same code in double precision.
        measure: "full" puts errors on all held-out samples into the report, "auto" (or True) too, with SSIM and CIEDE2000 on
            fewer texels, and of images above a million on every so-manieth row and column, "quick" on some samples, about 2 million
            texels, "none" (or False) none; measuring takes most of the time of a closed-form fit.
        progress: whether to show a bar; None shows it on a terminal.
        options: the model's options, such as ``terms=16`` (`describe_model`), its `solver`, a name or an object such as
            ``Adam(steps=100)``, and its `objective`; of a material `solver`, `steps`, `rate`, `objective`, and `keep`, the
            names of maps that stay to the bit.

    Raises RangeError for unknown models or options, FitError when the data cannot determine the model.
    """
    given = {
        "holdout": holdout, "holdout_by": holdout_by, "seed": seed, "relief": relief, "finish": finish,
        "indirect": indirect, "tiles": tiles, "tile_size": tile_size, "memory_mb": memory_mb,
        "uncertainty": uncertainty, "test": None if isinstance(test, Btf) or test is None else str(test),
    }
    wanted = {"error": error, "psnr": psnr, "bytes": bytes, "seconds": seconds, "highlights": highlights}
    how = AUTO_MEASURE if measure is True else NONE if measure is False else measure
    check_option("fit", "measure", how, MEASURES)
    if dtype not in (torch.float32, torch.float64):
        raise RangeError(message("fit", "dtype", "be torch.float32 or torch.float64", f"it is {dtype}"))
    if isinstance(model, Material):
        others = {"geometry": geometry, "scene": scene, "tile_size": tile_size, "memory_mb": memory_mb, "work": work, **wanted}
        _refuse_beside_a_material({**others, "seconds": None, "relief": relief, "finish": finish, "indirect": indirect, "tiles": tiles})
        task = _of_material(btf, model, options, given, seconds, dtype)
    else:
        task = _by_name(model, given, wanted, geometry, options, scene, work)
    config = task.config
    other = unseen_of(btf, test if isinstance(test, Btf) else config.test, config.data, progress)
    split = split_samples(btf, config.holdout, config.holdout_by, config.seed)
    with working("looking whether the surface repeats", progress):
        tiles, tiling = decided("fit", btf, config.tiles)
    watch = Watch(config.target.get("seconds", math.inf), _held_out_error(btf, split) if curve else None)
    training = make_training(btf, split.train, config.seed, tiles, dtype, progress, watch)
    with torch.no_grad(), working(f"fitting {config.model if not isinstance(model, Material) else model.name}", progress):
        fitted = task.run(training)
        if task.scene is None:  # else it has cut out what it fitted
            fitted = replace(fitted, material=cut_out(fitted.material, btf.mask))
        watch.note(lambda: fitted.material)
    seconds = watch.seconds
    errors, held_out = measured(btf, other, fitted.material, split, how, progress)
    used = task.options if fitted.options is None else fitted.options
    ways = {"options": described(used), "geometry": task.geometry}
    figures = None if how == NONE else lambert_of(btf)
    with working("measuring the speed", progress):
        described_fit = _described(btf, config, fitted)
    report = {**described_fit, **ways, "fit_seconds": seconds, **errors, "curve": watch.history}
    report["lambert_residual"] = figures and figures.report()
    report |= unseen_source(btf, other)
    report |= {"tiles": tiles, "tiling": tiling and tiling.report()}
    certain = _uncertainty(btf, config, fitted.material, used, split, progress)
    report["uncertainty"] = certain and certain.as_table()
    if task.scene is not None:
        report["scene"] = scene_figures(btf, fitted, split, task.scene, tiles, how != NONE, progress)
    if work is not None:
        clear_work(work)
    return FitResult(
        fitted.material, fitted.stop_reason, report, split, fitted.coverage,
        held_out.per_sample if held_out and len(held_out.per_sample) == len(split.held_out) else None,
        fitted.relief, watch.history or fitted.history, certain,
    )


def _uncertainty(
    btf: Btf, config: FitConfig, material: Material, options: dict[str, Any], split: Split, progress: bool | None
) -> Uncertainty | None:
    """Return the standard errors that the config asks for; of a model that the choice took and that has none, None."""
    if not config.uncertainty or material.unsure is not None:
        return None
    stepped = isinstance(options.get("solver"), Stepping)
    with working("finding how certain the maps are", progress), torch.no_grad():
        return uncertainty_of(material, btf, split.train, objective=options.get("objective") if stepped else None, progress=progress)


@dataclass(frozen=True)
class _Task:
    """What is to be fitted: `run` makes the fit; `config`, `options` and `geometry` (a word) are what the report says."""

    config: FitConfig
    options: dict[str, Any]
    geometry: str
    run: Callable[[Training], Fitted]
    scene: SceneUse | None = None


def _by_name(
    model: str | Path | FitConfig, given: dict[str, Any], wanted: dict[str, Any], geometry: Any, options: dict[str, Any],
    scene: Any, work: str | Path | None,
) -> _Task:
    """Return the task of a model that is named, or that a config names."""
    way = {"geometry": geometry} if isinstance(geometry, str) else {}
    config = _resolve(model, given | way, wanted, options)
    chosen = resolve_options(config.model, config.options)
    asked = config.geometry if geometry is None or isinstance(geometry, str) else geometry
    by_itself = config.model == AUTO
    default = RECOVER if by_itself else recipe_of(config.model).geometry
    surface = resolve_geometry(asked, default=default, by_itself=by_itself)
    use = None if scene is None else as_use(scene)  # found before the clock starts, as images are decoded before
    by_data = by_itself and (asked is None or (isinstance(asked, str) and asked == AUTO_RELIEF))
    word = AUTO_RELIEF if by_data else surface.word
    return _Task(config, chosen, word, lambda training: _fitted(training, config, chosen, surface, use, work), use)


def _of_material(
    btf: Btf, material: Material, options: dict[str, Any], given: dict[str, Any], seconds: float | None, dtype: torch.dtype
) -> _Task:
    """Return the task of a material that is fitted on from its own maps."""
    how = onward_of(btf, material, options)
    kept = kept_names(material, how.keep)
    check_free(material, kept)
    if material.dtype != dtype:
        step = f"Give dtype={material.dtype}, or convert the material with .to({dtype})."
        raise RangeError(message("fit a material", "dtype", f"be {material.dtype} as its maps are", f"it is {dtype}", step))
    kept_words = ("holdout", "holdout_by", "seed", "test", "uncertainty")
    known = {name: value for name, value in given.items() if value is not None and name in kept_words}
    if known.get("uncertainty"):
        check_sure("fit", material)
    config = FitConfig(tiles=material.tiles, target={} if seconds is None else {"seconds": seconds}, **known)
    used = {"solver": how.solver.filled(), "objective": how.objective, "keep": kept}
    word = "given" if material.has_relief else "flat"
    return _Task(config, used, word, lambda training: fit_from(training, material, how))


def _refuse_beside_a_material(others: dict[str, Any]) -> None:
    for name, value in others.items():
        if value is not None:
            fact, step = "a material is given, which has its own", "Leave it out, or name a model instead."
            raise RangeError(message("fit", name, "be left out beside a material", fact, step))


def _described(btf: Btf, config: FitConfig, fitted: Fitted) -> dict[str, Any]:
    """Return what a report says of the data, the config and the material."""
    material = fitted.material
    return {
        "model": material.name, "samples": len(btf), "texels": btf.height * btf.width, "seed": config.seed,
        "holdout": config.holdout, "holdout_by": config.holdout_by, "target": config.target,
        "data": config.data,
        "bytes_per_texel": material.bytes_per_texel, "shared_bytes": material.shared_bytes,
        "load_seconds": btf.source.load_seconds, "shade_mtexels_per_s": shading_rate(material),
        "peak_rss_mb": peak_memory_mb(), "fast": road_taken(), "stop_reason": fitted.stop_reason, "coverage": _coverage(fitted.coverage, btf.mask),
        **_source(btf), "figures": fitted.figures, "versions": versions(),
    }


def _fitted(
    training: Training, config: FitConfig, options: dict[str, Any], geometry: Geometry, scene: SceneUse | None,
    work: str | Path | None,
) -> Fitted:
    """Return what the config asks for: a model, whole or tile by tile, or the choice among models; for a scene or all."""
    by_tiles = config.tile_size or config.memory_mb or work is not None
    usual = FINE if isinstance(geometry, Recover) and config.model != AUTO and not by_tiles else FAST
    training = replace(training, relief=config.relief or usual, finish=config.finish, indirect=config.indirect)
    if config.indirect not in (LIGHT_AUTO, LIGHT_MAP) and (by_tiles or config.model == AUTO or scene is not None):
        fact = f"it is {config.indirect!r}, and the fit is by tiles, for a scene, or a choice among models"
        raise RangeError(message("fit", "indirect", "be left to a fit of one model as a whole", fact, 'Leave it out, or say "map".'))
    if scene is not None:
        return fit_for_scene(training, config, options, geometry, scene, work)
    if config.model == AUTO:
        if by_tiles:
            step = "Let it choose on a crop of the images, then fit the model that it picked by tiles."
            fact = "tile_size, memory_mb or work is given"
            raise RangeError(message("fit auto", "the choice", "be made on all texels at once", fact, step))
        training = replace(training, finish=config.finish and config.relief != FAST)
        return fit_auto(training, beside_mask(make_target("fit", config.target), training.btf.mask), geometry)
    if by_tiles:
        return fit_tiled(training, config.model, options, geometry, config.tile_size, config.memory_mb, work)
    return fit_with_geometry(training, config.model, options, geometry)


def _held_out_error(btf: Btf, split: Split) -> Callable[[Material], float]:
    """Return the function that measures a material on some of the held-out samples."""
    rows = split.held_out if len(split.held_out) else split.train
    return lambda material: evaluate(material, btf, rows, _CURVE_SAMPLES, perceptual=False).report["relative_error"]


def _resolve(
    model: str | Path | FitConfig, given: dict[str, Any], wanted: dict[str, Any], options: dict[str, Any]
) -> FitConfig:
    base = model if isinstance(model, FitConfig) else load_config(model)
    given, wanted = ({name: value for name, value in table.items() if value is not None} for table in (given, wanted))
    return dataclasses.replace(base, **given, target={**base.target, **wanted}, options={**base.options, **options})


def _coverage(coverage: Tensor | None, mask: Tensor | None) -> dict[str, float] | None:
    if coverage is None:
        return None
    coverage = coverage if mask is None or coverage.shape[-2:] != mask.shape else coverage[:, mask]
    return {
        "least": float(coverage.min()), "mean": float(coverage.mean()),
        "texels_not_fully_determined": int((coverage < 1).sum()),
    }


def _source(btf: Btf) -> dict[str, Any]:
    return {
        "source": {
            "kind": btf.source.kind, "path": btf.source.path, "height": btf.height, "width": btf.width,
            "lights": len(btf.lights), "views": len(btf.views), "encoding": btf.encoding, "exposure": btf.exposure,
            "clipped_share": btf.clipped_share, "invalid_share": btf.invalid_share, "notes": list(btf.source.notes),
            "lights_of": paired_lights(btf), **btf.object_figures(), **({} if btf.near is None else btf.near.figures()),
        }
    }
