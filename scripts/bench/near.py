"""Near lights against the same lights taken for far: normals and heights by photometric stereo, RTI models on unseen lights.

Simulated, so that the truth is known: `python scripts/bench/near.py` writes `results/near.json` and prints its tables.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

import torchmat as tm
from torchmat.btf.lambert import lambert_of, relief_of_one_view, stereo_of
from torchmat.geometry import soft_shadow

RESULTS = Path(__file__).parent / "results" / "near.json"
ROWS, COLUMNS = 96, 128
WIDTH_CM, DOME_CM, LIGHTS, LOWEST_DEG = 30.0, 80.0, 60, 70.0
NOISE, SEED = 0.005, 0
MODELS = ("texture", "lambert", "lptm", "ptm", "hsh", "phong_srf:residual=cosine")


class Scene(NamedTuple):
    """What is photographed: `height` [H, W] in widths, unit `normal` [3, H, W], and `mask` bool [H, W] of the object."""

    name: str
    height: np.ndarray
    normal: np.ndarray
    mask: np.ndarray
    gloss: float


def places() -> tuple[np.ndarray, np.ndarray]:
    """Return x and y [H, W] of the texels' centres, in widths from the centre."""
    x, y = (np.arange(COLUMNS) + 0.5) / COLUMNS - 0.5, (ROWS / 2 - np.arange(ROWS) - 0.5) / COLUMNS
    return np.meshgrid(x, y)


def dome() -> np.ndarray:
    """Return positions [n, 3] spread evenly over a dome, in widths of the sample."""
    z = 1 - (np.arange(LIGHTS) + 0.5) / LIGHTS * (1 - np.cos(np.deg2rad(LOWEST_DEG)))
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(LIGHTS)
    flat = np.sqrt(1 - z * z)
    return DOME_CM / 2 / WIDTH_CM * np.stack((flat * np.cos(turn), flat * np.sin(turn), z), axis=1)


def _of_height(name: str, height: np.ndarray, mask: np.ndarray, gloss: float) -> Scene:
    up, across = np.gradient(height, 1 / COLUMNS)
    normal = np.stack((-across, up, np.ones_like(height)))  # rows run downward
    return Scene(name, height, normal / np.linalg.norm(normal, axis=0), mask, gloss)


def scenes() -> list[Scene]:
    """Return a flat wall, a relief on one, and an object with bumps that stands out by a quarter of its picture's width."""
    x, y = places()
    everywhere = np.ones_like(x, dtype=bool)
    wavy = np.sin(19 * x + 1) * np.cos(17 * y) + 0.5 * np.sin(31 * y - 13 * x)
    wall = _of_height("flat wall", 0 * x, everywhere, 0.0)
    relief = _of_height("wall with a relief", 0.008 * wavy, everywhere, 0.15)
    radius = np.sqrt(x * x + y * y)
    ball = np.sqrt(np.clip(0.4**2 - radius**2, 0, None)) - 0.25
    mask = ball > 0
    return [wall, relief, _of_height("bumpy ball", np.where(mask, ball, 0) + 0.004 * wavy * mask, mask, 0.15)]


def photographs(scene: Scene) -> tuple[tm.Btf, tm.Btf]:
    """Return images under near lights that cast shadows, with noise; and the same images with far lights."""
    x, y = places()
    position, random = dome(), np.random.default_rng(SEED)
    point = np.stack((x, y, scene.height))
    gap = position[:, :, None, None] - point
    square = (gap * gap).sum(axis=1, keepdims=True)
    light = gap / np.sqrt(square)
    half = light + np.array([0.0, 0.0, 1.0])[:, None, None]
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cosine, shine = (np.maximum((one * scene.normal).sum(axis=1, keepdims=True), 0) for one in (light, half))
    albedo = 0.45 + 0.2 * np.sin(np.array([[[40.0]], [[33.0]], [[27.0]]]) * x) * np.cos(29 * y)
    value = albedo * cosine + scene.gloss * shine**30 * (cosine > 0)
    lit = soft_shadow(torch.from_numpy(scene.height)[None], torch.from_numpy(light), 0.02, tiles=False).numpy()
    images = value * lit * (position * position).sum(axis=1)[:, None, None, None] / square
    images = np.maximum(images + NOISE * random.standard_normal(images.shape), 0).astype(np.float32)
    view = np.tile([0.0, 0.0, 1.0], (LIGHTS, 1))
    near = tm.Btf.from_tensors(images, None, view, light_position=position)
    pair = (near, tm.Btf.from_tensors(images, near.light, view))
    return pair if scene.mask.all() else tuple(one.masked(torch.from_numpy(scene.mask)) for one in pair)


def _degrees(found: torch.Tensor, scene: Scene) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((found.double().numpy() * scene.normal).sum(axis=0), -1, 1)))[scene.mask]


def stereo(scene: Scene, near: tm.Btf, far: tm.Btf) -> list[dict[str, Any]]:
    """Return rows of errors of normals and heights: far lights, near ones in the plane, near ones at the height found."""
    rows, every = [], torch.arange(LIGHTS)
    truth = scene.height[scene.mask] - scene.height[scene.mask].mean()
    for name, btf in (("far", far), ("near, in the plane", near), ("near, at the height found", near)):
        once = stereo_of(btf, every, torch.float32).normal
        relief = relief_of_one_view(btf, every, torch.float32)
        error = _degrees(relief.normal if name.endswith("found") else once, scene)
        height = relief.height[0].double().numpy()[scene.mask]
        lambert = lambert_of(btf)
        rows.append({
            "scene": scene.name, "lights": name, "mean": float(error.mean()), "median": float(np.median(error)), "worst": float(error.max()),
            "height_error": None if name.endswith("plane") else float(np.sqrt(((height - height.mean() - truth) ** 2).mean())),
            "lambert_residual": None if lambert is None else lambert.residual,
        })
    return rows


def models(scene: Scene, near: tm.Btf, far: tm.Btf) -> list[dict[str, Any]]:
    """Return rows of errors of models on a flat surface, on lights that were held out."""
    rows = []
    for text in MODELS:
        name, _, options = text.partition(":")
        given = dict(one.split("=") for one in options.split(",")) if options else {}
        for lights, btf in (("far", far), ("near", near)):
            report = tm.fit(btf, name, geometry="flat", progress=False, **given).report["held_out"]
            rows.append({"scene": scene.name, "model": text, "lights": lights, "relative_error": report["relative_error"], "psnr_db": report["psnr_db"]})
    return rows


def main() -> None:
    """Measure, store and print."""
    found: dict[str, list[dict[str, Any]]] = {"stereo": [], "models": []}
    for scene in scenes():
        near, far = photographs(scene)
        found["stereo"] += stereo(scene, near, far)
        found["models"] += models(scene, near, far) if scene.gloss else []
    RESULTS.write_text(json.dumps(found, indent=1) + "\n")
    print("| scene | lights taken for | mean | median | worst | RMS of the height | Lambert residual |\n|---|---|---|---|---|---|---|")
    for row in found["stereo"]:
        height, lambert = ("-" if row[key] is None else f"{row[key]:.4f}" for key in ("height_error", "lambert_residual"))
        print(f"| {row['scene']} | {row['lights']} | {row['mean']:.2f} | {row['median']:.2f} | {row['worst']:.1f} | {height} | {lambert} |")
    print("\n| scene | model | error, far | near | dB, far | near |\n|---|---|---|---|---|---|")
    for far, near in zip(found["models"][::2], found["models"][1::2], strict=True):
        errors = " | ".join(f"{one['relative_error']:.4f}" for one in (far, near))
        print(f"| {far['scene']} | {far['model']} | {errors} | {far['psnr_db']:.1f} | {near['psnr_db']:.1f} |")


if __name__ == "__main__":
    main()
