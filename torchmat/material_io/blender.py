"""Blender: a script that builds a Principled BSDF or the model's lobes, and the pictures that it loads."""

from __future__ import annotations

import pprint
from pathlib import Path
from typing import Any

from torch import Tensor

from torchmat.errors import check_option, check_positive
from torchmat.material_io.blender_shaders import Pictures, Shaders
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.pictures import codes_of, values_of
from torchmat.material_io.renderer_form import COATED, losses_of_form, microfacet_form, microfacet_of
from torchmat.models import Material

SCRIPT = "material.py"
FORMS = ("portable", "closest")
_SOURCE = Path(__file__).with_name("blender_script.txt")
_DIMMED = "Cycles dims it by what the specular part reflects"
_FIBRES = "Cycles' fibres scatter in their own way"


def write_blender(
    material: Material, path: Path, *, form: str = "portable", depth: int = 16, width: float = 1.0,
    name: str = "torchmat",
) -> Losses:
    """Write ``material.py`` and its pictures into an empty folder; return what they do not hold.

    Args:
        form: "portable" is one Principled BSDF; "closest" adds up a diffuse BSDF and lobes that follow Schlick's
            curve as the model does, which programs other than Blender do not read.
        depth: bits a channel, 8 or 16.
        width: width of the texture in Blender's units, by which the height is scaled.
        name: what the material and its node group are called.
    """
    check_option("export to blender", "form", form, FORMS)
    check_positive("export to blender", "width", width)
    flat = microfacet_form(material)
    shaders = Shaders(dict(flat.maps.items()), path, depth)
    shaders.portable() if form == "portable" else shaders.closest()
    pictures = shaders.pictures
    settings = {
        "name": name, "tiles": material.tiles, "shaders": shaders.made, "opacity": shaders.opacity,
        "pictures": pictures.written,
    }
    extra = _height(material, pictures, settings, width)
    text = _SOURCE.read_text("utf-8").format(settings=pprint.pformat(settings, sort_dicts=False, width=110))
    (path / SCRIPT).write_text(text, encoding="utf-8")
    layered = "Cycles has its own way" if form == "portable" else "its lobes are added up"
    lost = {"rolloff": "it has no place there", "layered": layered}
    told = {"sheen": _FIBRES} if "sheen" in flat.maps else {}
    if form == "portable":
        lost["f90"] = "it has no place there"
        told |= {} if "layered" in flat.options["parts"] else {"diffuse": _DIMMED}
        told |= {"coat": COATED} if "coat" in flat.maps else {}
    return losses_of_form(material, flat, microfacet_of(shaders.held, material), lost, told, extra)


def _height(material: Material, pictures: Pictures, settings: dict[str, Any], width: float) -> dict[str, Tensor]:
    """Write the height, and tell the script of its range; return what it holds."""
    if "height" not in material.maps:
        return {}
    height = material.maps["height"].detach().float()
    low, high = float(height.min()), float(height.max())
    span = max(high - low, 1e-30)
    codes = codes_of((height - low) / span, 16)
    pictures.write("height", codes)
    settings |= {"midlevel": -low / span if high > low else 0.0, "scale": span * width if high > low else 0.0}
    return {"height": low + values_of(codes) * (high - low)}


BLENDER = Exporter("blender", "a script for Blender 4 and 5 that builds a node group, and its pictures", write_blender)
