"""What a fit for a scene is worth: how much smaller it is, and how true inside of the scene and outside."""

from __future__ import annotations

import dataclasses
from typing import Any

import torch
from torch import Tensor

from torchmat.btf import Btf, Split
from torchmat.btf.interpolated import RawBtf
from torchmat.fitting.evaluate import sample_errors
from torchmat.fitting.training import Fitted
from torchmat.metrics import relative
from torchmat.models import Material
from torchmat.scene_use import SceneUse

_POINTS = 20_000


def scene_figures(
    btf: Btf, fitted: Fitted, split: Split, use: SceneUse, tiles: bool, measure: bool, progress: bool | None
) -> dict[str, Any]:
    """Return what a fit for a scene looked at, bytes, and with `measure` the relative errors of its material.

    `bytes` is what is stored, `whole_bytes` what the same maps would take for the whole texture at the images'
    resolution. `inside_points` is the error at points of the scene against the measured images, interpolated, each
    counting as it is used; `inside_held_out` that on held-out samples, each counting as it is used;
    `outside_held_out` that on those which the scene does not use: what was given up. None where there are none.
    """
    material, share = fitted.material, fitted.scene
    assert share is not None
    per_texel, shared = material.bytes_per_texel, material.shared_bytes
    found: dict[str, Any] = {
        **dataclasses.asdict(share),
        "bytes": round(per_texel * material.texels) + shared,
        "whole_bytes": round(per_texel * btf.height * btf.width) + shared,
    }
    if not measure:
        return found
    inside, outside = _held_out(btf, material, split.held_out, use, progress)
    # Between directions that were measured there is nothing to compare with where each texel has its own.
    found["inside_points"] = None if btf.near is not None else _at_points(btf, material, use, tiles)
    return {**found, "inside_held_out": inside, "outside_held_out": outside}


def _at_points(btf: Btf, material: Material, use: SceneUse, tiles: bool) -> float | None:
    chosen = use.evenly(_POINTS)
    measured = RawBtf(btf, tiles, memory_gb=0, dtype=material.dtype)
    while max(measured.size) > max(material.whole_size):  # the images at the resolution of a material that is smaller
        measured = measured.halved()
    dtype, uv = material.dtype, use.uv[:, None, use.point[chosen]].to(material.dtype)
    light, view = (plane[:, None, chosen].to(dtype) for plane in (use.light, use.view))
    with torch.no_grad():
        truth, found = (shader.shade_at(uv, light, view)[:, 0].double() for shader in (measured, material))
    weight = use.weight[chosen].double()
    return relative(float(((found - truth).square() * weight).sum()), float((truth.square() * weight).sum()))


def _held_out(
    btf: Btf, material: Material, rows: Tensor, use: SceneUse, progress: bool | None
) -> tuple[float | None, float | None]:
    """Return the errors on held-out samples that the scene uses, weighed, and on those that it does not use."""
    if not len(rows):
        return None, None
    errors = sample_errors(material, btf, rows, torch.zeros(len(rows), dtype=torch.bool), progress)
    squared, energy = torch.cat(errors.squared), torch.cat(errors.energy)
    weight = use.sample_weights(btf.light, btf.view).weight[rows]
    unused = weight == 0

    def error(counts: Tensor) -> float | None:
        return relative(float((squared * counts).sum()), float((energy * counts).sum())) if bool(counts.any()) else None

    return error(weight), error(unused.double())
