"""A folder for OpenLIME: relight's planes, and a page of torchmat's own that shows them without it.

OpenLIME comes from its own site and is not bundled; the page evaluates the planes itself, in WebGL. It holds them too, for a browser
lets no page read the files beside it.
"""

from __future__ import annotations

import base64
from importlib import resources
from pathlib import Path

from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.rti.losses import losses_of
from torchmat.material_io.rti.relight_folder import INFO, read_relight, write_planes
from torchmat.models import Material

PAGE = "index.html"
_TYPES = {".jpg": "image/jpeg", ".png": "image/png"}


def _uri(path: Path) -> str:
    return f'"data:{_TYPES[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode("ascii")}"'


def write_page(
    material: Material, path: Path, *, image: str = "jpg", quality: int = 98, model: str = "auto"
) -> Losses:
    """Write relight's folder as `write_relight` does, and a page ``index.html`` that shows it: the light follows the pointer."""
    written, files = write_planes(material, path, image, quality, model)
    page = resources.files("torchmat.material_io.rti").joinpath("page.html").read_text(encoding="utf-8")
    info = (path / INFO).read_text(encoding="utf-8").strip()
    for mark, content in (("/*INFO*/{}", info), ("/*PLANES*/[]", f"[{','.join(map(_uri, files))}]")):
        page = page.replace(mark, content)
    (path / PAGE).write_text(page, encoding="utf-8")
    return losses_of(material, written, read_relight(path), "8 bits" if image == "png" else f"8 bits, JPEG of quality {quality}")


OPENLIME = Exporter(
    "openlime", "relight's planes for OpenLIME, and a page of torchmat's own that shows them in any browser", write_page,
)
