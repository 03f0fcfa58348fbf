"""How far what a form holds is off: against the material itself, and against measured samples."""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat.btf import Btf
from torchmat.errors import ShapeError, message
from torchmat.material_io.as_microfacet.directions import measured_pairs
from torchmat.metrics import SampleErrors, relative
from torchmat.models import Material

_TEXELS = 4096  # that are looked at, evenly chosen
_VALUES = 1_000_000  # of one block
_SAMPLES = 512


def thinned(material: Material, texels: int = _TEXELS) -> Material:
    """Return the flat material of at most so many texels, every n-th along both sides; normals stay those of all."""
    flat = material.surface()
    step = 1
    while -(-flat.size[0] // step) * -(-flat.size[1] // step) > texels:
        step += 1
    return flat.sharing({
        spec.name: flat.maps[spec.name].detach()[:, ::step, ::step] if spec.per_texel and not spec.constant
        else flat.maps[spec.name].detach() for spec in flat.own_specs()
    })


def shade_pairs(material: Material, light: Tensor, view: Tensor) -> Tensor:
    """Return what a flat material shows [n, 3, H, W] under lights and views [n, 3]."""
    with torch.no_grad():
        return material.shade(*(direction.to(material.dtype)[:, :, None, None] for direction in (light, view)))


def shading_error(native: Material, held: Material) -> float:
    """Return the relative error of what a form holds against the native material, both without their relief.

    ``sum (p - t)^2 / sum t^2`` over the same 160 pairs of light and view for every material, a third of them about the
    mirror's direction, and at most 4096 texels. `held` has the size of `native`. NaN where only the native one is black.
    """
    if native.size != held.size:
        raise ShapeError(message("shading_error", "what is held", f"be {native.size} as the material", f"it is {held.size}"))
    one, other = (thinned(material.float() if material.dtype != torch.float32 else material) for material in (native, held))
    light, view = measured_pairs()
    error, energy = 0.0, 0.0
    for some in torch.arange(len(light)).split(max(1, _VALUES // (3 * one.texels))):
        target, found = (shade_pairs(material, light[some], view[some]).double() for material in (one, other))
        error += float((found - target).square().sum())
        energy += float(target.square().sum())
    return _known(relative(error, energy))


def held_out_error(held: Material, btf: Btf, samples: Tensor | None = None) -> float:
    """Return the relative error of what a form holds on samples of a BTF (None: all), on at most 512 of them."""
    if held.size != (btf.height, btf.width):
        fact, step = f"it is {btf.height} x {btf.width}", "Load it in the material's size."
        raise ShapeError(message("export", "btf", f"be {held.size[0]} x {held.size[1]} as the material", fact, step))
    rows = torch.arange(len(btf)) if samples is None else samples
    if len(rows) > _SAMPLES:
        rows = rows[torch.linspace(0, len(rows) - 1, _SAMPLES).round().long()]
    errors = SampleErrors()
    for some in rows.split(max(1, _VALUES // (3 * held.texels))):
        target = btf.images(some, held.dtype)
        with torch.no_grad():
            found = held.shade(*btf.directions(some, held.dtype))
        errors.add(found, target, btf.valid(some), btf.saturated(some, target), torch.zeros(len(some), dtype=torch.bool))
    return _known(errors.pooled()["relative_error"])


def _known(error: float | None) -> float:
    return float("nan") if error is None else error
