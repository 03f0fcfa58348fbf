"""Fit of sphere images to a BTF: one reflectance for all texels, times a colour of each."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from torchmat import safe
from torchmat.brdf import AnalyticBrdf
from torchmat.brdf.analytic import ANALYTIC
from torchmat.errors import RangeError, check_option, message
from torchmat.fitting.models.by_cell import cells_of
from torchmat.fitting.models.lobe import fit_lobe
from torchmat.fitting.models.spheres.problem import Shape, SphereProblem
from torchmat.fitting.models.streamed import stream_means
from torchmat.fitting.recipe import Recipe
from torchmat.fitting.shared import Shared
from torchmat.fitting.training import Fitted, Training
from torchmat.models.sphere_images import PAPER_ANGLES_DEG, SphereImages, below_each_other, paper_turn, render_spheres
from torchmat.repeatable import add_product
from torchmat.solvers.stop_reasons import CLOSED_FORM

SPHERE_BASES = ("phong", "blinn", "cook_torrance", "ggx")
_LAST_DEG = PAPER_ANGLES_DEG[-1]
_FADE = 8  # corrections die out within a so-manieth of a picture
_STEPS = 60
_SHADED = 2_000_000  # values at a time, where each texel has directions of its own


def fit_sphere_images_to_btf(
    training: Training, *, pictures: int = 4, size: int = 48, base: str = "ggx", smoothness: float = 0.3,
    storage: str = "half",
) -> Fitted:
    """Fit sphere pictures to each image's mean over the texels, then a tint per texel.

    All texels share one isotropic reflectance, times a colour: the tint, in closed form. (The paper has homogeneous
    materials only.) The pictures are those of a lobe fitted to the means, plus a correction: a linear least squares that
    fades out where there are no samples. Coverage is 1 where a texel has any sample.

    Args:
        pictures: pictures of the sphere, evenly from 0 to 135 degrees between light and view, at least 2.
        size: texels across a picture, at least 2.
        base: the formula that says what no sample does: "phong", "blinn", "cook_torrance" or "ggx".
        smoothness: how far a sparse sample speaks for its neighbourhood, above 0: larger is smoother.
    """
    check_option("fit sphere_images", "base", base, SPHERE_BASES)
    for name, value, least in (("pictures", pictures, 2), ("size", size, 2), ("smoothness", smoothness, 1e-9)):
        if not least <= value < math.inf:
            raise RangeError(message("fit sphere_images", name, f"be at least {least} and finite", f"it is {value}"))
    dtype = training.dtype
    angles = [number * _LAST_DEG / (pictures - 1) for number in range(pictures)]
    images, reason = training.table("images"), CLOSED_FORM
    figures: dict[str, Any] = {}
    if images is None:
        images, reason, figures = _pictures(training, angles, size, base, smoothness)
    maps = {"images": images, "turn": paper_turn(dtype), "tint": torch.ones(3, 1, 1, dtype=dtype)}
    homogeneous = SphereImages(maps, angles_deg=angles, storage=storage)
    tint, coverage = _tint(training, homogeneous)
    return Fitted(homogeneous.with_maps(tint=tint), reason, coverage, figures, shared=Shared({"images": images}))


def _pictures(
    training: Training, angles: list[float], size: int, base: str, smoothness: float
) -> tuple[Tensor, str, dict[str, Any]]:
    """Return the pictures that all texels share, the lobe's stop reason, and figures."""
    btf, used, dtype = training.btf, training.used, training.dtype
    importance: Tensor | None
    if btf.near is None:
        means = stream_means(btf, used, torch.ones(btf.height, btf.width, dtype=torch.bool), dtype)[used]
        light, view = training.light[used].double(), training.view[used].double()
        importance = None if training.importance is None else training.importance[used]
    else:
        light, view, means, importance, _ = cells_of(training)
    parameters, reason = fit_lobe(ANALYTIC[base], light, view, means, differences=True, importance=importance)
    brdf = AnalyticBrdf.from_parameters(base, parameters)
    images = _corrected(brdf, angles, size, light, view, means, smoothness).to(dtype)
    return images, reason, {"lobe": dict(zip(ANALYTIC[base].names, parameters.tolist(), strict=True))}


def _corrected(
    brdf: AnalyticBrdf, angles: list[float], size: int, light: Tensor, view: Tensor, values: Tensor, smoothness: float
) -> Tensor:
    """Return the lobe's pictures [3 n, S, S] with what `values` [m, 3] at planes `light`, `view` [m, 3, 1, 1] add."""
    images = below_each_other(render_spheres(brdf, angles, size))
    light, view = (planes[:, :, 0, 0].T[:, None] for planes in (light, view))
    seen = view[2, 0] > 0
    light, view, values = light[..., seen], view[..., seen], values[seen].T
    if not values.numel():
        return images[0].unflatten(1, (len(angles), size)).transpose(0, 1).flatten(0, 1)
    problem = SphereProblem(light, view, values, torch.ones_like(values[0]), size)
    looked_up = problem.look(Shape(torch.deg2rad(torch.tensor(angles, dtype=images.dtype)), paper_turn(images.dtype)))
    problem.value = values - looked_up.apply(images)
    images = images + problem.solve(looked_up, torch.zeros_like(images), _STEPS, smoothness, _FADE / size)
    return images.clamp(min=0)[0].unflatten(1, (len(angles), size)).transpose(0, 1).flatten(0, 1)


def _tint(training: Training, material: SphereImages) -> tuple[Tensor, Tensor]:
    """Return each texel's least-squares factor [3, H, W] on the material's values, and where it is seen [1, H, W]."""
    btf, dtype = training.btf, training.dtype
    if btf.near is not None:
        return _tint_near(training, material)
    size = btf.height * btf.width
    above, below = torch.zeros(3, size, dtype=dtype), torch.zeros(3, size, dtype=dtype)
    for block in btf.blocks(training.used, dtype, training.progress):
        rows = slice(block.samples.start, block.samples.stop)
        value = material.shade(training.light[rows].to(dtype), training.view[rows].to(dtype))[:, :, 0]
        value = torch.where(training.used[rows, None, None], value, torch.zeros((), dtype=dtype))
        weight = torch.ones(1, dtype=dtype) if block.weight is None else block.weight.flatten(1).to(dtype)
        weight = training.counted(weight.expand(len(value), size), block.samples)
        for channel in range(3):
            images = block.images[:, channel].flatten(1)
            add_product(above[channel : channel + 1], value[:, channel], images * weight)
            add_product(below[channel : channel + 1], value[:, channel].square(), weight.contiguous())
    seen = below > 0
    tint = torch.where(seen, safe.divide(above, below).clamp(min=0), torch.ones((), dtype=dtype))
    shape = (btf.height, btf.width)
    return tint.unflatten(1, shape), seen.any(dim=0).to(torch.float32).reshape(1, *shape)


def _tint_near(training: Training, material: SphereImages) -> tuple[Tensor, Tensor]:
    """Return the same where each texel has directions of its own."""
    btf, dtype = training.btf, training.dtype
    above, below = torch.zeros(2, 3, btf.height, btf.width, dtype=dtype)
    white = material.with_maps(tint=torch.ones(3, btf.height, btf.width, dtype=dtype))
    for block in btf.blocks(training.used, dtype, training.progress):
        run = torch.arange(block.samples.start, block.samples.stop)
        for part in training.used[run].nonzero()[:, 0].split(max(1, _SHADED // above.numel())):
            value = white.shade(*training.planes(run[part])).detach()
            weight = torch.ones(len(part), 1, 1, 1, dtype=dtype) if block.weight is None else block.weight[part].to(dtype)
            weighted = value * training.counted(weight, run[part])
            above += (weighted * block.images[part]).sum(dim=0)
            below += (weighted * value).sum(dim=0)
    tint = torch.where(below > 0, safe.divide(above, below).clamp(min=0), torch.ones((), dtype=dtype))
    return tint, (below > 0).any(dim=0, keepdim=True).to(torch.float32)


SPHERE_IMAGES = Recipe(SphereImages, fit_sphere_images_to_btf, near=True, bytes_per_texel="6")
