"""The samples of a material's texels, a part of the texels and of the samples at a time, and what the material says of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.btf import Btf
from torchmat.fitting.certainty.space import Space, is_linear
from torchmat.fitting.objective import Residual
from torchmat.fitting.recipe import RECIPES
from torchmat.fitting.relief.surface import ambient, bring_onto, without_shadow
from torchmat.fitting.training import Training
from torchmat.models import Material
from torchmat.models.indirect import AMBIENT, FALLOFF, INDIRECT, between
from torchmat.models.relief_maps import OPACITY


class Some(NamedTuple):
    """Some samples at a strip of texels: directions [k, 3, 1, 1] (of near lights and cameras [k, 3, h, w]), values [k, 3, h, w],
    weights and light [k, 1, h, w]."""

    light: Tensor
    view: Tensor
    target: Tensor
    weight: Tensor
    lit: Tensor | None


@dataclass(frozen=True)
class Observed:
    """A material and the samples that its texels were fitted to, on the surface where it has a relief.

    `flat` is the material texel by texel, with its ambient light where it has any, in the form of its fit; `lit`
    [sample, 1, H, W] is how much light reaches a sample, None where it is all; `rows` are those of the texels that these are.
    """

    material: Material
    flat: Material
    btf: Btf
    space: Space
    lit: Tensor | None = None
    rows: slice = field(default_factory=lambda: slice(None))

    def strip(self, rows: slice) -> Observed:
        """Return the same of some rows of texels."""
        part = self.btf.window(rows.start, 0, rows.stop - rows.start, self.btf.width)
        lit = None if self.lit is None else self.lit[..., rows, :]
        return replace(self, flat=self.flat.sharing(cropped(self.flat, rows)), btf=part, lit=lit, rows=rows)

    def some(self, numbers: Tensor) -> Some:
        """Return samples by their numbers [k]."""
        dtype = self.flat.dtype
        light, view = self.btf.directions(numbers, dtype)
        weight = self.btf.weights(numbers).to(dtype)
        lit = None if self.lit is None else self.lit[self.btf.light_index[numbers]]
        return Some(light, view, self.btf.images(numbers, dtype), weight, lit)

    def residual(self, maps: Mapping[str, Tensor], some: Some) -> Tensor:
        """Return weighted residuals [k, 3, h, w] of maps in place of the material's own, in their precision."""
        light, view, target, weight = (one.to(maps[next(iter(maps))].dtype) for one in some[:4])
        predicted = self.predicted(maps, light, view, some.lit)
        return self.space.residual(predicted, target, weight)

    def predicted(self, maps: Mapping[str, Tensor], light: Tensor, view: Tensor, lit: Tensor | None = None) -> Tensor:
        """Return what maps say of lights and views [k, 3, 1, 1] above the horizon, in the form of the fit."""
        flat = self.flat.sharing(dict(maps))
        # What is linear was solved without regard to the clamp at black.
        value = flat.value(light, view) if is_linear(flat) else flat.shade(light, view)
        if lit is None:
            return value
        value = value * lit.to(value.dtype)
        if INDIRECT.name in self.material.maps:  # known, as all is that texels do to each other
            sent = between(self.material, light.to(self.material.dtype))
            return value if sent is None else value + sent.whole().detach()[..., self.rows, :]
        sent = between(self.material, light, maps)
        return value if sent is None else value + sent.whole()


def observe(material: Material, training: Training, objective: str | Residual | None = None) -> Observed:
    """Return what a fit of `material` to training samples looked at: themselves, or on a relief the samples on its surface."""
    recipe = RECIPES.get(material.name)
    lit = None
    if material.has_relief:
        surface = bring_onto(training, material.maps["height"].detach())
        training = surface.training
        if recipe is None or recipe.on_relief is None:  # fitted to what the light itself makes of the surface
            known = material.maps[AMBIENT.name].detach() if AMBIENT.name in material.maps else ambient(surface)
            training = without_shadow(surface, known)
        else:
            lit = surface.lit
    elif not bool(training.used.all()):
        rows = training.used.nonzero()[:, 0]
        training = replace(training, btf=training.btf.picked(rows), used=torch.ones(len(rows), dtype=torch.bool))
    space = Space(material, training, objective)
    flat = material.surface()
    flat = (flat.in_codes() if space.codes else None) or flat
    more = {name: material.maps[name] for name in (AMBIENT.name, FALLOFF.name) if lit is not None and name in material.maps}
    flat = flat.sharing({name: value.detach() for name, value in {**flat.maps, **more}.items() if name != OPACITY.name})
    return Observed(material, flat, training.btf, space, lit)


def cropped(material: Material, rows: slice) -> dict[str, Tensor]:
    """Return the maps of a material for some rows of its texels."""
    whole = material.size
    tables = {spec.name for spec in material.specs() if not spec.per_texel or spec.constant}
    return {
        name: value if name in tables or tuple(value.shape[-2:]) != whole else value[..., rows, :]
        for name, value in material.maps.items()
    }
