"""Material folders read: the textures, painted over or not, by what the manifest says of them."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchmat.errors import DataError, TorchmatError, check_finite, check_option, message
from torchmat.images import read_image
from torchmat.material_io.files import reader_of
from torchmat.material_io.folder import FORMAT, MANIFEST, VERSIONS
from torchmat.material_io.gltf_material import is_glb, material_of
from torchmat.material_io.painted import check_hues, in_channels, in_size
from torchmat.models import MATERIALS, Material
from torchmat.models.cutout import Cutout
from torchmat.models.relief_maps import FAST
from torchmat.models.resample import restored
from torchmat.models.storage import Codes, MapSpec, StoredAs, decode
from torchmat.text_file import read_json

TRANSFERS = ("linear", "srgb", "hue")


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """Return the manifest of a material folder; raises DataError when there is none or it is not understood."""
    path = Path(folder) / MANIFEST
    if not os.path.isfile(path):
        step = "Give the folder that `save_material` or `torchmat fit --out` wrote."
        raise DataError(message(str(path), "the manifest", "exist", "it is not there", step))
    manifest = read_json(path, "the manifest", "be a torchmat material")
    try:
        kind, number = manifest["format"], manifest["version"]
    except KeyError as error:
        step = "Restore the file from the original."
        fact = f"{type(error).__name__}: {error}"
        raise DataError(message(str(path), "the manifest", "be a torchmat material", fact, step)) from error
    if kind != FORMAT:
        raise DataError(message(str(path), "format", f"be {FORMAT!r}", f"it is {kind!r}"))
    if number not in VERSIONS:
        step = "Update torchmat, or export the material again."
        known = f"be {', '.join(map(str, VERSIONS[:-1]))} or {VERSIONS[-1]}"
        raise DataError(message(str(path), "version", known, f"it is {number!r}", step))
    return manifest


def _read_texture(
    folder: Path, entry: dict[str, Any], tiles: bool, full: tuple[int, int] | None = None
) -> torch.Tensor:
    """Return one texture [C, h, w]: in the size that was written, or in the `full` one, if there is another."""
    name = entry["file"]
    path = folder / name
    if Path(name).name != name:
        raise DataError(message(str(folder / MANIFEST), f"file {name!r}", "be a plain name", "it leads elsewhere"))
    if not os.path.isfile(path):
        raise DataError(message(str(path), "the texture", "exist", "it is not there", "Restore or export it again."))
    pixels = in_channels(path, read_image(path), entry)
    stored_as_codes, is_codes = "low" in entry, np.issubdtype(pixels.dtype, np.integer)
    if stored_as_codes and not is_codes:
        fact = f"it is {pixels.dtype.name}"
        raise DataError(message(str(path), "the texture", "hold 8- or 16-bit codes", fact, "Save it with that depth."))
    low, high = tuple(entry.get("low", ())), tuple(entry.get("high", ()))
    if entry["transfer"] not in TRANSFERS or not len(low) == len(high) == (entry["channels"] if stored_as_codes else 0):
        fact = f"it has transfer {entry['transfer']!r}, {len(low)} low and {len(high)} high"
        requirement = f"have transfer {' or '.join(TRANSFERS)} and a low and high for each of its channels"
        raise DataError(message(str(folder / MANIFEST), f"the entry of {name}", requirement, fact))
    if entry["transfer"] == "hue":
        check_hues(path, pixels)
    texture = decode(Codes(np.ascontiguousarray(pixels), low, high, entry["transfer"]))
    check_finite(str(path), "the texture", texture, "Correct those texels, or export the material again.")
    return in_size(path, texture, entry, full, tiles)


def _culprit(folder: Path, manifest: dict[str, Any], error: TorchmatError) -> str:
    """Return the texture files of the map that `error` is about, or else the manifest."""
    try:
        files = ", ".join(entry["file"] for entry in manifest["textures"] if entry["map"] == error.map)
    except (KeyError, TypeError):  # the entries themselves are what is wrong
        files = ""
    return str(folder / (files or MANIFEST))


def _stored_as(entry: dict[str, Any]) -> StoredAs:
    size, span = entry["size"], entry.get("span")
    return StoredAs(None if size is None else tuple(size), entry["storage"], None if span is None else tuple(span))


def _read_maps(folder: Path, manifest: dict[str, Any], stored: dict[str, StoredAs]) -> dict[str, torch.Tensor]:
    """Return the maps that have textures, in full size; of one that was painted larger `stored` keeps the depth."""
    size = (manifest["height"], manifest["width"])
    parts: dict[str, list[torch.Tensor]] = {}
    small = {}
    for entry in manifest["textures"]:
        name = entry["map"]
        shrunk = name in stored and stored[name].size is not None
        if shrunk and stored[name].size != (entry["height"], entry["width"]):
            fact = f"its texture is {entry['height']} x {entry['width']}"
            raise DataError(message(str(folder / MANIFEST), f"stored {name}", f"be of size {stored[name].size}", fact))
        if entry["per_texel"] and not shrunk and (entry["height"], entry["width"]) != size:
            fact, requirement = f"it is {entry['height']} x {entry['width']}", f"be {size[0]} x {size[1]} as the material is"
            raise DataError(message(str(folder / MANIFEST), f"the entry of {entry['file']}", requirement, fact))
        if shrunk:
            small[name] = MapSpec(name, entry["meaning"], index=entry["filter"] == "nearest")
        parts.setdefault(name, []).append(_read_texture(folder, entry, manifest["tiles"], size if shrunk else None))
    for name in small:
        if any(tuple(texture.shape[-2:]) != stored[name].size for texture in parts[name]):
            stored[name] = dataclasses.replace(stored[name], size=None)
    return {
        name: restored(small[name], pieces, size, manifest["tiles"]) if name in small else torch.cat(pieces)
        for name, pieces in parts.items()
    }


def _read_numbers(manifest: dict[str, Any], stored: dict[str, StoredAs]) -> dict[str, torch.Tensor]:
    """Return the maps that stand in the manifest: constants, and one number a channel for every texel."""
    size, maps = (manifest["height"], manifest["width"]), {}
    for name, values in manifest["constants"].items():
        value = torch.tensor(values, dtype=torch.float32)
        numbers = name in stored and stored[name].numbers
        maps[name] = value[:, None, None].expand(-1, *size).contiguous() if numbers else value
    return maps


def reread(folder: Path, manifest: dict[str, Any], material: Material, name: str) -> Material:
    """Return a material of a folder with one of its maps read again, and nothing else: the manifest is that of `material`.

    Raises DataError, naming the file, when it cannot be used.
    """
    entries = [entry for entry in manifest["textures"] if entry["map"] == name]
    stored = {key: _stored_as(entry) for key, entry in manifest.get("stored", {}).items() if key == name}
    try:
        maps = _read_maps(folder, {**manifest, "textures": entries}, stored)
        if stored and material.stored.get(name) != stored[name]:  # it was painted in full size, and is stored so from now on
            material = material.stored_at(stored)
        return material.with_maps(**{key: value.to(material.dtype) for key, value in maps.items()})
    except DataError:
        raise
    except TorchmatError as error:
        raise DataError(f"{_culprit(folder, manifest, error)}: {error}") from error


def load_material(path: str | Path) -> Material:
    """Return the material of a folder or file, exactly as its textures hold it.

    Textures may have been painted over, in 8 or 16 bits; one that is stored small may be painted in its small size or
    in that of the material, which it is stored in from then on. Grey paintings of colour textures, colour paintings of grey
    ones and paintings of another size are converted, each with a warning (`torchmat.errors.Notice`). Numbers may be edited
    in the manifest.

    Args:
        path: a material folder; a ``.3pm`` file, whose BRDF is Lambert's (`volume.read_volume`); a ``.glb`` (`gltf.material_of`); or
            coefficients of RTI programs: a ``.ptm`` or ``.rti`` file, or a folder of relight's with its ``info.json``.

    Raises DataError, naming the file, when a texture is missing, cannot be converted or leaves its range, or when the
    manifest's version is unknown.
    """
    read = reader_of(path)
    if read is not None:
        return read(path)
    if is_glb(path):
        return material_of(path)
    folder = Path(path)
    manifest = read_manifest(folder)
    where = folder / MANIFEST
    try:
        check_option(str(where), "model", manifest["model"], MATERIALS)
        stored = {name: _stored_as(entry) for name, entry in manifest.get("stored", {}).items()}
        maps = _read_maps(folder, manifest, stored) | _read_numbers(manifest, stored)
        options = dict(manifest["options"])
        settings = {"storage": manifest["storage"], "tiles": manifest["tiles"], "stored": stored}
        settings["relief"] = manifest.get("relief", FAST)  # folders from before it could be chosen
        if "cutout" in manifest:
            settings["cutout"] = Cutout.of_table(manifest["cutout"])
        return MATERIALS[manifest["model"]](maps, **settings, **options)
    except DataError:
        raise
    except TorchmatError as error:
        raise DataError(f"{_culprit(folder, manifest, error)}: {error}") from error
    except (LookupError, TypeError, ValueError, RuntimeError, AttributeError, OverflowError) as error:
        step = "Restore the file from the original."
        fact = f"{type(error).__name__}: {error}"
        raise DataError(message(str(where), "the manifest", "describe a material", fact, step)) from error
