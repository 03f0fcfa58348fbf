"""Materials of an object that does not fill its texture: what stands outside of it, and the opacity that cuts it out."""

from __future__ import annotations

from typing import TypeVar

import torch
from torch import Tensor

from torchmat import safe
from torchmat.models.base import Material
from torchmat.models.relief_maps import OPACITY
from torchmat.models.storage import MapSpec, StoredAs

M = TypeVar("M", bound=Material)


def neutral_outside(material: M, mask: Tensor | None) -> M:
    """Return a material whose maps hold, outside of `mask`, bool [H, W], the mean of the object.

    No average and no range of codes then sees the outside. A normal is the plane's, an index the commonest; a height is
    left as it is: geometry says what it is there. None, or a mask that is true nowhere, changes nothing.
    """
    if mask is None or not bool(mask.any()):
        return material
    maps = {
        spec.name: _filled(spec, material.maps[spec.name].detach(), mask) for spec in material.specs()
        if spec.per_texel and not spec.constant and spec.name not in ("height", OPACITY.name)
    }
    return material.with_maps(**maps)


def _filled(spec: MapSpec, values: Tensor, mask: Tensor) -> Tensor:
    known = values[:, mask]
    if spec.index:
        found = known.mode(dim=1).values
    elif spec.kind == "normal":
        found = torch.tensor([0.0, 0.0, 1.0], dtype=values.dtype)
    else:
        found = known.double().mean(dim=1).to(values.dtype)
        # A mean lies between its values, which rounding must not undo at a map's bounds.
        found = torch.minimum(torch.maximum(found, known.amin(dim=1)), known.amax(dim=1))
    if spec.kind == "rotation":
        found = safe.normalise(found, dim=0)
        found = found if bool(found.norm() > 0.5) else known[:, 0]
    return torch.where(mask, values, found[:, None, None])


def cut_out(material: M, mask: Tensor | None) -> M:
    """Return a material that is opaque inside of `mask`, bool [H, W], and cut out outside; as it is without a mask.

    An opacity that it has already is kept as it is. The map is stored in 8 bits, which hold a mask to the bit.
    """
    if mask is None or OPACITY.name in material.maps:
        return material
    whole = material.with_maps(opacity=mask[None].to(material.dtype))
    return whole.stored_at({OPACITY.name: StoredAs(storage="png8")})
