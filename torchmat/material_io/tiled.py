"""Material folders whose textures are tiled and in levels, as renderers and viewers read them in pieces (OpenImageIO's maketx)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from torchmat.errors import RangeError, check_option, message
from torchmat.images import write_tiled
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.folder import MANIFEST, known_files, manifest_of, texture_entry, write_record
from torchmat.models import Material
from torchmat.models.storage import STORAGES

FORMATS = ("auto", "exr", "tiff")
_FLOATS, _CODES = ("half", "float"), ("tiff8", "tiff16")


def _storage(material: Material, image: str) -> str:
    """Return how a format stores the textures of a material: as they are where it can."""
    own = material.storage
    deep = STORAGES[own].bytes > 1
    if image == "exr" or (image == "auto" and own in _FLOATS):
        return own if own in _FLOATS else "half"
    return own if own in _CODES else _CODES[deep]


def write_tiled_folder(
    material: Material, path: Path, *, image: str = "auto", tile: int = 64, provenance: dict[str, Any] | None = None
) -> Losses:
    """Write a material folder of tiled textures with all their levels, means of 2 x 2 texels; it is loaded as any other.

    `image`: "exr" holds values, "tiff" codes of 8 or 16 bits, "auto" what comes nearest to how the material is stored. `tile` is a
    tile's side in texels, a multiple of 16.
    """
    check_option("export to tiled", "image", image, FORMATS)
    if not isinstance(tile, int) or isinstance(tile, bool) or tile < 16 or tile % 16:
        raise RangeError(message("export to tiled", "tile", "be a multiple of 16", f"it is {tile!r}", "64 is usual."))
    chosen = material.stored_as(_storage(material, image))
    textures = []
    for texture in chosen.textures():
        codes = texture.codes()
        write_tiled(path / texture.file, np.ascontiguousarray(codes.pixels), tile)
        textures.append(texture_entry(texture.spec, texture.file, codes))
    write_record(path / MANIFEST, manifest_of(chosen, textures, provenance), [entry["file"] for entry in textures])
    return Losses.of_maps(material, chosen.as_exported().maps)


TILED = Exporter(
    "tiled", "a material folder whose textures are tiled and in levels, EXR or TIFF, as renderers read them in pieces", write_tiled_folder,
    known=known_files, record=MANIFEST,
)
