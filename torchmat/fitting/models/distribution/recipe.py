"""What mechanism needs to know of the distribution material's fit."""

from __future__ import annotations

from typing import Any

from torchmat.fitting.geometry import RECOVER
from torchmat.fitting.models.distribution.fit import fit_distribution, fit_distribution_on_relief
from torchmat.fitting.models.distribution.parameters import DistributionShared, to_one
from torchmat.fitting.objective import DISPLAY
from torchmat.fitting.recipe import Ladder, Part, Recipe, Tiling
from torchmat.fitting.training import Fitted
from torchmat.models import Distribution
from torchmat.models.edit import without_idle_parts


def _settle(options: dict[str, Any], fitted: Fitted) -> tuple[dict[str, Any], Fitted]:
    """Return options that leave nothing to decide, and the fit with specular maps of the scale that tiles take."""
    parts, lobes = (fitted.material.options[name] for name in ("parts", "lobes"))
    chosen: dict[str, Any] = {part: part in parts for part in ("fresnel", "rotation", "tilt")}
    chosen["denominator"] = "smith" if "masking" in parts else "tilt" if "tilt" in parts else "ashikhmin"
    chosen["specular_spacing"] = fitted.material.specular_spacing
    chosen["fresnel_exponent"] = fitted.material.options["fresnel_exponent"]
    if lobes and isinstance(fitted.shared, DistributionShared):
        fitted = fitted.with_material(fitted.material.with_maps(specular=fitted.shared.specular))
    return {**options, "lobes": lobes, **chosen}, fitted


def _bytes_of_lobe(material: Distribution) -> float:
    """Return the bytes a texel of one specular map."""
    sizes = {spec.name: material.bytes_of(spec) for spec in material.specs()}
    return sizes["specular"] / material.options["lobes"] / material.texels


_LADDER = Ladder(
    bare={"lobes": 1, "fresnel": False, "rotation": False, "normal": False, "specular_mask": False, "tilt": False},
    parts=(
        Part("specular_mask", 1, {"specular_mask": True}), Part("fresnel", 1, {"fresnel": True}),
        Part("rotation", 2, {"rotation": True}), Part("normal", 3, {"normal": True}), Part("2 lobes", 2, {"lobes": 2}),
        Part("3 lobes", 1, {"lobes": 3}), Part("tilt", 0, {"tilt": True}),
    ),
    bytes=4, bytes_of_lobe=_bytes_of_lobe, without_idle_parts=without_idle_parts,
)
DISTRIBUTION = Recipe(
    Distribution, fit_distribution, bytes_per_texel="7 to 18", solvers=("minibatch", "adam", "lbfgs"), solvers_differ=True,
    objective=DISPLAY, ladder=_LADDER, on_relief=fit_distribution_on_relief, near=True,
    # What a relief is worth shows long before the last step.
    quick={"lobes": 1, "fresnel": True, "rotation": True, "effort": 0.1},
    shared=DistributionShared, geometry=RECOVER,
    # Kept: a process that was allowed 600 MB for tiles of 96 x 96 under 441 samples took 1.23 GB beside Python and torch.
    tiling=Tiling(4096, _settle, to_one, bytes_per_texel=24_000, kept_mb=750.0, holds_samples=True),
)
