"""Values that are sums of known functions of light and view, and Lambert's, by the compiled part: one pass, without gradients."""

from __future__ import annotations

from torch import Tensor

from torchmat.fast.call import call, fits, wants_gradient
from torchmat.fast.directions import Directions
from torchmat.fast.switch import library

_BASES = {"cosine": 0, "polynomial": 1, "half": 2, "half_light": 3, "quadratic": 4, "hsh4": 5, "hsh9": 5, "hsh16": 5}  # as in sums.h


def weighed(
    light: Tensor, view: Tensor, basis: str, layers: Tensor, *, chroma: Tensor | None = None, phong: Tensor | None = None,
    codes: bool = False,
) -> Tensor | None:
    """Return what is shown [..., 3, H, W] of maps that weigh a `basis`; None where that is for plain torch.

    `layers` [3 K, H, W] are a colour a term; with a `chroma` [3, H, W] they are [K, H, W]. `phong` [7] is a lobe on top;
    `codes` says that the sum is one of a screen's codes.
    """
    maps = [one for one in (layers, chroma, phong) if one is not None]
    found = library()
    if found is None or not fits(light, view, *maps) or wants_gradient(light, view, *maps):
        return None
    pair = Directions.of(light, view, layers.shape[-2:])
    if not pair.each_texel:  # one weight an image: a product of two matrices
        return None
    out, texels = pair.new_value(), layers.shape[-2] * layers.shape[-1]
    terms = len(layers) // (3 if chroma is None else 1)
    maps_given = [None if one is None else one.contiguous() for one in (layers, chroma, phong)]
    call(found, "weighed", *pair.planes, *maps_given, out, *pair.sizes, pair.count, texels, _BASES[basis], terms, codes)
    return out


def lambert(light: Tensor, view: Tensor, albedo: Tensor, normal: Tensor) -> Tensor | None:
    """Return what is shown [..., 3, H, W] of an albedo and normals, [3, H, W] both; None where that is for plain torch."""
    found = library()
    if found is None or not fits(light, view, albedo, normal) or wants_gradient(light, view, albedo, normal):
        return None
    pair = Directions.of(light, view, albedo.shape[-2:])
    out, texels = pair.new_value(), albedo.shape[-2] * albedo.shape[-1]
    call(found, "lambert", *pair.planes, albedo.contiguous(), normal.contiguous(), out, *pair.sizes, pair.count, texels)
    return out
