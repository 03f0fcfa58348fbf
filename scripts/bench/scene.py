"""The benchmark suite of scenes: fits of the whole BTF against fits of what one picture uses."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from typing import Any

import torch
from measure import RESULTS, SHARED
from torch import Tensor

import torchmat as tm
from torchmat import colour
from torchmat.btf.interpolated import RawBtf
from torchmat.metrics import relative
from torchmat.rendering import Camera, Directional
from torchmat.report.pictures import plotting, save_figure

_MODELS = {
    "lambert": {}, "ptm": {}, "phong_srf": {"residual": "half_light"}, "pca": {},
    "distribution": {"geometry": "flat", "lobes": 1},
}
_REPEATS, _SLOW = 5, ("distribution",)
_LIGHT = Directional((-0.4, 0.5, 0.77))
_SHOWN = ("leather", "teapot", "phong_srf")


def _data() -> Iterator[tuple[str, tm.Btf]]:
    yield "sample", tm.load_btf(tm.sample_path())
    for name in ("leather", "weave_ubo2003"):
        path = SHARED / "reference" / f"{name}.zip"
        if path.exists():
            yield name, tm.load_btf(path)
        else:
            print(f"skipped: {name} is absent")


def _scenes() -> Iterator[tuple[str, tm.Scene]]:
    view = (0.3, 0.25, 1.0)
    yield "teapot", tm.Scene("teapot", [_LIGHT], view=view, repeat=3.0)
    bunny = SHARED / "meshes" / "bunny" / "stanford-bunny.obj"
    if bunny.exists():
        yield "bunny", tm.Scene(bunny, [_LIGHT], view=view, repeat=3.0)
    yield "quad", tm.Scene("quad", [_LIGHT], view=view)
    near = Camera((0.35, 0.4, 1.2), target=(0.05, 0.0, 0.0), width=0.4)
    yield "quad, near", tm.Scene("quad", [_LIGHT], camera=near)


def _timed(btf: tm.Btf, model: str, scene: Any) -> tuple[tm.FitResult, float]:
    repeats = 1 if model in _SLOW else _REPEATS
    results = [tm.fit(btf, model, scene=scene, measure=False, **_MODELS[model]) for _ in range(repeats)]
    return results[-1], statistics.median(result.report["fit_seconds"] for result in results)


def _size(material: tm.Material) -> int:
    return round(material.bytes_per_texel * material.texels) + material.shared_bytes


def _error(picture: Tensor, truth: Tensor) -> float | None:
    return relative(float((picture - truth).square().sum()), float(truth.square().sum()))


def _outside(btf: tm.Btf, result: tm.FitResult, scene: tm.Scene) -> float | None:
    """Return the error on held-out samples that the scene does not use."""
    rows = result.split.held_out
    unused = rows[scene.use().sample_weights(btf.light, btf.view).weight[rows] == 0]
    return tm.evaluate(result.material, btf, unused, perceptual=False).report["relative_error"] if len(unused) else None


def scene() -> list[dict[str, Any]]:
    """Seconds, bytes and the error of one picture, of a fit of everything and of one for the picture."""
    rows: list[dict[str, Any]] = []
    scenes = dict(_scenes())
    for data, btf in _data():
        raw = RawBtf(btf)
        truths = {name: one.picture(raw) for name, one in scenes.items()}
        for model in _MODELS:
            whole, whole_seconds = _timed(btf, model, None)
            for name, one in scenes.items():
                one.use()
                part, seconds = _timed(btf, model, one)
                pictures = [one.picture(result.material) for result in (whole, part)]
                errors = [_error(picture, truths[name]) for picture in pictures]
                used = part.report["scene"]
                rows.append({
                    "data": data, "scene": name, "model": model, "samples": used["samples_share"],
                    "texels": used["texels_share"], "outside measured": used["outside_measured_share"],
                    "whole (s)": whole_seconds, "scene (s)": seconds, "times faster": whole_seconds / seconds,
                    "whole bytes": _size(whole.material), "scene bytes": _size(part.material),
                    "whole, inside": errors[0], "scene, inside": errors[1],
                    "whole, outside": _outside(btf, whole, one), "scene, outside": _outside(btf, part, one),
                })
                print(rows[-1], flush=True)
                if (data, name, model) == _SHOWN:
                    _picture(truths[name], *pictures)
    return rows


def _picture(truth: Tensor, whole: Tensor, part: Tensor) -> None:
    """Draw measured | whole fit | scene fit, and below how far the fits are off (grey is none)."""
    def off(picture: Tensor) -> Tensor:
        return (colour.display(picture) - colour.display(truth)) / 2 + 0.5

    shown = {
        "measured": colour.display(truth), "whole fit": colour.display(whole),
        "fit for this picture": colour.display(part),
        "": torch.ones_like(truth), "whole - measured": off(whole), "fit for it - measured": off(part),
    }
    figure, axes = plotting().subplots(2, 3, figsize=(9, 6.2), layout="constrained")
    for axis, (title, picture) in zip(axes.flat, shown.items(), strict=True):
        axis.imshow(picture.permute(1, 2, 0).numpy(), vmin=0, vmax=1)
        axis.set_title(title, fontsize=9)
        axis.axis("off")
    save_figure(figure, RESULTS / "scene.png")
