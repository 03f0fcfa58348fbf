"""What an RTI file does not hold, measured on what a reader of it finds."""

from __future__ import annotations

import torch

from torchmat.material_io.exporter import Losses
from torchmat.material_io.rti.sampled import CHECKED, FITTED, is_rti, sees_the_view, shading_error
from torchmat.models.indirect import BETWEEN
from torchmat.models import Material

_COEFFICIENTS = "coefficients"
_NO_DIFFERENCE_DB = 150.0


def losses_of(material: Material, written: Material, found: Material, form: str) -> Losses:
    """Return what became of a material that was written as `written` and is read back as `found` from a file of a `form`."""
    relative, decibel = shading_error(material, found)
    lost = {}
    if sees_the_view(material):
        lost["view"] = "it is seen along the normal only"
    lost |= {name: "its light and shadow are in the coefficients" for name in ("height", *BETWEEN) if name in material.maps}
    if "opacity" in material.maps:
        lost["opacity"] = "a hole is black"
    if material.cutout is not None:
        lost["tiling"] = "the file is read as a texture by itself"
    if is_rti(material, (written.name,)) and _alike(written, found):
        return Losses(exact=(_COEFFICIENTS,), lost=lost)
    shading = f"shading under {CHECKED} lights {relative:.3g} off, {_decibel(decibel)}"
    how = form if written is material else f"fitted as {written.name} to {FITTED} lights in codes of a screen, {form}"
    return Losses(approximated={_COEFFICIENTS: f"{how}: {shading}"}, lost=lost)


def _decibel(value: float) -> str:
    return "no difference on a screen" if value > _NO_DIFFERENCE_DB else f"{value:.1f} dB on a screen"


def _alike(written: Material, found: Material) -> bool:
    return all(torch.equal(value.detach().float(), found.maps[name].detach()) for name, value in written.maps.items())
