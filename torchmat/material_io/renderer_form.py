"""What exporters for renderers share: the microfacet maps of any material, and the losses of what a form holds of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from torchmat.material_io.as_microfacet import as_microfacet
from torchmat.material_io.exporter import Losses
from torchmat.models import Material, Microfacet
from torchmat.models.microfacet import MICROFACET_PARTS
from torchmat.models.indirect import BETWEEN, BETWEEN_MAPS
from torchmat.models.relief_maps import HEIGHT
from torchmat.models.renderers import sorted_alphas
from torchmat.progress import phase

_NO_PARALLAX = "renderers neither shift nor shade what the normals show"
COATED = "renderers lift it towards grazing in their own way"
_FITTED = "held as diffuse, F0 and roughness of a GGX lobe"


def microfacet_form(material: Material) -> Microfacet:
    """Return the flat microfacet maps of a material, `along` the direction of the larger alpha, as renderers want it."""
    with phase("finding the maps of renderers"):
        form = as_microfacet(material)
    if "rotation" not in form.maps:
        return form
    most, least, direction = sorted_alphas(form)
    return form.sharing({**form.maps, "roughness": torch.cat((most, least)).sqrt(), "rotation": direction.clamp(-1, 1)})


def microfacet_of(maps: Mapping[str, Tensor], like: Material) -> Microfacet:
    """Return the microfacet material of the maps that a form holds, tiling as another does."""
    names = {"rotation": "anisotropy", "sheen_roughness": "sheen", "coat_roughness": "coat"}
    there = {names.get(name, name) for name in maps}
    parts = [part for part in MICROFACET_PARTS if part in there]
    return Microfacet({name: value.detach().float().contiguous() for name, value in maps.items()}, parts=parts, tiles=like.tiles)


def losses_of_form(
    material: Material, form: Microfacet, held: Microfacet, lost: Mapping[str, str] | None = None,
    approximated: Mapping[str, str] | None = None, extra: Mapping[str, Tensor] | None = None,
) -> Losses:
    """Return what became of a material's parts in a form that holds the maps of `held`, and `held` to be measured.

    Args:
        material: the native one.
        form: its microfacet maps.
        held: the material as the form holds it.
        lost: of parts that have no place, why.
        approximated: what is to be said of parts beside their difference.
        extra: maps of the relief that the form holds beside them.
    """
    relief = {spec.name: material.maps[spec.name] for spec in (HEIGHT, *BETWEEN_MAPS) if spec.name in material.maps}
    why = {HEIGHT.name: "it stays in the normals alone: " + _NO_PARALLAX, **dict.fromkeys(BETWEEN, "light from texel to texel has no place")}
    given = {name: reason for name, reason in (lost or {}).items() if name in form.maps or name in relief or name in form.options["parts"]}
    gone = given | {name: why[name] for name in relief if name not in (extra or {}) and name not in given}
    found = Losses.of_maps(form, held.maps, {name: reason for name, reason in gone.items()})
    for name, value in (extra or {}).items():
        before = relief[name].detach()
        off = float((before - value).abs().max())
        more = found.approximated if off == 0 else {**found.approximated, name: f"off by at most {off:.3g}, texture widths"}
        found = replace(found, exact=(*found.exact, name) if off == 0 else found.exact, approximated=more)
    if not isinstance(material, Microfacet):
        found = _of_other(material, found)
    told = {name: f"{found.approximated[name]}; {text}" if name in found.approximated else text for name, text in (approximated or {}).items()}
    exact = tuple(name for name in found.exact if name not in told)
    return replace(found, exact=exact, approximated={**found.approximated, **told}, held=held)


def _of_other(material: Material, found: Losses) -> Losses:
    """Return the losses in the words of a model whose own maps are others."""
    own = [spec.name for spec in material.specs()]
    approximated = {name: text for name, text in found.approximated.items() if name in own}
    lost = {name: text for name, text in found.lost.items() if name in own}
    rest = [name for name in own if name not in (*found.exact, *approximated, *lost)]
    return replace(
        found, exact=tuple(name for name in found.exact if name in own), lost=lost,
        approximated=approximated | dict.fromkeys(rest, _FITTED),
    )
