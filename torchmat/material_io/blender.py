"""Blender: a script that builds a node group around a Principled BSDF, and the pictures that it loads."""

from __future__ import annotations

import math
import pprint
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import check_positive
from torchmat.images import write_image
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.pictures import codes_of, normal_codes, values_of
from torchmat.material_io.renderer_form import COATED, losses_of_form, microfacet_form, microfacet_of
from torchmat.models import Material
from torchmat.models.renderers import DIELECTRIC

SCRIPT = "material.py"
_SOURCE = Path(__file__).with_name("blender_script.txt")
_STRETCH = 0.9  # Cycles: alpha across over along is 1 - 0.9 anisotropic
_MOST_F0 = 0.98  # beyond that an index of refraction grows without bound
_DIMMED = "Cycles dims it by what the specular part reflects"
_SOCKETS = {
    "base_color": "Base Color", "specular_tint": "Specular Tint", "roughness": "Roughness", "anisotropic": "Anisotropic", "alpha": "Alpha",
    "coat": "Coat Weight", "coat_roughness": "Coat Roughness", "sheen_tint": "Sheen Tint",
}


def write_blender(material: Material, path: Path, *, depth: int = 16, width: float = 1.0, name: str = "torchmat") -> Losses:
    """Write ``material.py`` and its pictures into an empty folder; return what they do not hold.

    Args:
        depth: bits a channel, 8 or 16.
        width: width of the texture in Blender's units, by which the height is scaled.
        name: what the material and its node group are called.
    """
    check_positive("export to blender", "width", width)
    form = microfacet_form(material)
    pictures = _Pictures(path, depth)
    maps = {key: value.detach() for key, value in form.maps.items()}
    f0 = maps["specular_f0"]
    most = min(_MOST_F0, max(float(f0.max()), 1e-4))
    held = {
        "diffuse": pictures.add("base_color", maps["diffuse"], coded=True),
        "specular_f0": most * pictures.add("specular_tint", f0 / most, coded=True), **_roughness(pictures, maps),
    }
    values: dict[str, Any] = {"IOR": (1 + math.sqrt(most)) / (1 - math.sqrt(most)), "Metallic": 0.0, "Specular IOR Level": 0.5}
    if "normal" in maps:
        pictures.write("normal", normal_codes(maps["normal"], depth))
        held["normal"] = maps["normal"]
    if "opacity" in maps:
        held["opacity"] = pictures.add("alpha", maps["opacity"])
    if "coat" in maps:
        held |= {"coat": DIELECTRIC * pictures.add("coat", maps["coat"] / DIELECTRIC), "coat_roughness": pictures.add("coat_roughness", maps["coat_roughness"])}
        values["Coat IOR"] = 1.5
    if "sheen" in maps:
        held |= {"sheen": pictures.add("sheen_tint", maps["sheen"], coded=True), "sheen_roughness": maps["sheen_roughness"]}
        values |= {"Sheen Weight": 1.0, "Sheen Roughness": float(maps["sheen_roughness"])}
    settings = {"name": name, "tiles": material.tiles, "values": values, "sockets": _SOCKETS, "pictures": pictures.written}
    extra = _height(material, pictures, settings, width)
    text = _SOURCE.read_text("utf-8").format(settings=pprint.pformat(settings, sort_dicts=False, width=110))
    (path / SCRIPT).write_text(text, encoding="utf-8")
    lost = {"f90": "it has no place there", "rolloff": "it has no place there", "layered": "Cycles has its own way"}
    told = {} if "layered" in form.options["parts"] else {"diffuse": _DIMMED}
    told |= {"coat": COATED} if "coat" in form.maps else {}
    return losses_of_form(material, form, microfacet_of(held, material), lost, told, extra)


class _Pictures:
    """Pictures in a folder, and what the script is told of them."""

    def __init__(self, path: Path, depth: int) -> None:
        self.path, self.depth = path, depth
        self.written: dict[str, dict[str, Any]] = {}

    def write(self, name: str, codes: Any, coded: bool = False) -> None:
        """Write the codes of a picture."""
        write_image(self.path / f"{name}.png", codes)
        self.written[name] = {"file": f"{name}.png", "srgb": coded}

    def add(self, name: str, values: Tensor, coded: bool = False) -> Tensor:
        """Write a map; return what the picture holds."""
        codes = codes_of(values, self.depth, coded)
        self.write(name, codes, coded)
        return values_of(codes, coded)


def _roughness(pictures: _Pictures, maps: dict[str, Tensor]) -> dict[str, Tensor]:
    """Write roughness, and of two of them Cycles' anisotropy and the turn of the tangent; return what they hold."""
    rough = maps["roughness"]
    if "rotation" not in maps:
        return {"roughness": pictures.add("roughness", rough)}
    along, across = (rough * rough).split(1)
    stretch = (1 - across / along.clamp(min=1e-12)) / _STRETCH
    usual = pictures.add("roughness", (along * across).sqrt().sqrt())
    ratio = 1 - _STRETCH * pictures.add("anisotropic", stretch.clamp(0, 1))
    turn = torch.cat((maps["rotation"], torch.zeros_like(along)))
    codes = codes_of(turn / 2 + 0.5, pictures.depth)
    pictures.write("rotation", codes)
    alpha = usual * usual
    alphas = torch.cat((alpha / ratio.sqrt(), alpha * ratio.sqrt())).clamp(0, 1)
    return {"roughness": alphas.sqrt(), "rotation": values_of(codes)[:2] * 2 - 1}


def _height(material: Material, pictures: _Pictures, settings: dict[str, Any], width: float) -> dict[str, Tensor]:
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


BLENDER = Exporter("blender", "a script for Blender 4 that builds a Principled node group, and its pictures", write_blender)
