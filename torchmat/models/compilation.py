"""Shading that is compiled: many operations on a picture become one loop over its texels."""

from __future__ import annotations

import logging
import warnings
from functools import cache

import torch
from torch import Tensor

from torchmat.models.base import Material


def compiled(material: Material) -> Material:
    """Return `material` with its shading compiled by ``torch.compile``: for many pictures of one size.

    The first picture of each size waits up to 20 seconds for the compiler; from then on `lambert`, and `hsh` and
    `phong_srf` with directions per pixel, take a third to a quarter of the time. Where matrix products and look-ups take
    it, as in `distribution`, nothing is gained. Values differ from those of the plain material
    by rounding, and gradients pass. The maps are shared with `material`; what is made from the result by `with_maps`
    and the like is plain again. torch keeps eight such programs in a process - of models, sizes, with and without gradients -
    and shades plainly beyond; ``torch._dynamo.reset()`` forgets them. Where `can_compile` is false, `material` itself is returned.
    """
    if not can_compile():
        return material
    flat = material.surface()
    plain = flat._unchecked(flat.maps, _compiled=None)

    def value(maps: dict[str, Tensor], light: Tensor, view: Tensor) -> Tensor:
        return plain.sharing(maps).value(light, view)

    return material._unchecked(material.maps, _compiled=torch.compile(value))


@cache
def can_compile() -> bool:
    """Whether this machine has what ``torch.compile`` needs: a C++ compiler and Python's headers. Tried out once."""
    try:
        with warnings.catch_warnings():  # torch's compiler warns of torch's own old parts
            warnings.simplefilter("ignore")
            torch.compile(lambda x: x.square() + 1)(torch.ones(4))
    except Exception as reason:  # whatever a broken tool chain raises, the plain path does not need it
        logging.getLogger(__name__).info("shading is not compiled: %s", reason)
        return False
    return True
