"""What mechanism needs to know of the microfacet material's fit."""

from __future__ import annotations

from typing import Any

from torchmat.fitting.geometry import RECOVER
from torchmat.fitting.models.microfacet.fit import OPTIONAL, fit_microfacet, fit_microfacet_on_relief
from torchmat.fitting.objective import DISPLAY
from torchmat.fitting.recipe import Ladder, Part, Recipe, Tiling
from torchmat.models import Material, Microfacet


def _as_it_is(material: Material) -> Material:
    return material


def _nothing(material: Material) -> float:
    return 0.0


_REFUSED = (
    "draws roughness and the colour of F0 to the means of all texels, which a tile does not know",
    "Fit 'distribution' by tiles, or images that are downscaled.",
)
_BARE: dict[str, Any] = {**dict.fromkeys(OPTIONAL, False), "normal": False}
_LADDER = Ladder(
    bare=_BARE,
    parts=(
        Part("normal", 3, {"normal": True}), Part("layered", 0, {"layered": True}), Part("rolloff", 0, {"rolloff": True}),
        Part("anisotropy", 3, {"anisotropy": True}), Part("coat", 2, {"coat": True}), Part("sheen", 3, {"sheen": True}),
        Part("f90", 1, {"f90": True}),
    ),
    bytes=7, bytes_of_lobe=_nothing, without_idle_parts=_as_it_is,
)
MICROFACET = Recipe(
    Microfacet, fit_microfacet, bytes_per_texel="10 to 24", solvers=("minibatch", "adam", "lbfgs"), solvers_differ=False,
    objective=DISPLAY, ladder=_LADDER, on_relief=fit_microfacet_on_relief, near=True,
    quick={**dict.fromkeys(OPTIONAL, False), "effort": 0.06}, geometry=RECOVER,
    tiling=Tiling(refused=_REFUSED),
)
