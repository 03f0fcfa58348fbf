"""RTI captures: an ``.lp`` file lists photographs with the directions of their lights, or a ``.dome`` has the lights of all in their order."""

from __future__ import annotations

from torchmat.btf.listing import Listing, read_text, the_one
from torchmat.btf.lit import KIND, paired, parse_table
from torchmat.btf.pixels import images_of_files
from torchmat.btf.reader import Reader
from torchmat.btf.source import Folder, Zip


def _is_lp(name: str) -> bool:
    return name.lower().endswith(".lp")


def _is_dome(name: str) -> bool:
    return name.lower().endswith(".dome")


def read_lp(source: Folder | Zip) -> Listing:
    """Parse the one ``.lp`` file of a source, in any form that `parse_lights` takes, or else its one ``.dome``; the camera looks along the normal."""
    name = the_one(source, _is_lp, "an .lp file") if any(map(_is_lp, source.names)) else the_one(source, _is_dome, "an .lp or .dome file")
    table = parse_table(source, f"{source.path}: {name}", read_text(source, name), name)
    return paired(source, table, name)


RTI = Reader(
    KIND, "RTI: an `.lp` or `.dome` file with a light for each photograph",
    lambda source: any(_is_lp(name) or _is_dome(name) for name in source.names), read_lp, images_of_files, version=0,
)
