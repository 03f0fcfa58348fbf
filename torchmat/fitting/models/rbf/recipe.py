"""The recipe of `rbf`."""

from __future__ import annotations

from torchmat.fitting.models.rbf.fit import RbfShared, fit_rbf
from torchmat.fitting.recipe import Recipe, Rung, Tiling
from torchmat.models import Rbf

# Its coefficients cancel each other, as those of splines do: what steps along them does not get far.
RBF = Recipe(
    Rbf, fit_rbf, near="centred", bytes_per_texel="36", descends=False, shared=RbfShared, tiling=Tiling(kept_mb=260.0),
    compared=("components=9", "components=18"),
    rungs=tuple(Rung(f"{count} principal images", "rbf", count, {"components": count}, last=True) for count in (9, 18)),
)
