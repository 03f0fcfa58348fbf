"""A folder for OpenLIME: relight's planes, and a page of torchmat's own that shows them without it.

OpenLIME comes from its own site and is not bundled; the page evaluates the planes itself, in WebGL. It holds them too, for a browser
lets no page read the files beside it.
"""

from __future__ import annotations

from pathlib import Path

from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.rti.filled import PAGE, filled, uri_of
from torchmat.material_io.rti.info import INFO
from torchmat.material_io.rti.losses import losses_of
from torchmat.material_io.rti.relight_folder import read_relight, write_planes
from torchmat.models import Material


def write_page(
    material: Material, path: Path, *, image: str = "jpg", quality: int = 98, model: str = "auto"
) -> Losses:
    """Write relight's folder as `write_relight` does, and a page ``index.html`` that shows it: the light follows the pointer."""
    written, files = write_planes(material, path, image, quality, model)
    marks = {"/*INFO*/{}": (path / INFO).read_text(encoding="utf-8").strip(), "/*PLANES*/[]": f"[{','.join(map(uri_of, files))}]"}
    (path / PAGE).write_text(filled("page.html", marks), encoding="utf-8")
    return losses_of(material, written, read_relight(path), "8 bits" if image == "png" else f"8 bits, JPEG of quality {quality}")


OPENLIME = Exporter(
    "openlime", "relight's planes for OpenLIME, and a page of torchmat's own that shows them in any browser", write_page,
)
