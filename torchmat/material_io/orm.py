"""Texture sets as engines and vendors name them: base colour, metalness, roughness, normal, height, packed or one by one.

`torchmat create` reads every one of them back (`torchmat.create.textures`).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import check_option
from torchmat.geometry.normals import flip_green
from torchmat.images import write_image
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.pictures import codes_of, normal_codes, values_of
from torchmat.material_io.renderer_form import losses_of_form, microfacet_form, microfacet_of
from torchmat.models import Material, Microfacet
from torchmat.models.renderers import DIELECTRIC, from_metalness, to_metalness

_FLAT = 1e-9


class Vendor(NamedTuple):
    """How one names and packs textures.

    Args:
        files: name of each file behind the set's, and what its channels hold, in their order: "r" a base colour of three
            channels, "" white, else a map of one channel; "a" stands for alpha.
        directx: whether normals have their green downwards.
        specular: whether diffuse and F0 stand for themselves, instead of base colour and metalness.
    """

    files: dict[str, tuple[str, ...]]
    directx: bool = False
    specular: bool = False


VENDORS = {
    "unreal": Vendor({
        "BaseColor": ("color",), "OcclusionRoughnessMetallic": ("white", "roughness", "metalness"), "Normal_DirectX": ("normal",),
        "Height": ("height",), "Opacity": ("opacity",),
    }, directx=True),
    "unity": Vendor({
        "AlbedoTransparency": ("color", "opacity"), "MetallicSmoothness": ("metalness", "black", "black", "gloss"),
        "Normal_OpenGL": ("normal",), "Height": ("height",),
    }),
    "ambientcg": Vendor({
        "Color": ("color",), "Metalness": ("metalness",), "Roughness": ("roughness",), "NormalGL": ("normal",),
        "Displacement": ("height",), "Opacity": ("opacity",),
    }),
    "polyhaven": Vendor({
        "diff": ("color",), "arm": ("white", "roughness", "metalness"), "nor_gl": ("normal",), "disp": ("height",), "opacity": ("opacity",),
    }),
    "freepbr": Vendor({
        "albedo": ("color",), "metallic": ("metalness",), "roughness": ("roughness",), "normal-ogl": ("normal",), "height": ("height",),
        "opacity": ("opacity",),
    }),
    "substance": Vendor({
        "BaseColor": ("color",), "Metallic": ("metalness",), "Roughness": ("roughness",), "Normal_DirectX": ("normal",),
        "Height": ("height",), "Opacity": ("opacity",),
    }, directx=True),
    "poliigon": Vendor({
        "COL": ("color",), "REFL": ("f0",), "GLOSS": ("gloss",), "NORMALGL": ("normal",), "DISP": ("height",), "OPACITY": ("opacity",),
    }, specular=True),
}


def write_orm(material: Material, path: Path, *, vendor: str = "unreal", name: str = "material", depth: int = 16) -> Losses:
    """Write the textures of a set into an empty folder; return what reading it does not bring back.

    Args:
        vendor: a key of VENDORS, whose names, packing and green the set has; "poliigon" has specular and gloss instead of
            metalness and roughness, and holds every F0.
        name: what the files' names begin with.
        depth: bits a channel, 8 or 16.
    """
    check_option("export to orm", "vendor", vendor, VENDORS)
    return write_set(material, path, vendor, name, depth)


def write_set(material: Material, path: Path, vendor: str, name: str, depth: int, green_up: bool = False) -> Losses:
    """Write the textures of a vendor's set; with `green_up` its normals are OpenGL's whatever they are elsewhere."""
    form, how = microfacet_form(material), VENDORS[vendor]
    if green_up and how.directx:
        files = {stem.replace("DirectX", "OpenGL"): contents for stem, contents in how.files.items()}
        how = how._replace(files=files, directx=False)
    maps = {key: value.detach() for key, value in form.maps.items()}
    round_one = maps["roughness"] if len(maps["roughness"]) == 1 else maps["roughness"].prod(dim=0, keepdim=True).sqrt()
    values = {"roughness": round_one, "gloss": 1 - round_one, "white": torch.ones_like(round_one), "black": torch.zeros_like(round_one)}
    if how.specular:
        values |= {"color": maps["diffuse"], "f0": maps["specular_f0"]}
    else:
        values["color"], values["metalness"] = to_metalness(maps["diffuse"], maps["specular_f0"])
    values |= {key: maps[key] for key in ("normal", "opacity") if key in maps}
    if "height" in material.maps:
        height = material.maps["height"].detach().float()
        values["height"] = (height - height.min()) / (height.max() - height.min()).clamp(min=_FLAT)
    held: dict[str, Tensor] = {}
    for stem, contents in how.files.items():
        there = tuple(one for one in contents if one in values)
        if there and there[0] == contents[0]:
            held |= _written(path / f"{name}_{stem}.png", there, values, depth, how.directx)
    return _losses(material, form, held, how)


def _written(file: Path, contents: tuple[str, ...], values: dict[str, Tensor], depth: int, directx: bool) -> dict[str, Tensor]:
    """Write one texture; return what it holds, as a reader would have it."""
    if contents == ("normal",):
        codes = normal_codes(values["normal"], depth, directx)
        found = values_of(codes) * 2 - 1
        write_image(file, codes)
        return {"normal": flip_green(found) if directx else found}
    coded = contents[0] in ("color", "f0")
    planes = torch.cat([values[one] for one in contents])
    codes = codes_of(planes, depth, coded)
    write_image(file, np.ascontiguousarray(codes))
    read = values_of(codes, coded)
    if coded:
        return {contents[0]: read[:3], **({contents[1]: read[3:]} if len(contents) > 1 else {})}
    return {one: read[place : place + 1] for place, one in enumerate(contents)}


def _losses(material: Material, form: Microfacet, read: dict[str, Tensor], how: Vendor) -> Losses:
    """Return the losses by what the set's reader makes of the files."""
    if how.specular:
        diffuse, f0 = read["color"], read["f0"]
    else:
        diffuse, f0 = from_metalness(read["color"], read["metalness"])
    rough = read["roughness"] if "roughness" in read else 1 - read["gloss"]
    held = {"diffuse": diffuse, "specular_f0": f0, "roughness": rough}
    held |= {name: read[name] for name in ("normal", "opacity") if name in read}
    lost = {name: "the set has no texture for it" for name in form.options["parts"] if name not in ("normal",)}
    lost |= {name: "the set has no texture for it" for name in form.maps if name not in held}
    more = {}
    if "rotation" in form.maps:
        more["roughness"] = "one for both directions"
    if not how.specular:
        off = float((f0 - form.maps["specular_f0"].detach()).abs().max())
        if off > 0.5 / 255:
            more["specular_f0"] = f"a base colour and a metalness hold {DIELECTRIC} or the base colour"
    if "height" in material.maps:
        lost.pop("height", None)
        more["height"] = "0 to 1 without its scale, which a reader takes from the normals"
    result = losses_of_form(material, form, microfacet_of(held, material), lost, more)
    return replace(result, lost={name: text for name, text in result.lost.items() if name not in more})


ORM = Exporter("orm", "a texture set as engines and vendors name it: colour, metalness and roughness, normal, height", write_orm)
