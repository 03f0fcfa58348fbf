"""Maps as KTX 2.0 (Khronos): one file a map, its textures as layers of an array of half floats, with all mips.

What is written is the basic form, without compression: a head, an index of levels, a description of the format, keys, then the
levels from the smallest on. Renderers load it without decoding anything; ``maps.json`` says what each layer and number is.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import RangeError, message
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.folder import CONVENTIONS
from torchmat.machine import package_version
from torchmat.models import Material
from torchmat.models.storage import StoredTexture
from torchmat.written import write_record

DESCRIPTION = "maps.json"
_IDENTIFIER = b"\xabKTX 20\xbb\r\n\x1a\n"
_RGBA16F, _COMPONENT_BYTES, _TEXEL_BYTES = 97, 2, 8  # VK_FORMAT_R16G16B16A16_SFLOAT
_LARGEST = float(np.finfo(np.float16).max)
_HEAD, _LEVEL = 80, 24  # bytes of the head, and of an entry of the index


def _padded(data: bytes, unit: int) -> bytes:
    return data + bytes(-len(data) % unit)


def _description(linear_colour: bool) -> bytes:
    """Return the data format descriptor of four signed half floats, in linear light (KDFS 1.3, section 5)."""
    samples = b"".join(
        struct.pack("<HBBIII", 16 * place, 15, 0xC0 | channel, 0, 0xBF800000, 0x3F800000)  # signed float, -1 to 1
        for place, channel in enumerate((0, 1, 2, 15))
    )
    primaries = 1 if linear_colour else 0  # Rec. 709, or none: data
    basic = struct.pack("<IHHBBBB4B8B", 0, 2, 24 + len(samples), 1, primaries, 1, 0, 0, 0, 0, 0, _TEXEL_BYTES, *[0] * 7) + samples
    return struct.pack("<I", 4 + len(basic)) + basic


def _keys(values: dict[str, str]) -> bytes:
    found = b""
    for key in sorted(values):
        entry = f"{key}\0{values[key]}\0".encode()
        found += _padded(struct.pack("<I", len(entry)) + entry, 4)
    return found


def ktx2_bytes(levels: list[np.ndarray], keys: dict[str, str], linear_colour: bool) -> bytes:
    """Return a KTX 2.0 file of `levels`, each [layers, h, w, 4] of float16, the largest first."""
    layers, height, width, _ = levels[0].shape
    description, table = _description(linear_colour), _keys(keys)
    first = _HEAD + _LEVEL * len(levels)
    place = first + len(description) + len(table)
    gap = -place % _TEXEL_BYTES  # levels are whole texels: one gap before all of them is enough
    bodies, entries, place = [bytes(gap)], [], place + gap
    for level in reversed(levels):
        bodies.append(level.astype("<f2").tobytes())
        entries.append((place, len(bodies[-1]), len(bodies[-1])))
        place += len(bodies[-1])
    head = _IDENTIFIER + struct.pack(
        "<9I4I2Q", _RGBA16F, _COMPONENT_BYTES, width, height, 0, layers if layers > 1 else 0, 1, len(levels), 0,
        first, len(description), first + len(description), len(table), 0, 0,
    )
    index = b"".join(struct.pack("<3Q", *entry) for entry in reversed(entries))
    return b"".join((head, index, description, table, *bodies))


def _mips(values: Tensor, count: int | None) -> list[Tensor]:
    """Return values [layers, C, h, w] and their averages over twice the width, to 1 x 1; `count` 1 leaves them as they are."""
    found = [values]
    while count is None and max(found[-1].shape[-2:]) > 1:
        height, width = found[-1].shape[-2:]
        found.append(torch.nn.functional.adaptive_avg_pool2d(found[-1], (max(1, height // 2), max(1, width // 2))))
    return found


def _pixels(values: Tensor) -> np.ndarray:
    """Return values [layers, C, h, w] as [layers, h, w, 4], filled up with 0, and with an alpha of 1."""
    layers, channels, height, width = values.shape
    found = np.zeros((layers, height, width, 4), np.float16)
    found[..., 3] = 1
    found[..., :channels] = values.permute(0, 2, 3, 1).numpy()
    return found


def _write_map(path: Path, textures: list[StoredTexture]) -> dict[str, Any]:
    spec = textures[0].spec
    values = torch.stack([texture.values.detach().float() for texture in textures])
    if values.shape[1] > 4:  # a table of many channels: each is a layer by itself
        values = values.flatten(0, 1)[:, None]
    largest = float(values.abs().max())
    if largest > _LARGEST:
        step = "Divide it by a constant."
        fact = f"its largest magnitude is {largest:.6g}, above {_LARGEST:.6g}"
        raise RangeError(message("export to ktx2", spec.name, "fit half floats", fact, step), map=spec.name)
    levels = _mips(values, None if spec.per_texel and not spec.index else 1)
    names = [texture.name for texture in textures]
    keys = {"KTXorientation": "rd", "KTXwriter": f"torchmat {package_version()}", "torchmat:layers": ",".join(names)}
    path.write_bytes(ktx2_bytes([_pixels(level) for level in levels], keys, spec.colour))
    return {
        "map": spec.name, "meaning": spec.meaning, "file": path.name, "layers": names, "channels": spec.layer_channels,
        "levels": len(levels), "height": values.shape[2], "width": values.shape[3], "colour": spec.colour,
        "filter": "nearest" if spec.index else "bilinear",
    }


def write_ktx2(material: Material, path: Path, *, provenance: dict[str, Any] | None = None) -> Losses:
    """Write each map of a material as a KTX 2.0 file in half floats, with mips, and ``maps.json`` that says what they are."""
    groups: dict[str, list[StoredTexture]] = {}
    whole = material.stored_at(dict.fromkeys(material.stored)).stored_as("half")
    for texture in whole.textures():
        groups.setdefault(texture.spec.name, []).append(texture)
    entries = [_write_map(path / f"{name}.ktx2", textures) for name, textures in groups.items()]
    write_record(path / DESCRIPTION, {
        "format": "torchmat-ktx2", "version": 1, "written_by": f"torchmat {package_version()}", "model": material.name,
        "options": material.options, "tiles": material.tiles, "height": material.size[0], "width": material.size[1],
        "conventions": {key: CONVENTIONS[key] for key in ("frame", "value")},
        "constants": {spec.name: values.tolist() for spec, values in whole.numbers()}, "maps": entries,
        "provenance": provenance or {},
    })
    return Losses.of_maps(material, {name: _as_half(value, name in groups) for name, value in material.maps.items()})


def _as_half(value: Tensor, textured: bool) -> Tensor:
    return value.detach().half().to(value.dtype) if textured else value.detach()


KTX2 = Exporter("ktx2", "each map as KTX 2.0: half floats, textures as layers, all mips", write_ktx2, record=DESCRIPTION)
