"""A page that pans and zooms relight's tiles and moves the light, of torchmat's own: it needs neither OpenLIME nor a network.

Served, it loads the tiles themselves. A page from disk may not look into pictures beside it, but may run scripts: so each place of
each level has one, which holds its tiles of all planes.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from torchmat.material_io.rti.deep_zoom import OVERLAP, SUFFIX, TILE
from torchmat.material_io.rti.filled import PAGE, filled, uri_of
from torchmat.material_io.rti.info import INFO

SCRIPTS = "page_tiles"


def write_zoom_page(folder: Path, image: str, files: Sequence[Path]) -> Path:
    """Write ``index.html`` and its scripts beside an ``info.json`` and the Deep Zoom images of its planes; return the page.

    `files` are the planes' ``.dzi`` in their order, `image` the suffix of their tiles.
    """
    places: dict[str, list[Path]] = defaultdict(list)
    for file in files:
        for tile in sorted(file.with_name(f"{file.stem}_files").glob(f"*/*.{image}")):
            places[f"{tile.parent.name}/{tile.stem}"].append(tile)
    for place, tiles in places.items():
        script = folder / SCRIPTS / f"{place}.js"
        script.parent.mkdir(parents=True, exist_ok=True)
        script.write_text(f"came({json.dumps(place)}, [{', '.join(map(uri_of, tiles))}]);\n", encoding="utf-8")
    levels = 1 + max(int(place.partition("/")[0]) for place in places)
    planes = [file.name.removesuffix(SUFFIX) for file in files]
    about = {"tile": TILE, "overlap": OVERLAP, "levels": levels, "scripts": SCRIPTS, "planes": planes}
    marks = {"/*INFO*/{}": (folder / INFO).read_text(encoding="utf-8").strip(), "/*TILES*/{}": json.dumps(about)}
    (folder / PAGE).write_text(filled("zoom_page.html", marks), encoding="utf-8")
    return folder / PAGE
