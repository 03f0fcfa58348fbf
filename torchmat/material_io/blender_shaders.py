"""Shaders for Blender's script, whose light is added up: one Principled BSDF, or the model's own lobes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchmat import safe
from torchmat.images import write_image
from torchmat.material_io.pictures import codes_of, normal_codes, values_of
from torchmat.models.ggx import usual_f90
from torchmat.models.renderers import DIELECTRIC

_STRETCH = 0.9  # Cycles: alpha across over along is 1 - 0.9 anisotropic
_MOST_F0 = 0.98  # beyond that an index of refraction grows without bound
_PRINCIPLED = "ShaderNodeBsdfPrincipled"
_ROUGH = {"roughness": "Roughness", "anisotropic": "Anisotropic", "rotation": "Tangent"}
_NOTHING = (0.0, 0.0, 0.0, 1.0)


class Shaders:
    """Pictures, shaders (dicts of kind, values and sockets by picture), and what both hold of the maps."""

    def __init__(self, maps: Mapping[str, Tensor], path: Path, depth: int) -> None:
        self.maps = {name: value.detach() for name, value in maps.items()}
        self.pictures = Pictures(path, depth)
        self.made: list[dict[str, Any]] = []
        self.held: dict[str, Tensor] = {}
        self.opacity: str | None = None
        if "normal" in maps:
            self.pictures.write("normal", normal_codes(self.maps["normal"], depth))
            self.held["normal"] = self.maps["normal"]
        if "opacity" in maps:
            self.held["opacity"] = self.pictures.add("alpha", self.maps["opacity"])

    def _add(self, kind: str, values: dict[str, Any], sockets: dict[str, str], share: str | None = None) -> None:
        there = {name: socket for name, socket in sockets.items() if name in self.pictures.written}
        self.made.append({"kind": kind, "values": values, "sockets": there, "share": share})

    def portable(self) -> None:
        """Hold the maps as one Principled BSDF, whose index of refraction gives the largest F0."""
        maps, pictures = self.maps, self.pictures
        f0 = maps["specular_f0"]
        most = min(_MOST_F0, max(float(f0.max()), 1e-4))
        self.held |= {
            "diffuse": pictures.add("base_color", maps["diffuse"], coded=True),
            "specular_f0": most * pictures.add("specular_tint", f0 / most, coded=True), **_roughness(pictures, maps),
        }
        index = (1 + math.sqrt(most)) / (1 - math.sqrt(most))
        values: dict[str, Any] = {"IOR": index, "Metallic": 0.0, "Specular IOR Level": 0.5}
        if "coat" in maps:
            self.held |= {
                "coat": DIELECTRIC * pictures.add("coat", maps["coat"] / DIELECTRIC),
                "coat_roughness": pictures.add("coat_roughness", maps["coat_roughness"]),
            }
            values["Coat IOR"] = 1.5
        values |= self._sheen()
        sockets = {
            "base_color": "Base Color", "specular_tint": "Specular Tint", **_ROUGH, "alpha": "Alpha",
            "coat": "Coat Weight", "coat_roughness": "Coat Roughness", "sheen_tint": "Sheen Tint",
        }
        self._add(_PRINCIPLED, values, sockets)

    def closest(self) -> None:
        """Hold diffuse and specular part and coat as shaders of their own, of which none dims another.

        A metal of Principled reflects by Schlick's curve from its base colour, F0, to 1; where F90 is less, that share
        of it is seen.
        """
        maps, pictures = self.maps, self.pictures
        self.opacity = "alpha" if "opacity" in maps else None
        self.held["diffuse"] = pictures.add("base_color", maps["diffuse"], coded=True)
        self._add("ShaderNodeBsdfDiffuse", {"Roughness": 0.0}, {"base_color": "Color"})
        self.held |= _roughness(pictures, maps)
        f0, total = self._metal("specular", maps["specular_f0"], maps.get("f90"), _ROUGH)
        self.held["specular_f0"] = f0
        if "f90" in maps:
            self.held["f90"] = safe.divide(total, usual_f90(f0)).clamp(max=1)
        if "coat" in maps:
            self.held["coat_roughness"] = pictures.add("coat_roughness", maps["coat_roughness"])
            self.held["coat"] = self._metal("coat", maps["coat"], None, {"coat_roughness": "Roughness"})[0]
        if "sheen" in maps:
            values = {"Base Color": _NOTHING, "Specular IOR Level": 0.0, **self._sheen()}
            self._add(_PRINCIPLED, values, {"sheen_tint": "Sheen Tint"})

    def _metal(self, name: str, f0: Tensor, f90: Tensor | None, sockets: dict[str, str]) -> tuple[Tensor, Tensor]:
        """Add a metal's lobe; return its F0 and F90 as the pictures hold them."""
        total = usual_f90(f0) * (1.0 if f90 is None else f90)
        weight = torch.maximum(total, f0.amax(dim=0, keepdim=True)).clamp(max=1)  # F0 is seen, where it is above F90
        share = f"{name}_share" if bool((weight < 1).any()) else None
        if share is not None:
            weight = self.pictures.add(share, weight)
        colour = self.pictures.add(f"{name}_f0", safe.divide(f0, weight).clamp(max=1), coded=len(f0) == 3)
        self._add(_PRINCIPLED, {"Metallic": 1.0}, {f"{name}_f0": "Base Color", **sockets}, share)
        return weight * colour, weight

    def _sheen(self) -> dict[str, float]:
        if "sheen" not in self.maps:
            return {}
        sheen, rough = self.pictures.add("sheen_tint", self.maps["sheen"], coded=True), self.maps["sheen_roughness"]
        self.held |= {"sheen": sheen, "sheen_roughness": rough}
        return {"Sheen Weight": 1.0, "Sheen Roughness": float(rough)}


class Pictures:
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


def _roughness(pictures: Pictures, maps: dict[str, Tensor]) -> dict[str, Tensor]:
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
