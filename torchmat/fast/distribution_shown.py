"""What is shown of the distribution material where texels have directions of their own, by the compiled part: without gradients."""

from __future__ import annotations

from torch import Tensor

from torchmat.fast.call import call, fits, wants_gradient
from torchmat.fast.directions import Directions
from torchmat.fast.distribution import Maps, packed
from torchmat.fast.switch import library


def shown(light: Tensor, view: Tensor, maps: Maps, dense: bool, exponent: float) -> Tensor | None:
    """Return what is shown [..., 3, H, W] of `maps`, of which the rise is made anew; None where that is for plain torch."""
    found, given = library(), [one for one in maps.every if one is not None]
    if found is None or not fits(light, view, *given) or wants_gradient(light, view, *given):
        return None
    pair = Directions.of(light, view, maps.diffuse.shape[-2:])
    if not pair.each_texel:
        return None
    out, texels, lobes = pair.new_value(), maps.diffuse.shape[-2] * maps.diffuse.shape[-1], len(maps.specular) // 3
    planes = [None if one is None else one.detach().contiguous() for one in maps.planes]
    channels = 1 if maps.specular_mask is None else len(maps.specular_mask)
    call(
        found, "distribution_shown", *pair.planes, *planes, packed(found, maps.specular), maps.squares.contiguous(), out, float(exponent),
        *pair.sizes, pair.count, texels, maps.specular.shape[-1], lobes, channels, dense,
    )
    return out
