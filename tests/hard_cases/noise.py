"""Recovery under noise: what maps and held-out errors lose as the photographs get worse, step by step.

A bumpy Lambert surface under a lobe is photographed by plain NumPy and then spoilt: shot noise, 8-bit codes, clipping,
wrong directions, images out of register, missing samples. Errors are those against the unspoilt images and maps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from tests.support import all_pairs, hemisphere

import torchmat as tm
from torchmat import Btf
from torchmat.fitting import evaluate

RINGS = ((0, 1), (22, 5), (42, 7), (62, 9))
MODELS = {
    "lambert": {}, "ptm": {}, "phong_srf": {"residual": "half_light"},
    "distribution": {"geometry": "flat", "lobes": 1, "fresnel": False, "rotation": False, "specular_size": 16, "effort": 0.15},
}


class Scene(NamedTuple):
    """Images [n, 3, H, W], directions [n, 3], and the maps that they were made of."""

    images: np.ndarray
    light: np.ndarray
    view: np.ndarray
    albedo: np.ndarray
    normal: np.ndarray


def smooth(random: np.random.Generator, channels: int, size: int) -> np.ndarray:
    """Return random planes in [-1, 1] whose values change slowly and tile."""
    v, u = np.meshgrid(np.arange(size) / size, np.arange(size) / size, indexing="ij")
    waves = [(a, b) for a in range(3) for b in range(-2, 3) if (a, b) != (0, 0)]
    total = np.zeros((channels, size, size))
    for a, b in waves:
        phase, gain = random.uniform(0, 2 * np.pi, (channels, 1, 1)), random.uniform(0, 1, (channels, 1, 1))
        total += gain * np.cos(2 * np.pi * (a * u + b * v) + phase) / np.hypot(a, b)
    return total / np.abs(total).max(axis=(1, 2), keepdims=True)


def make_scene(size: int = 20, seed: int = 0) -> Scene:
    """Photograph the surface from all directions."""
    random = np.random.default_rng(seed)
    light, view = all_pairs(hemisphere(RINGS), hemisphere(((0, 1), (30, 5), (55, 7))))
    albedo = 0.35 + 0.25 * smooth(random, 3, size)
    normal = np.stack((*(0.25 * smooth(random, 2, size)), np.ones((size, size))))
    normal /= np.linalg.norm(normal, axis=0)
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    n_dot_l = np.maximum(0, np.einsum("nk,khw->nhw", light, normal))
    n_dot_h = np.maximum(0, np.einsum("nk,khw->nhw", half, normal))
    images = albedo * n_dot_l[:, None] + 0.15 * (n_dot_l * n_dot_h**12)[:, None]
    return Scene(images, light, view, albedo, normal)


class Spoilt(NamedTuple):
    """What is fitted instead of the scene: images, directions, and which samples are there."""

    images: np.ndarray
    light: np.ndarray
    view: np.ndarray
    valid: np.ndarray | None = None


def shot_noise(scene: Scene, level: float, random: np.random.Generator) -> Spoilt:
    """Count photons: `level` is the noise of a value of 1."""
    if level == 0:
        return Spoilt(scene.images, scene.light, scene.view)
    photons = 1 / level**2
    return Spoilt(random.poisson(scene.images * photons) / photons, scene.light, scene.view)


def quantised(scene: Scene, level: float, random: np.random.Generator) -> Spoilt:
    """Round to codes: `level` is one step."""
    del random
    images = scene.images if level == 0 else np.round(scene.images / level) * level
    return Spoilt(images, scene.light, scene.view)


def clipped(scene: Scene, level: float, random: np.random.Generator) -> Spoilt:
    """Lose what is brighter than all but `level` of the values; a sample that clips carries no data."""
    del random
    bound = np.quantile(scene.images, 1 - level)
    return Spoilt(np.minimum(scene.images, bound), scene.light, scene.view, (scene.images <= bound).all(axis=1))


def turned(directions: np.ndarray, degrees: float, random: np.random.Generator) -> np.ndarray:
    """Return directions off by about `degrees`, above the horizon still."""
    moved = directions + np.deg2rad(degrees) / np.sqrt(2) * random.standard_normal(directions.shape)
    moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    return np.where(moved[:, 2:] > 0.02, moved, directions)


def misdirected(scene: Scene, level: float, random: np.random.Generator) -> Spoilt:
    """Note lights and views wrongly by `level` degrees."""
    return Spoilt(scene.images, turned(scene.light, level, random), turned(scene.view, level, random))


def misregistered(scene: Scene, level: float, random: np.random.Generator) -> Spoilt:
    """Shift each image by up to `level` texels, between texels too."""
    size = scene.images.shape[-1]
    frequency = np.fft.fftfreq(size)
    shift = random.uniform(-level, level, (2, len(scene.images), 1, 1, 1))
    turn = np.exp(-2j * np.pi * (shift[0] * frequency[:, None] + shift[1] * frequency))
    images = np.fft.ifft2(np.fft.fft2(scene.images) * turn).real
    return Spoilt(np.maximum(images, 0), scene.light, scene.view)


def missing(scene: Scene, level: float, random: np.random.Generator) -> Spoilt:
    """Lose a share `level` of all samples."""
    valid = random.random((len(scene.images), *scene.images.shape[-2:])) >= level
    return Spoilt(scene.images, scene.light, scene.view, valid)


HARMS: dict[str, tuple[Callable[[Scene, float, np.random.Generator], Spoilt], tuple[float, ...], str]] = {
    "shot noise": (shot_noise, (0.0, 0.01, 0.02, 0.05, 0.1), "noise of a value of 1"),
    "codes": (quantised, (0.0, 1 / 1023, 1 / 255, 1 / 63, 1 / 15), "one step"),
    "clipping": (clipped, (0.0, 0.02, 0.05, 0.1, 0.2), "share of the values"),
    "directions": (misdirected, (0.0, 0.25, 0.5, 1.0, 2.0), "degrees"),
    "register": (misregistered, (0.0, 0.25, 0.5, 1.0, 2.0), "texels"),
    "missing": (missing, (0.0, 0.1, 0.2, 0.4, 0.6), "share of the samples"),
}


def measured(scene: Scene, spoilt: Spoilt, model: str, options: dict) -> dict[str, float | None]:
    """Fit what is spoilt; return its errors against what is not."""
    truth = Btf.from_tensors(scene.images.astype(np.float32), scene.light, scene.view)
    images, valid = spoilt.images.astype(np.float32), spoilt.valid
    btf = Btf.from_tensors(images, spoilt.light, spoilt.view, valid)
    result = tm.fit(btf, model, measure=False, progress=False, **options)
    found = evaluate(result.material, truth, result.split.held_out, perceptual=False).report
    row: dict[str, float | None] = {"relative_error": found["relative_error"], "psnr_db": found["psnr_db"], "normal_deg": None}
    if "normal" in result.material.maps:
        normal = result.material.maps["normal"].detach().double()
        normal = torch.nn.functional.normalize(normal, dim=0).numpy()
        cosine = (normal * scene.normal).sum(axis=0).clip(-1, 1)
        row["normal_deg"] = float(np.degrees(np.median(np.arccos(cosine))))
    return row


def run(count: int = 5, seed: int = 0, models: dict[str, dict] | None = None, size: int = 20) -> list[dict]:
    """Return a row for each harm, level (the first `count` of each) and model, on a scene of `size` x `size` texels."""
    scene, rows = make_scene(size, seed), []
    for harm, (spoil, levels, unit) in HARMS.items():
        for level in levels[:count]:
            spoilt = spoil(scene, level, np.random.default_rng(seed))
            for model, options in (MODELS if models is None else models).items():
                found = measured(scene, spoilt, model, options)
                rows.append({"harm": harm, "level": level, "unit": unit, "model": model, **found})
    return rows


SLACK = 0.02  # of an error that may fall as data get worse: what is lost may have been misleading
FIRST_STEP, POWER = 1.5, 3.0  # the least harm, and growth no faster than the cube of the level: measured 1.3 and 2.7
MOST = 0.1


def jumps(rows: list[dict]) -> list[str]:
    """Return what is wrong with each curve of error against level: it falls, it jumps, or it ends beyond use."""
    said = []
    for harm, model in dict.fromkeys((row["harm"], row["model"]) for row in rows):
        line = [row for row in rows if (row["harm"], row["model"]) == (harm, model)]
        for one, other in zip(line, line[1:], strict=False):
            grown = other["relative_error"] / one["relative_error"]
            most = FIRST_STEP if one["level"] == 0 else (other["level"] / one["level"]) ** POWER
            if not 1 - SLACK <= grown <= most:
                step = f"from {one['level']:g} to {other['level']:g}"
                said.append(f"{harm}, {model}: the error grows {grown:.3g} times {step}, allowed {1 - SLACK:g} to {most:.3g}")
        if not line[-1]["relative_error"] < MOST:
            said.append(f"{harm}, {model}: the error ends at {line[-1]['relative_error']:.3g}")
    return said


def plot(rows: list[dict], path) -> None:
    """Draw error against level, a panel for each harm and a line for each model."""
    from torchmat.report.pictures import plotting, save_figure

    figure, axes = plotting().subplots(2, 3, figsize=(11, 6), sharey=True)
    for axis, (harm, (_, _, unit)) in zip(axes.flat, HARMS.items(), strict=True):
        for model in dict.fromkeys(row["model"] for row in rows):
            line = [row for row in rows if row["harm"] == harm and row["model"] == model]
            axis.plot([row["level"] for row in line], [row["relative_error"] for row in line], "o-", label=model, markersize=3)
        axis.set_yscale("log")
        axis.set_title(harm, fontsize=9)
        axis.set_xlabel(unit, fontsize=8)
        axis.grid(alpha=0.3, which="both")
    axes[0, 0].set_ylabel("relative error against clean images, held out", fontsize=8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=len(labels), fontsize=8, frameon=False)
    figure.subplots_adjust(hspace=0.5, top=0.89)
    save_figure(figure, path)
