"""A page that shows the material, moving, in any browser: one file without a network."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchmat.errors import RangeError, message
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.models import Material

_SHAPES = ("quad", "cube", "sphere", "torus", "teapot")


def write_html(
    material: Material, path: Path, *, mesh: Any = "teapot", title: str = "", report: Any = None, texels: int = 512,
    provenance: Mapping[str, Any] | None = None,
) -> Losses:
    """Write the page `path`: the material's own shader on an object, with its maps; return what a reader of it does not get.

    Args:
        mesh: what is shown first: "quad", "cube", "sphere", "torus", "teapot", or a mesh (`torchmat.rendering.load_mesh`).
        title: of the page; "" is the name of the model.
        report: what `report.json` says, whose held-out errors the page shows; None shows none.
        texels: along a side, at least 1: larger materials are made smaller.
    """
    from torchmat.web.errors import error_table
    from torchmat.web.page import whole_page
    from torchmat.web.shown import show

    if not isinstance(texels, int) or isinstance(texels, bool) or texels < 1:
        raise RangeError(message("export to html", "texels", "be a whole number of at least 1", f"it is {texels!r}", "512 is usual."))
    if isinstance(mesh, str) and mesh not in _SHAPES:
        step = "Give a mesh file with --mesh, or torchmat.rendering.load_mesh(path)."
        raise RangeError(message("export to html", "mesh", f"be one of {', '.join(_SHAPES)}, or a mesh", f"it is {mesh!r}", step))
    shown = show(material, mesh, error_table(report), texels)
    name = title or material.name.replace("_", " ").capitalize()
    path.write_text(whole_page(name, _said(shown.material, provenance or {}), shown.element), encoding="utf-8")
    return _losses(material, shown.material, shown.drawn)


def _said(material: Material, provenance: Mapping[str, Any]) -> str:
    height, width = material.size
    source = provenance.get("source")
    fitted = f", fitted to {source['samples']} photographs" if isinstance(source, Mapping) and isinstance(source.get("samples"), int) else ""
    return f"{material.name}, {height} x {width} texels{', on a relief' if material.has_relief else ''}{fitted}"


def _losses(material: Material, shown: Material, drawn: bool) -> Losses:
    if not drawn:
        return Losses(lost={spec.name: "this model has no shader: the page holds pictures" for spec in material.specs()})
    # The page holds the codes of the material's own storage.
    return Losses.of_maps(material, shown.as_exported().maps)


HTML = Exporter(
    "html", "one page that shows the material on objects, under lights that one moves, with its own shader; opens from disk",
    write_html, ".html",
)
