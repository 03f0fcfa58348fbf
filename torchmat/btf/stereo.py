"""Captures for photometric stereo: ``light_directions.txt`` beside photographs, with ``light_intensities.txt`` and
``filenames.txt`` where there are (the form of DiLiGenT; Shi et al. 2019)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import PurePosixPath

from torchmat.btf.light_table import parse_intensities
from torchmat.btf.listing import Listing, is_image, read_text, the_one
from torchmat.btf.lit import paired, parse_table
from torchmat.btf.pixels import images_of_files
from torchmat.btf.reader import Reader
from torchmat.btf.source import Folder, Zip
from torchmat.errors import DataError, message

DIRECTIONS, INTENSITIES = "light_directions.txt", "light_intensities.txt"


def _is_table(name: str) -> bool:
    return PurePosixPath(name).name.lower() == DIRECTIONS


def read_stereo(source: Folder | Zip) -> Listing:
    """Pair the photographs beside ``light_directions.txt`` with its lights, and divide by the intensities, where given."""
    name = the_one(source, _is_table, DIRECTIONS)
    folder = str(PurePosixPath(name).parent)
    if not any(is_image(other) and str(PurePosixPath(other).parent) == folder for other in source.names):
        fact = "there are none beside it"
        step = f"Give the photographs' own folder, and the table: --lights {DIRECTIONS} (light_table=...)."
        raise DataError(message(f"{source.path}: {name}", "the table", "lie beside its photographs", fact, step))
    table = parse_table(source, f"{source.path}: {name}", read_text(source, name), name, folder)
    listing = replace(paired(source, table, name, folder), kind="stereo")
    beside = [other for other in source.names if str(PurePosixPath(other).parent) == folder]
    for other in beside:
        if PurePosixPath(other).name.lower() == INTENSITIES:
            where = f"{source.path}: {other}"
            intensity = parse_intensities(where, read_text(source, other), len(listing.files)).expand(-1, 3)
            return replace(listing, intensity=intensity, notes=(*listing.notes, f"intensities are those of {other}"))
    return listing


STEREO = Reader(
    "stereo", "photometric stereo: `light_directions.txt` beside photographs, with `filenames.txt` and `light_intensities.txt`",
    lambda source: any(map(_is_table, source.names)), read_stereo, images_of_files,
)
