"""What is shown of the microfacet material by the compiled part: one pass, without gradients."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from torchmat.fast.call import call, fits, wants_gradient
from torchmat.fast.directions import Directions
from torchmat.fast.switch import library

_MAPS = (
    "diffuse", "specular_f0", "roughness", "normal", "rotation", "f90", "coat", "coat_roughness", "sheen", "sheen_roughness", "rolloff",
)  # in the order of microfacet.h


def shown(light: Tensor, view: Tensor, maps: Mapping[str, Tensor], layered: bool) -> Tensor | None:
    """Return what is shown [..., 3, H, W] of a material's own maps; None where that is for plain torch."""
    found, own = library(), {name: maps[name] for name in _MAPS if name in maps}
    if found is None or not fits(light, view, *own.values()) or wants_gradient(light, view, *own.values()):
        return None
    pair = Directions.of(light, view, own["diffuse"].shape[-2:])
    out, texels = pair.new_value(), own["diffuse"].shape[-2] * own["diffuse"].shape[-1]
    given = [own[name].detach().contiguous() if name in own else None for name in _MAPS]
    call(found, "microfacet", *pair.planes, *given, out, *pair.sizes, pair.count, texels, len(own["roughness"]), layered)
    return out
