"""Mitsuba 3: a plugin that evaluates the model itself, or a plain principled BSDF that needs none."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import torch

from torchmat.errors import check_option
from torchmat.images import write_image
from torchmat.machine import package_version
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.orm import write_set
from torchmat.material_io.renderer_form import losses_of_form, microfacet_form
from torchmat.models.indirect import BETWEEN
from torchmat.models import Distribution, Lambert, Material, Microfacet, PhongSrf, Texture
from torchmat.models.relief_maps import COMMON_MAPS

FORMS = ("plugin", "plain")
PLUGIN = "torchmat_bsdf.py"
_EVALUATED = (Texture, Lambert, Distribution, Microfacet, PhongSrf)
_SOURCE = Path(__file__).with_name("mitsuba_bsdf.txt")
_OF_RELIEF = "the plugin shades the normals, without parallax and shadow"


def write_mitsuba(material: Material, path: Path, *, form: str = "plugin", depth: int = 16) -> Losses:
    """Write a material for Mitsuba 3 into an empty folder; return what it does not hold.

    Args:
        form: "plugin" is ``torchmat_bsdf.py``, a BSDF that evaluates the model from float32 maps beside it: of `texture`,
            `lambert`, `phong_srf`, `distribution` and `microfacet`; others are brought to the last. "plain" is
            ``material.xml``, a `principled` BSDF of pictures, one roughness and a metalness.
        depth: bits a channel of the plain form's pictures, 8 or 16.
    """
    check_option("export to mitsuba", "form", form, FORMS)
    return _plain(material, path, depth) if form == "plain" else _plugin(material, path)


def _plugin(material: Material, path: Path) -> Losses:
    own = isinstance(material, _EVALUATED)
    flat: Material = material.surface() if own else microfacet_form(material)
    maps = {name: value.detach().float() for name, value in flat.maps.items()}
    if "opacity" in material.maps:
        maps["opacity"] = material.maps["opacity"].detach().float()
    entries: dict[str, Any] = {}
    for spec in (*flat.own_specs(), *COMMON_MAPS):
        if spec.name in maps and not spec.constant:
            files = _written(path, spec.name, maps[spec.name])
            entries[spec.name] = {"files": files, "per_texel": spec.per_texel, "meaning": spec.meaning}
    constants = {spec.name: maps[spec.name].tolist() for spec in flat.own_specs() if spec.constant}
    table = {
        "format": "torchmat-mitsuba", "version": 1, "written_by": f"torchmat {package_version()}", "model": flat.name,
        "options": flat.options, "tiles": material.tiles, "constants": constants, "maps": entries,
    }
    (path / "material.json").write_text(json.dumps(table, indent=1), encoding="utf-8")
    shutil.copyfile(_SOURCE, path / PLUGIN)
    if not own:
        assert isinstance(flat, Microfacet)
        return losses_of_form(material, flat, flat)
    lost = {name: _OF_RELIEF for name in ("height", *BETWEEN) if name in material.maps}
    exact = tuple(spec.name for spec in material.specs() if spec.name not in lost)
    return Losses(exact, {}, lost, held=flat)


def _written(path: Path, name: str, values: torch.Tensor) -> list[str]:
    """Write a map [C, h, w] as float32 pictures, of three channels where it has three of them, else of one."""
    step = 3 if len(values) % 3 == 0 else 1
    files = [f"{name}.exr" if len(values) == step else f"{name}_{number + 1}.exr" for number in range(len(values) // step)]
    for file, part in zip(files, values.split(step), strict=True):
        write_image(path / file, np.ascontiguousarray(part.movedim(0, -1).numpy(), np.float32))
    return files


def _plain(material: Material, path: Path, depth: int) -> Losses:
    losses = write_set(material, path, "substance", "material", depth, green_up=True)
    there = {file.stem.removeprefix("material_"): file.name for file in path.glob("*.png")}
    root = ElementTree.Element("scene", {"version": "3.0.0"})
    outer, normal = root, there.get("Normal_OpenGL")
    if "Opacity" in there:  # outermost: what is two-sided lets nothing through
        outer = ElementTree.SubElement(outer, "bsdf", {"type": "mask"})
        _texture(outer, "opacity", there["Opacity"], material.tiles, raw=True)
    outer = ElementTree.SubElement(outer, "bsdf", {"type": "twosided"})
    if normal is not None:
        outer = ElementTree.SubElement(outer, "bsdf", {"type": "normalmap"})
        _texture(outer, "normalmap", normal, material.tiles, raw=True)
    inner = ElementTree.SubElement(outer, "bsdf", {"type": "principled"})
    for name, file, raw in (("base_color", "BaseColor", False), ("roughness", "Roughness", True), ("metallic", "Metallic", True)):
        _texture(inner, name, there[file], material.tiles, raw)
    ElementTree.SubElement(inner, "float", {"name": "specular", "value": "0.5"})  # F0 of 0.04
    root[0].set("id", "material")
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path / "material.xml", encoding="utf-8", xml_declaration=True)
    return losses


def _texture(parent: ElementTree.Element, name: str, file: str, tiles: bool, raw: bool) -> None:
    node = ElementTree.SubElement(parent, "texture", {"type": "bitmap", "name": name})
    ElementTree.SubElement(node, "string", {"name": "filename", "value": file})
    ElementTree.SubElement(node, "string", {"name": "wrap_mode", "value": "repeat" if tiles else "clamp"})
    ElementTree.SubElement(node, "boolean", {"name": "raw", "value": "true" if raw else "false"})


MITSUBA = Exporter("mitsuba", "a Mitsuba 3 plugin that evaluates the model itself, or plain XML (form)", write_mitsuba)
