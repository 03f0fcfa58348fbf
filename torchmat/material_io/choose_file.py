"""Another file of a material's folder in the place of a texture: only the manifest changes."""

from __future__ import annotations

import os
from pathlib import Path

from torchmat import swap
from torchmat.errors import DataError, RangeError, check_option, message
from torchmat.material_io.folder import MANIFEST
from torchmat.material_io.read_folder import load_material, read_manifest
from torchmat.written import DIGESTS, EDITED, write_table


def texture_names(manifest: dict) -> list[str]:
    """Return the names of a manifest's textures, in order: those of their maps, with a number from 1 where one has several."""
    maps = [entry["map"] for entry in manifest["textures"]]
    return [
        f"{name}_{maps[: number + 1].count(name)}" if maps.count(name) > 1 else name for number, name in enumerate(maps)
    ]


def choose_file(folder: str | Path, texture: str, file: str) -> None:
    """Let the file `file` of a material folder be its `texture` from now on; the one that was it stays where it is.

    `texture` is the name of a map, with a number from 1 where it has several textures (``specular_2``). The file is read
    by what the manifest says of the texture: codes and their range.
    Raises RangeError for a texture that there is not, or a file that is another texture, DataError when the file is none of
    the folder's or cannot be that texture; the folder is then as it was.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    names = texture_names(manifest)
    check_option("choose_file", "the texture", texture, names)
    if not file or os.path.basename(file) != file or not (folder / file).is_file():
        step = "Copy it there."
        raise DataError(message(str(folder / file), "the file", "be one of the folder's", "it is not", step))
    entry = manifest["textures"][names.index(texture)]
    others = [one["file"] for one in manifest["textures"] if one is not entry]
    if file in others:
        fact = f"it is {names[[one['file'] for one in manifest['textures']].index(file)]}"
        raise RangeError(message(str(folder / file), "the file", "be one texture", fact, "Copy it under another name."))
    if entry["file"] == file:
        return
    entry["file"] = file
    manifest[EDITED] = sorted({*manifest.get(EDITED, ()), file, MANIFEST})
    with swap.swapping(folder, [MANIFEST]) as building:
        write_table(building / MANIFEST, manifest, manifest.get(DIGESTS, {}))
        load_material(building)  # what cannot be read is not chosen
