"""The material folder: `manifest.json` and one texture per map. The product, specified like a file format.

The manifest states the format's version, the model and its options, the frame and value conventions, the resolved
config and provenance, the constants, and for each texture its file, map, channels, code type and transfer. Integer
codes run linearly from `low` to `high` per channel, or sRGB-encoded between them where `transfer` says so. A folder of
version 2 has maps that are stored smaller than the material, as `stored` lists them: bilinear filtering brings them to
its size, and those of 1 x 1 texel stand among the constants.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchmat import atomic
from torchmat.errors import DataError, TorchmatError, check_finite, check_option, message
from torchmat.images import read_image, write_image
from torchmat.machine import package_version
from torchmat.material_io.exporter import LOSS, Exporter, Losses, exporter_of_file
from torchmat.material_io.volume import is_volume, read_volume
from torchmat.models import MATERIALS, Material
from torchmat.models.cutout import Cutout
from torchmat.models.resample import restored
from torchmat.models.storage import STORAGES, Codes, MapSpec, StoredAs, check_map, decode
from torchmat.text_file import read_json

FORMAT = "torchmat-material"
# A folder with maps that are stored small, or that are part of a texture, is of the second, which early readers refuse.
VERSION, SHRUNK_VERSION = 1, 2
MANIFEST = "manifest.json"
TRANSFERS = ("linear", "srgb")
RENDERS = "pictures/render_*"  # what `torchmat render` adds to a material folder; a fit may replace it
CONVENTIONS = {
    "frame": "x right, y up (row 0 is the top row), z mean normal; right-handed; light and view away from the surface",
    "value": "pi * f_r * cos(light), linear RGB, Rec. 709 primaries; 0 for light or view at or below z = 0",
    "codes": "integer codes run from low (0) to high (largest code) per channel, linearly or sRGB-encoded",
}


def _texture_entry(spec: MapSpec, file: str, codes: Codes) -> dict[str, Any]:
    height, width, channels = codes.pixels.shape
    entry: dict[str, Any] = {
        "map": spec.name, "meaning": spec.meaning, "file": file, "height": height, "width": width,
        "channels": channels, "type": codes.pixels.dtype.name, "transfer": codes.transfer,
        "per_texel": spec.per_texel, "filter": "nearest" if spec.index else "bilinear",
    }
    if codes.low:
        entry |= {"low": list(codes.low), "high": list(codes.high)}
    return entry


def _files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def _write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1, ensure_ascii=False), encoding="utf-8")


def write_material(material: Material, folder: Path, provenance: dict[str, Any] | None = None) -> dict[str, Any]:
    """Write manifest and textures into an existing folder, whatever is there, and return the manifest.

    `save_material` is what takes care.
    """
    textures = []
    for texture in material.textures():
        codes = texture.codes()
        suffix = ".png" if texture.spec.index else STORAGES[texture.storage].suffix
        write_image(folder / f"{texture.name}{suffix}", codes.pixels)
        textures.append(_texture_entry(texture.spec, f"{texture.name}{suffix}", codes))
    for spec, value in material.numbers():
        check_map("export", spec, value)
    constants = {spec.name: value.tolist() for spec, value in material.numbers()}
    height, width = material.size
    shrunk = material.cutout is not None or any(one.size is not None for one in material.stored.values())
    manifest = {
        "format": FORMAT, "version": SHRUNK_VERSION if shrunk else VERSION, "written_by": f"torchmat {package_version()}",
        "model": material.name, "options": material.options, "storage": material.storage, "tiles": material.tiles,
        "height": height, "width": width, "bytes_per_texel": material.bytes_per_texel,
        "shared_bytes": material.shared_bytes, "conventions": CONVENTIONS, "constants": constants,
        "textures": textures, "provenance": provenance or {},
    }
    if material.cutout is not None:
        manifest["cutout"] = material.cutout.as_table()
    if material.stored:
        manifest["stored"] = {name: dataclasses.asdict(one) for name, one in material.stored.items()}
    _write_manifest(folder, manifest)
    return manifest


def _known_files(target: Path) -> set[str]:
    """Return the files that a material folder says are its own; none when it is no material folder."""
    try:
        manifest = read_json(target / MANIFEST, "the manifest", "be a torchmat material")
        if manifest["format"] != FORMAT:
            return set()
        return {MANIFEST, LOSS, *(entry["file"] for entry in manifest["textures"]), *manifest.get("companions", ())}
    except (DataError, KeyError, TypeError, AttributeError):
        return set()


def known_files(target: Path) -> Callable[[str], bool]:
    """Return which files in a folder are those of a material there, and may be replaced with it."""
    files = _known_files(target)
    return lambda name: name in files or (bool(files) and fnmatch(name, RENDERS))


def check_target(target: str | Path) -> None:
    """Raise DataError unless `target` may be replaced: absent, empty, or a material folder and nothing else.

    A name that ends as an exporter's files do (.3pm) is refused: such a file holds no report.
    """
    exporter = exporter_of_file(target)
    if exporter is not None:
        step = f"Choose a folder; save_material(load_material(folder), 'name{exporter.suffix}') then writes the file."
        fact = f"its name ends in {exporter.suffix}"
        raise DataError(message(str(target), "the target", "be a folder", fact, step))
    atomic.refuse_foreign(Path(target), known_files(Path(target)), "a material folder")


def save_material(
    material: Material, folder: str | Path, provenance: dict[str, Any] | None = None,
    companions: Callable[[Path], None] | None = None,
) -> Path:
    """Write a material as a folder that appears whole or not at all; return its path.

    A material that stands there is replaced in one step; a folder that holds anything else is refused, so that no file of
    the user's is lost.

    Args:
        material: what to write.
        folder: where; a path that ends in the suffix of an exporter, such as ``.3pm``, gets that file and nothing else;
            `export` says beside it what the file cannot hold.
        provenance: what the manifest says of where the material comes from, as JSON has it; None is nothing.
        companions: called with the folder before it appears, to write more into it (report, pictures).

    Raises DataError when the folder cannot be written, RangeError when a map cannot be stored.
    """
    target = Path(folder)
    exporter = exporter_of_file(target)
    if exporter is not None:
        if companions is not None:
            step = "Save it as a folder."
            raise DataError(message(str(target), "the target", "be a folder to hold a report", "it is a file", step))
        exporter.write_whole(material, target, {}, provenance)
        return target
    check_target(target)
    with atomic.building(target) as building:
        manifest = write_material(material, building, provenance)
        if companions is not None:
            before = _files(building)
            companions(building)
            manifest["companions"] = sorted(_files(building) - before)
            _write_manifest(building, manifest)
    return target


def _export_folder(
    material: Material, path: Path, *, storage: str | None = None, provenance: dict[str, Any] | None = None
) -> Losses:
    """Write a material folder, with all textures stored as `storage` (a key of STORAGES) where it is given."""
    chosen = material if storage is None else material.stored_as(storage)
    write_material(chosen, path, provenance)
    return Losses.of_maps(material, chosen.as_exported().maps)


FOLDER = Exporter(
    "folder", "torchmat's own: a manifest and one texture a map, to edit and to load again", _export_folder,
    known=known_files,
)


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
    if number not in (VERSION, SHRUNK_VERSION):
        step = "Update torchmat, or export the material again."
        raise DataError(message(str(path), "version", f"be {VERSION} or {SHRUNK_VERSION}", f"it is {number!r}", step))
    return manifest


def _read_texture(folder: Path, entry: dict[str, Any], full: tuple[int, int] | None = None) -> torch.Tensor:
    """Return one texture [C, h, w]: of the size that was written, or of the `full` one, if there is another."""
    name = entry["file"]
    path = folder / name
    if Path(name).name != name:
        raise DataError(message(str(folder / MANIFEST), f"file {name!r}", "be a plain name", "it leads elsewhere"))
    if not os.path.isfile(path):
        raise DataError(message(str(path), "the texture", "exist", "it is not there", "Restore or export it again."))
    pixels = read_image(path)
    wanted = (entry["height"], entry["width"], entry["channels"])
    if pixels.shape[2] == wanted[2] + 1 and wanted[2] in (1, 3):
        pixels = _without_alpha(path, pixels)
    if pixels.shape not in (wanted, (*(full or wanted[:2]), wanted[2])):
        fact = f"it is {pixels.shape[0]} x {pixels.shape[1]} with {pixels.shape[2]} channels"
        other = f", or to the full {full[0]} x {full[1]}" if full else ""
        step = f"Scale the texture back{other}, or export the material again."
        raise DataError(message(str(path), "the texture", f"be {wanted[0]} x {wanted[1]} x {wanted[2]}", fact, step))
    stored_as_codes, is_codes = "low" in entry, np.issubdtype(pixels.dtype, np.integer)
    if stored_as_codes and not is_codes:
        fact = f"it is {pixels.dtype.name}"
        raise DataError(message(str(path), "the texture", "hold 8- or 16-bit codes", fact, "Save it with that depth."))
    low, high = tuple(entry.get("low", ())), tuple(entry.get("high", ()))
    if entry["transfer"] not in TRANSFERS or not len(low) == len(high) == (wanted[2] if stored_as_codes else 0):
        fact = f"it has transfer {entry['transfer']!r}, {len(low)} low and {len(high)} high"
        requirement = f"have transfer {' or '.join(TRANSFERS)} and a low and high for each of its channels"
        raise DataError(message(str(folder / MANIFEST), f"the entry of {name}", requirement, fact))
    texture = decode(Codes(np.ascontiguousarray(pixels), low, high, entry["transfer"]))
    check_finite(str(path), "the texture", texture, "Correct those texels, or export the material again.")
    return texture


def _without_alpha(path: Path, pixels: np.ndarray) -> np.ndarray:
    """Drop the alpha that paint programs like to add; what is not opaque has lost its colour to it."""
    full = np.iinfo(pixels.dtype).max if np.issubdtype(pixels.dtype, np.integer) else 1.0
    clear = int((pixels[:, :, -1] != full).sum())
    if clear:
        fact = f"{clear} of {pixels[:, :, -1].size} texels are not"
        raise DataError(message(str(path), "alpha", "be opaque", fact, "Flatten the picture or remove its alpha."))
    return pixels[:, :, :-1]


def _culprit(folder: Path, manifest: dict[str, Any], error: TorchmatError) -> str:
    """Return the texture files of the map that `error` is about, or else the manifest."""
    try:
        files = ", ".join(entry["file"] for entry in manifest["textures"] if entry["map"] == error.map)
    except (KeyError, TypeError):  # the entries themselves are what is wrong
        files = ""
    return str(folder / (files or MANIFEST))


def _stored_as(entry: dict[str, Any]) -> StoredAs:
    return StoredAs(None if entry["size"] is None else tuple(entry["size"]), entry["storage"])


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
        if shrunk:
            small[name] = MapSpec(name, entry["meaning"], index=entry["filter"] == "nearest")
        parts.setdefault(name, []).append(_read_texture(folder, entry, size if shrunk else None))
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


def load_material(path: str | Path) -> Material:
    """Return the material of a folder or file, exactly as its textures hold it.

    Textures may have been painted over, in 8 or 16 bits; one that is stored small may be painted in its small size or
    in that of the material, which it is stored in from then on. Numbers may be edited in the manifest.

    Args:
        path: a material folder, or a ``.3pm`` file (`read_volume`).

    Raises DataError, naming the file, when a texture is missing, has another size or leaves its range, or when the
    manifest's version is unknown.
    """
    if is_volume(path):
        return read_volume(path)
    folder = Path(path)
    manifest = read_manifest(folder)
    where = folder / MANIFEST
    try:
        check_option(str(where), "model", manifest["model"], MATERIALS)
        stored = {name: _stored_as(entry) for name, entry in manifest.get("stored", {}).items()}
        maps = _read_maps(folder, manifest, stored) | _read_numbers(manifest, stored)
        options = dict(manifest["options"])
        settings = {"storage": manifest["storage"], "tiles": manifest["tiles"], "stored": stored}
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
