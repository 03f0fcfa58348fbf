"""What a page needs of a material: a description that is JSON, and the codes of its maps as they are stored.

torchmat/web/README.md says what each entry is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import RangeError, message
from torchmat.models.base import Material
from torchmat.models.indirect import INDIRECT, small_transfer
from torchmat.models.storage import Codes, MapSpec, decode
from torchmat.web.codes import TYPES, stacked_bytes
from torchmat.web.glsl import defines_of, shader_of, source_of

FORMAT, VERSION = "torchmat-web", 1
TRANSFER = MapSpec("transfer", "light that arrives by way of other texels, for each harmonic of the light", layers=tuple(map(str, range(9))))
_MOST_CHANNELS = 4  # of a texel on a graphics card


class Payload(NamedTuple):
    """A `description` that is JSON, and of each of its maps the codes, little endian."""

    description: dict[str, Any]
    buffers: dict[str, bytes]


def has_shader(material: Material) -> bool:
    """Return whether pages can draw a material; others are shown by pictures."""
    return shader_of(type(material)) is not None


def describe(material: Material, known: Mapping[str, tuple[dict[str, Any], bytes]] | None = None) -> Payload:
    """Return what a page needs to draw a material as its textures hold it (`as_exported`).

    `known` are maps that `map_of` has made before, and that are the same still.

    Raises RangeError where its model has no shader, or a map cannot be stored.
    """
    return _described(material, source_of(material), defines_of(material), known or {})


def describe_pictured(material: Material, known: Mapping[str, tuple[dict[str, Any], bytes]] | None = None) -> Payload:
    """Return the same of a material without a shader, which a page shows beside pictures of it; "glsl" is None."""
    return _described(material, None, {}, known or {})


def _described(
    material: Material, source: str | None, defines: dict[str, Any], known: Mapping[str, tuple[dict[str, Any], bytes]]
) -> Payload:
    names = [spec.name for spec in material.specs() if not spec.constant]
    maps = [known[name] if name in known else map_of(material, name) for name in names + ([TRANSFER.name] if INDIRECT.name in material.maps else [])]
    description = {
        "format": FORMAT, "version": VERSION, "model": material.name, "size": list(material.size), "whole_size": list(material.whole_size),
        "tiles": material.tiles, "bright_at_horizon": material.bright_at_horizon, "relief": material.relief if material.has_relief else None,
        "derives_normal": material.derives_normal,
        "defines": defines, "glsl": source,
        "numbers": {spec.name: values.tolist() for spec, values in material.numbers() if spec.constant},
        "maps": [entry for entry, _ in maps],
    }
    return Payload(description, {entry["name"]: codes for entry, codes in maps})


def map_of(material: Material, name: str) -> tuple[dict[str, Any], bytes]:
    """Return the entry and the codes of one map, "transfer" among them where light between texels is told by radiosity."""
    if name == TRANSFER.name and INDIRECT.name in material.maps:
        return _transfer(material)
    spec = next((one for one in material.specs() if one.name == name and not one.constant), None)
    if spec is None:
        fact = f"it has no {name}"
        raise RangeError(message("map_of", "name", "be a map of the material", fact))
    textures = [one for one in material.textures() if one.spec.name == name]
    if textures:
        parts = [one.codes() for one in textures]
    else:
        values = next(values for one, values in material.numbers() if one.name == name)
        parts = [_floats(part[:, None, None]) for part in values.split(spec.layer_channels)]
    return _entry(spec, parts if has_shader(material) else [one for part in parts for one in _cut(part)])


def _cut(codes: Codes) -> list[Codes]:
    """Return what has more channels than a page takes as one layer for each: no shader reads it there."""
    count = codes.pixels.shape[2]
    if count <= _MOST_CHANNELS:
        return [codes]
    return [replace(codes, pixels=codes.pixels[..., k : k + 1], low=codes.low[k : k + 1], high=codes.high[k : k + 1]) for k in range(count)]


def _transfer(material: Material) -> tuple[dict[str, Any], bytes]:
    assert material.diffuse_map is not None
    planes = small_transfer(material.maps["height"].detach(), material.maps[material.diffuse_map].detach(), material.tiles)
    entry, codes = _entry(TRANSFER, [_floats(layer) for layer in planes])
    return {**entry, "wraps": False}, codes


def _floats(planes: Tensor) -> Codes:
    return Codes(planes.float().permute(1, 2, 0).numpy())


def _entry(spec: MapSpec, parts: list[Codes]) -> tuple[dict[str, Any], bytes]:
    """Return the entry of a map that textures of these codes hold, and the codes below each other."""
    height, width, channels = parts[0].pixels.shape
    if channels > _MOST_CHANNELS:
        fact = f"{spec.name} has {channels}"
        raise RangeError(message("describe", "a texture", f"have at most {_MOST_CHANNELS} channels", fact, "Cut it into layers."))
    entry = {
        "name": spec.name, "kind": spec.kind, "meaning": spec.meaning, "colour": spec.looks_coloured, "index": spec.index,
        "per_texel": spec.per_texel, "labels": list(spec.layers), "layers": len(parts), "channels": channels,
        "height": height, "width": width, "type": TYPES[parts[0].pixels.dtype.name], "transfer": parts[0].transfer,
        "low": [one for part in parts for one in part.low], "high": [one for part in parts for one in part.high],
        "range": range_of(parts),
    }
    return entry, stacked_bytes([part.pixels for part in parts])


def range_of(parts: list[Codes]) -> list[float]:
    """Return the least and the greatest value of textures: those of the least and the greatest codes, but for hues."""
    values = [decode(part if part.transfer == "hue" else _ends(part)) for part in parts]
    return [float(min(map(torch.min, values))), float(max(map(torch.max, values)))]


def _ends(codes: Codes) -> Codes:
    return replace(codes, pixels=np.stack((codes.pixels.min(axis=(0, 1)), codes.pixels.max(axis=(0, 1))))[None])
