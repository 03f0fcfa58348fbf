"""Pages of torchmat's own beside relight's planes: what they share, and pictures that they hold."""

from __future__ import annotations

import base64
from importlib import resources
from pathlib import Path

PAGE = "index.html"
_TYPES = {".jpg": "image/jpeg", ".png": "image/png"}


def filled(name: str, marks: dict[str, str]) -> str:
    """Return a page of this folder with what all of them share, and each mark replaced by what stands for it."""
    here = resources.files("torchmat.material_io.rti")
    page = here.joinpath(name).read_text(encoding="utf-8")
    for mark, content in {"/*RELIT*/": here.joinpath("relit.js").read_text(encoding="utf-8").strip(), **marks}.items():
        page = page.replace(mark, content)
    return page


def uri_of(path: Path) -> str:
    """Return a picture's file as a URI in quotes, which holds it."""
    return f'"data:{_TYPES[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode("ascii")}"'
