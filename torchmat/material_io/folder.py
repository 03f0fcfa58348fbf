"""The material folder: `manifest.json` and one texture per map. The product, specified like a file format.

The manifest states the format's version, the model and its options, the frame and value conventions, the resolved
config and provenance, the constants, and for each texture its file, map, channels, code type and transfer. Integer
codes run linearly from `low` to `high` per channel, or sRGB-encoded between them where `transfer` says so. A folder of
version 2 has maps that are stored smaller than the material, as `stored` lists them: bilinear filtering brings them to
its size, and those of 1 x 1 texel stand among the constants. One of version 3 is stored to be painted: codes span the
natural range of a map, and a rotation is a hue. The manifest keeps a digest of every file that was written with it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from torchmat import atomic
from torchmat.errors import DataError, message
from torchmat.images import write_image
from torchmat.machine import package_version
from torchmat.material_io.exporter import LOSS, Exporter, Losses, exporter_of_file
from torchmat.material_io.uncertainty_textures import KEY as UNCERTAINTY
from torchmat.material_io.uncertainty_textures import write_uncertainty
from torchmat.models import Material
from torchmat.models.relief_maps import FAST
from torchmat.models.storage import STORAGES, Codes, MapSpec, StoredTexture, check_map
from torchmat.models.uncertainty import Uncertainty
from torchmat.progress import phase
from torchmat.text_file import read_json
from torchmat.written import files_below, write_record

FORMAT = "torchmat-material"
# A folder with maps that are stored small, or that are part of a texture, is of the second, one that is stored to be
# painted of the third: earlier readers refuse them.
VERSION, SHRUNK_VERSION, PAINT_VERSION = VERSIONS = 1, 2, 3
MANIFEST = "manifest.json"
RENDERS = "pictures/render_*"  # what `torchmat render` adds to a material folder: it stays when the material is replaced
CONVENTIONS = {
    "frame": "x right, y up (row 0 is the top row), z mean normal; right-handed; light and view away from the surface",
    "value": "pi * f_r * cos(light), linear RGB, Rec. 709 primaries; 0 for light or view at or below z = 0",
    "codes": "integer codes run from low (0) to high (largest code) per channel, linearly or sRGB-encoded",
}


def texture_entry(spec: MapSpec, file: str, codes: Codes) -> dict[str, Any]:
    """Return what a manifest says of a texture that is written as `codes`."""
    height, width, channels = codes.pixels.shape
    entry: dict[str, Any] = {
        "map": spec.name, "meaning": spec.meaning, "file": file, "height": height, "width": width,
        "channels": channels, "type": codes.pixels.dtype.name, "transfer": codes.transfer,
        "per_texel": spec.per_texel, "filter": "nearest" if spec.index else "bilinear",
    }
    if codes.low:
        entry |= {"low": list(codes.low), "high": list(codes.high)}
    return entry


def write_texture(folder: Path, texture: StoredTexture) -> dict[str, Any]:
    """Write one texture into a folder; return its entry in the manifest."""
    codes = texture.codes()
    write_image(folder / texture.file, codes.pixels)
    return texture_entry(texture.spec, texture.file, codes)


def manifest_of(
    material: Material, textures: list[dict[str, Any]], provenance: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the manifest of a material with these entries of its textures, all but the digests."""
    for spec, value in material.numbers():
        check_map("export", spec, value)
    constants = {spec.name: value.tolist() for spec, value in material.numbers()}
    height, width = material.size
    manifest = {
        "format": FORMAT, "version": _version(material), "written_by": f"torchmat {package_version()}",
        "model": material.name, "options": material.options, "storage": material.storage, "tiles": material.tiles,
        "height": height, "width": width, "bytes_per_texel": material.bytes_per_texel,
        "shared_bytes": material.shared_bytes, "conventions": CONVENTIONS, "constants": constants,
        "textures": textures, "provenance": dict(provenance or {}),
    }
    if material.cutout is not None:
        manifest["cutout"] = material.cutout.as_table()
    if material.has_relief and material.relief != FAST:
        manifest["relief"] = material.relief
    if material.stored:
        manifest["stored"] = {name: one.as_table() for name, one in material.stored.items()}
    return manifest


def _version(material: Material) -> int:
    storages = {material.storage, *(texture.storage for texture in material.textures())}
    if any(STORAGES[storage].natural for storage in storages):
        return PAINT_VERSION
    shrunk = material.cutout is not None or any(one.size is not None for one in material.stored.values())
    return SHRUNK_VERSION if shrunk else VERSION


def write_material(material: Material, folder: Path, provenance: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Write manifest and textures into an existing folder, whatever is there, and return the manifest.

    `save_material` is what takes care.
    """
    textures = [write_texture(folder, texture) for texture in material.textures()]
    manifest = manifest_of(material, textures, provenance)
    write_record(folder / MANIFEST, manifest, [entry["file"] for entry in textures])
    return manifest


def _known_files(target: Path) -> set[str]:
    """Return the files that a material folder says are its own; none when it is no material folder."""
    try:
        manifest = read_json(target / MANIFEST, "the manifest", "be a torchmat material")
        if manifest["format"] != FORMAT:
            return set()
        beside = manifest.get(UNCERTAINTY, {}).get("textures", ())
        return {MANIFEST, LOSS, *(entry["file"] for entry in (*manifest["textures"], *beside)), *manifest.get("companions", ())}
    except (DataError, KeyError, TypeError, AttributeError):
        return set()


def known_files(target: Path) -> Callable[[str], bool]:
    """Return which files in a folder are those of a material there, and may be replaced with it."""
    files = _known_files(target)
    return lambda name: name in files or (bool(files) and fnmatch(name, RENDERS))


def check_target(target: str | Path, force: bool = False) -> bool:
    """Raise DataError unless `target` may be replaced: absent, empty, or a material folder as torchmat wrote it.

    What differs from what torchmat wrote, or was edited since, is the user's. With `force` a material folder may be
    replaced even so: True is returned when a backup must be kept. A name that ends as an exporter's files do (.3pm) is
    refused: such a file holds no report.
    """
    exporter = exporter_of_file(target)
    if exporter is not None:
        step = f"Choose a folder; save_material(load_material(folder), 'name{exporter.suffix}') then writes the file."
        fact = f"its name ends in {exporter.suffix}"
        raise DataError(message(str(target), "the target", "be a folder", fact, step))
    return FOLDER.check_folder(Path(target), "a material folder", force)


def save_material(
    material: Material, folder: str | Path, provenance: dict[str, Any] | None = None,
    companions: Callable[[Path], None] | None = None, force: bool = False, uncertainty: Uncertainty | None = None,
) -> Path:
    """Write a material as a folder that appears whole or not at all; return its path.

    A material that stands there is replaced in one step, and its rendered pictures stay. A folder that holds anything
    else, or textures that were painted since torchmat wrote them, is refused, so that no work of the user's is lost.

    Args:
        material: what to write.
        folder: where; a path that ends in the suffix of an exporter, such as ``.3pm``, gets that file and nothing else;
            `export` says beside it what the file cannot hold.
        provenance: what the manifest says of where the material comes from, as JSON has it; None is nothing.
        companions: called with the folder before it appears, to write more into it (report, pictures).
        force: True replaces a material folder whatever was painted in it or put beside it, and keeps the old one as
            ``NAME.backup-1`` (or the next free number); of a file it does so whatever stands there.
        uncertainty: standard errors of the maps (`tm.uncertainty`), which a folder holds beside them; None is none.

    Raises DataError when the folder cannot be written, RangeError when a map cannot be stored.
    """
    target = Path(folder)
    exporter = exporter_of_file(target)
    if exporter is not None:
        if companions is not None:
            step = "Save it as a folder."
            raise DataError(message(str(target), "the target", "be a folder to hold a report", "it is a file", step))
        exporter.write_whole(material, target, {}, provenance, backup=exporter.check_file(target, force, unknown=True))
        return target
    with atomic.building(target, backup=check_target(target, force)) as building:
        with phase("writing textures"):
            manifest = write_material(material, building, provenance)
            if uncertainty is not None:
                manifest[UNCERTAINTY] = write_uncertainty(building, material, uncertainty)
        if companions is not None:
            before = set(files_below(building))
            companions(building)
            manifest["companions"] = sorted({*files_below(building)} - before)
        write_record(building / MANIFEST, manifest)
        _carry_over(target, building)
    return target


def _carry_over(target: Path, building: Path) -> None:
    """Copy the pictures that were rendered into a folder into the one that takes its place."""
    for name in files_below(target) if target.is_dir() else ():
        if fnmatch(name, RENDERS) and not (building / name).exists():
            (building / name).parent.mkdir(exist_ok=True)
            shutil.copy2(target / name, building / name)


def _export_folder(
    material: Material, path: Path, *, storage: str | None = None, provenance: dict[str, Any] | None = None
) -> Losses:
    """Write a material folder, with all textures stored as `storage` (a key of STORAGES) where it is given."""
    chosen = material if storage is None else material.stored_as(storage)
    write_material(chosen, path, provenance)
    return Losses.of_maps(material, chosen.as_exported().maps)


FOLDER = Exporter(
    "folder", "torchmat's own: a manifest and one texture a map, to edit and to load again", _export_folder,
    known=known_files, record=MANIFEST,
)


