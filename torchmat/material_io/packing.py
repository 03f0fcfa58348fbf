"""The distribution material packed for run time: few textures, of which a shader reads all channels at once.

Liao 2011, section 4.1: the normal, calculated beforehand, with the height in alpha; mask and Fresnel beside the
rotation's hue; all specular maps in one layered texture. `packed.json` says of every channel what it is and how its
codes become values. The material folder is what one edits; this is what one ships.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat import safe
from torchmat.errors import DataError, RangeError, TorchmatError, check_finite, check_known_keys, check_option, message
from torchmat.geometry import normals_from_slopes, slopes_from_height, slopes_from_normals
from torchmat.images import read_image, write_image
from torchmat.machine import package_version
from torchmat.material_io.exporter import LOSS, Exporter, Losses
from torchmat.models import Distribution, Material
from torchmat.models.cutout import Cutout
from torchmat.models.relief_maps import FAST, HEIGHT
from torchmat.models.storage import Codes, MapSpec, decode, encode
from torchmat.text_file import read_json
from torchmat.written import write_record

FORMAT, VERSION, DESCRIPTION = "torchmat-packed", 1, "packed.json"
DEPTHS = (8, 16)
_FILES = (
    DESCRIPTION, "normal_height.png", "normal.png", "rotation_mask_fresnel.png", "specular_mask.png", "diffuse.png",
    "ambient.png", "opacity.png", "index_*.png", "specular_maps.exr", "tilt.png", LOSS,
)
_Picture = Callable[..., Any]  # makes a texture of (map, values, names of its channels)
_RGB = ("r", "g", "b")
_PER_TEXTURE = 3  # index channels: a fourth would be an alpha, which painting programs multiply with
CONVENTIONS = {
    "codes": "value = low + (high - low) * code / largest code; where transfer is srgb the code is decoded first",
    "normal": "x right, y up (OpenGL), z out; the whole normal, that of the height included",
    "height": "texture widths over the plane of the images",
    "rotation": "turns counter-clockwise from +x as a hue; filter its cosine and sine, never the angle",
    "specular_maps": "parabolic, layer k in rows k * side to (k + 1) * side, in the order of a texture array; with the option "
    "specular_spacing dense the place p is looked up at p (p.p + 1 / 65536)^(-1/4)",
    "tilt": "1 - d at 0..90 degrees, filtered linearly",
    "masking": "among the constants: a_u, a_v of Smith's denominator in the texel's turned frame; without it D is Ashikhmin's",
}


@dataclass(frozen=True)
class Packed:
    """One texture: file name, codes, and (map, component) of every channel; a component "" is filling."""

    file: str
    codes: Codes
    contents: tuple[tuple[str, str], ...]


def pack(
    material: Material, folder: str | Path, depth: int = 8, provenance: dict[str, Any] | None = None, force: bool = False
) -> Path:
    """Write a distribution material as packed textures that appear whole or not at all; return the folder.

    Specular maps are half floats and the tilt has 16 bits at either depth.

    Args:
        material: a distribution material.
        folder: where; what stands there is replaced if it was packed before and not changed since, else refused.
        depth: bits a channel, 8 or 16.
        provenance: what the manifest says of where the material comes from, as JSON has it; None is nothing.
        force: True replaces what was changed since it was packed too, and keeps a backup as ``NAME.backup-1``.

    Raises RangeError for another model and for maps that cannot be stored, DataError when the folder cannot be written.
    """
    target = Path(folder)
    backup = PACKED.check_folder(target, "a packed material", force)
    PACKED.write_whole(material, target, {"depth": depth}, provenance, backup=backup)
    return target


def _known_files(target: Path) -> Callable[[str], bool]:
    return lambda name: any(fnmatch(name, known) for known in _FILES)


def write_packed(material: Material, path: Path, *, depth: int = 8, provenance: dict[str, Any] | None = None) -> Losses:
    """Write packed textures and their description into an existing folder; return what unpacking does not bring back."""
    textures = _textures(material, depth)
    described = {
        "format": FORMAT, "version": VERSION, "written_by": f"torchmat {package_version()}", "depth": depth,
        **_settings(material), "height": material.size[0], "width": material.size[1], "conventions": CONVENTIONS,
        "textures": [_entry(texture) for texture in textures], "provenance": provenance or {},
    }
    for texture in textures:
        write_image(path / texture.file, texture.codes.pixels)
    write_record(path / DESCRIPTION, described)
    return Losses.of_maps(material, _unpacked(textures, material).maps)


PACKED = Exporter(
    "packed", "the distribution material in few textures for a shader, 8 or 16 bits (depth)", write_packed,
    known=_known_files, record=DESCRIPTION,
)


def packed(material: Material, depth: int = 8) -> Distribution:
    """Return the material as its packed textures would bring it back, without files: what its error is measured on."""
    return _unpacked(_textures(material, depth), material)


def _unpacked(textures: list[Packed], material: Material) -> Distribution:
    planes = _by_map((decode(texture.codes), texture.contents) for texture in textures)
    return _assembled(planes, _settings(material))


def unpack(folder: str | Path) -> Distribution:
    """Return the material of a folder that `pack` wrote.

    It has the maps as packed: on a relief a normal map too, which refines the height's to what was stored. Raises
    DataError, which names the file, for what is missing, of another size or depth, or not understood.
    """
    folder = Path(folder)
    path = folder / DESCRIPTION
    described = _read_description(path)
    try:
        found = []
        for entry in described["textures"]:
            contents = tuple((channel["map"], channel["component"]) for channel in entry["channels"])
            found.append((_read(folder, entry), contents))
        return _assembled(_by_map(found), described)
    except DataError:
        raise
    except (TorchmatError, LookupError, TypeError, ValueError, RuntimeError, AttributeError, OverflowError) as error:
        fact = f"{type(error).__name__}: {error}".rstrip(".")
        step = "Restore the file from the original, or pack the material again."
        raise DataError(message(str(path), "the description", "describe a packed material", fact, step)) from error


def _settings(material: Material) -> dict[str, Any]:
    found = {"model": material.name, "options": material.options, "tiles": material.tiles, "storage": material.storage}
    found |= {} if material.relief == FAST else {"relief": material.relief}
    constants = {spec.name: material.maps[spec.name].detach().float().tolist() for spec in material.specs() if spec.constant}
    found |= {"constants": constants} if constants else {}
    return found if material.cutout is None else found | {"cutout": material.cutout.as_table()}


def _textures(material: Material, depth: int) -> list[Packed]:
    """Return every texture of the packed material."""
    if not isinstance(material, Distribution):
        step = "Export it with save_material."
        raise RangeError(message("pack", "material", "be a distribution material", f"it is {material.name}", step))
    check_option("pack", "depth", depth, DEPTHS)
    maps = {name: value.detach() for name, value in material.maps.items()}
    specs = {spec.name: spec for spec in material.specs()}
    storage = f"png{depth}"

    def picture(file: str, *parts: tuple[MapSpec, Tensor, tuple[str, ...]]) -> Packed:
        return _joined(file, [(spec, encode(spec, value, storage), names) for spec, value, names in parts])

    colours = [name for name in ("diffuse", "ambient") if name in maps]
    found = [picture(f"{name}.png", (specs[name], maps[name], _RGB)) for name in colours]
    found += _shape(material, maps, picture) + _lookup(material, specs, maps, picture)
    if "opacity" in maps:
        found.append(picture("opacity.png", (specs["opacity"], maps["opacity"], ("opacity",))))
    if "index" in maps:
        for number, first in enumerate(range(0, len(maps["index"]), _PER_TEXTURE)):
            found.append(picture(f"index_{number + 1}.png", *_index_parts(specs["index"], maps["index"], first)))
    if "specular" in maps:
        strip = torch.cat(maps["specular"].split(3), dim=1)
        spec = specs["specular"]
        found.append(_joined("specular_maps.exr", [(spec, encode(spec, strip, "half"), _RGB)]))
    if "tilt" in maps:
        whole = replace(specs["tilt"], fixed_range=True)
        found.append(_joined("tilt.png", [(whole, encode(whole, maps["tilt"], "png16"), ("tilt",))]))
    return found


def _shape(material: Distribution, maps: dict[str, Tensor], picture: _Picture) -> list[Packed]:
    """Return the texture of normal and height, if the material has either."""
    flat = material.surface()
    if "normal" not in flat.maps:
        return []
    spec = next(spec for spec in flat.own_specs() if spec.name == "normal")
    normal = (spec, safe.normalise(flat.maps["normal"].detach()), ("x", "y", "z"))
    if "height" not in maps:
        return [picture("normal.png", normal)]
    return [picture("normal_height.png", normal, (HEIGHT, maps["height"], ("height",)))]


def _lookup(material: Distribution, specs: dict[str, MapSpec], maps: dict[str, Tensor], picture: _Picture) -> list[Packed]:
    """Return the texture of rotation, mask and Fresnel, if the material has any, and that of a coloured mask."""
    coloured = "specular_mask" in maps and len(maps["specular_mask"]) == 3
    found = []
    if coloured:
        found.append(picture("specular_mask.png", (specs["specular_mask"], maps["specular_mask"], _RGB)))
    inside = {"rotation", "fresnel"} | (set() if coloured else {"specular_mask"})
    if not inside & set(maps):
        return found
    nothing = torch.zeros(1, *material.size, dtype=material.dtype)
    turns = MapSpec("rotation", "angle in turns", layer_channels=1, low=0.0, high=1.0, fixed_range=True)
    parts = [(turns, _turns(maps["rotation"]) if "rotation" in maps else nothing, ("turns" if "rotation" in maps else "",))]
    for name in ("specular_mask", "fresnel"):
        there = name in maps and name in inside
        # Linear codes: a texture has one transfer at run time, and an angle none.
        spec = replace(specs[name], colour=False) if there else turns
        parts.append((spec, maps[name] if there else nothing + 1, (name if there else "",)))
    return [*found, picture("rotation_mask_fresnel.png", *parts)]


def _index_parts(spec: MapSpec, index: Tensor, first: int) -> list[tuple[MapSpec, Tensor, tuple[str, ...]]]:
    """Return the channels of one index texture: always three, since two would be grey and alpha."""
    part = index[first : first + _PER_TEXTURE]
    empty = _PER_TEXTURE - len(part)
    padded = torch.cat((part, part.new_zeros(empty, *part.shape[1:])))
    names = tuple(str(first + number + 1) for number in range(len(part))) + ("",) * empty
    return [(replace(spec, fixed_range=True), padded, names)]


def _turns(rotation: Tensor) -> Tensor:
    """Return the angle of [2, H, W] as turns [1, H, W] in [0, 1)."""
    return (torch.atan2(rotation[1:], rotation[:1]).double() / (2 * torch.pi)) % 1


def _joined(file: str, parts: list[tuple[MapSpec, Codes, tuple[str, ...]]]) -> Packed:
    """Put the channels of some maps side by side; they share one transfer."""
    codes = [code for _, code, _ in parts]
    low, high = (sum((getattr(code, end) for code in codes), ()) for end in ("low", "high"))
    pixels = np.concatenate([code.pixels for code in codes], axis=2)
    contents = tuple((spec.name if name else "", name) for spec, _, names in parts for name in names)
    return Packed(file, Codes(pixels, low, high, codes[0].transfer), contents)


def _entry(texture: Packed) -> dict[str, Any]:
    height, width, count = texture.codes.pixels.shape
    channels = []
    for number, (name, component) in enumerate(texture.contents):
        channel: dict[str, Any] = {"channel": "RGBA"[number], "map": name, "component": component}
        if texture.codes.low:
            channel |= {"low": texture.codes.low[number], "high": texture.codes.high[number]}
        channels.append({**channel, "transfer": texture.codes.transfer})
    kind = texture.codes.pixels.dtype.name
    return {"file": texture.file, "height": height, "width": width, "type": kind, "channels": channels}


def _by_map(textures: Any) -> dict[str, Tensor]:
    """Gather the planes [c, H, W] of each map; filling is left out."""
    found: dict[str, list[Tensor]] = {}
    for planes, contents in textures:
        for plane, (name, component) in zip(planes, contents, strict=True):
            if component:
                found.setdefault(name, []).append(plane[None])
    return {name: torch.cat(parts) for name, parts in found.items()}


def _assembled(planes: dict[str, Tensor], settings: dict[str, Any]) -> Distribution:
    """Return the material of unpacked planes: strip, turns and whole normals become the maps of the model again."""
    maps, options = dict(planes), dict(settings["options"])
    maps |= {name: torch.tensor(values, dtype=torch.float32) for name, values in settings.get("constants", {}).items()}
    if "specular" in maps:
        maps["specular"] = torch.cat(maps["specular"].split(maps["specular"].shape[-1], dim=1))
    if "rotation" in maps:
        angle = maps["rotation"].double() * (2 * torch.pi)
        maps["rotation"] = torch.cat((torch.cos(angle), torch.sin(angle))).float()
    if "height" in maps:
        slopes = slopes_from_normals(safe.normalise(maps["normal"]))
        maps["normal"] = normals_from_slopes(slopes - slopes_from_height(maps["height"], tiles=settings["tiles"]))
        options["parts"] = sorted({*options["parts"], "normal"})
    cutout = None if settings.get("cutout") is None else Cutout.of_table(settings["cutout"])
    same = {"tiles": settings["tiles"], "storage": settings["storage"], "relief": settings.get("relief", FAST)}
    return Distribution(maps, **same, cutout=cutout, **options)


def _read_description(path: Path) -> dict[str, Any]:
    if not os.path.isfile(path):
        step = "Give the folder that `pack` wrote."
        raise DataError(message(str(path), "the description", "exist", "it is not there", step))
    described = read_json(path, "the description", "be a packed material")
    try:
        kind, number, model = described["format"], described["version"], described["model"]
    except KeyError as error:
        fact = f"{type(error).__name__}: {error}"
        step = "Restore the file from the original."
        raise DataError(message(str(path), "the description", "be a packed material", fact, step)) from error
    for name, value, wanted in (("format", kind, FORMAT), ("version", number, VERSION), ("model", model, Distribution.name)):
        if value != wanted:
            step = "Pack the material again with this version of torchmat."
            raise DataError(message(str(path), name, f"be {wanted!r}", f"it is {value!r}", step))
    return described


def _read(folder: Path, entry: dict[str, Any]) -> Tensor:
    """Return one texture [C, H, W], decoded."""
    name, channels = entry["file"], entry["channels"]
    if Path(name).name != name:
        raise DataError(message(str(folder / DESCRIPTION), f"file {name!r}", "be a plain name", "it leads elsewhere"))
    path = folder / name
    if not os.path.isfile(path):
        raise DataError(message(str(path), "the texture", "exist", "it is not there", "Restore or pack it again."))
    pixels = read_image(path)
    wanted = (entry["height"], entry["width"], len(channels))
    if pixels.shape != wanted or pixels.dtype.name != entry["type"]:
        fact = f"it is {' x '.join(map(str, pixels.shape))} of {pixels.dtype.name}"
        requirement = f"be {' x '.join(map(str, wanted))} of {entry['type']}"
        raise DataError(message(str(path), "the texture", requirement, fact, "Save it in that size and depth."))
    for channel in channels:
        check_option(str(folder / DESCRIPTION), f"the transfer of {name}", channel["transfer"], ("linear", "srgb"))
        check_known_keys(str(folder / DESCRIPTION), channel, ("channel", "map", "component", "low", "high", "transfer"))
    low, high = (tuple(float(channel[end]) for channel in channels if end in channel) for end in ("low", "high"))
    whole = len(channels) if np.issubdtype(pixels.dtype, np.integer) else 0
    if not len(low) == len(high) == whole or len({channel["transfer"] for channel in channels}) > 1:
        requirement = "have one transfer, and a low and a high for each channel of integer codes"
        fact = f"it has {len(low)} low and {len(high)} high"
        raise DataError(message(str(folder / DESCRIPTION), f"the entry of {name}", requirement, fact))
    found = decode(Codes(np.ascontiguousarray(pixels), low, high, channels[0]["transfer"]))
    check_finite(str(path), "the texture", found, "Correct those texels, or pack the material again.")
    return found
