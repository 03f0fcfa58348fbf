"""A material made ready for a page: small enough, described, with pictures for browsers that cannot draw it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torchmat.models import Material
from torchmat.models.edit import resized
from torchmat.rendering.shapes import SHAPES
from torchmat.web.mesh_data import packed_mesh
from torchmat.web.page import SMALL, Still, viewer_element
from torchmat.web.payload import describe, has_shader
from torchmat.web.stills import gallery, object_stills

MOST_TEXELS = 512  # along a side of what a page holds


@dataclass(frozen=True)
class Shown:
    """What a page holds of a material: `material` as it is drawn, the element that shows it, and its bytes by part."""

    material: Material
    element: str
    drawn: bool
    notes: tuple[str, ...]
    bytes: Mapping[str, int] = field(default_factory=dict)


def show(
    material: Material, mesh: Any = "teapot", errors: Mapping[str, Any] | None = None, most: int = MOST_TEXELS, stills: bool = True,
    options: Mapping[str, Any] | None = None, level: int = SMALL, thumbnails: Sequence[Mapping[str, str]] = (),
) -> Shown:
    """Return the viewer of a material, as an element for any page.

    Args:
        mesh: the object shown first, one of SHAPES, or a mesh, which the page then holds beside them.
        errors: what the page says of the material's errors (`error_table`); None says nothing.
        most: texels along a side; a larger material is made smaller, and the page says so.
        stills: whether to make pictures for browsers without WebGL 2; a material without a shader always has them.
        options: of `mount` in `js/viewer.js`.
        level: of gzip, `page.SMALL` or `page.QUICK`.
        thumbnails: small pictures that stand behind the maps, such as those of their standard errors: "name", "said", "extent"
            and the "uri" of a picture.

    Raises RangeError for what is no mesh.
    """
    material, notes = _small_enough(material, most)
    extra: dict[str, Any] = {"notes": notes, "shape": mesh if isinstance(mesh, str) else None}
    if thumbnails:
        extra["thumbnails"] = [dict(one) for one in thumbnails]
    if errors:
        extra["errors"] = dict(errors)
    if not has_shader(material):
        description: dict[str, Any] = {"model": material.name, "size": list(material.size), "glsl": None, "maps": []}
        element = viewer_element(description, {}, extra, gallery(material), options)
        return Shown(material, element, False, tuple(notes), {"maps": 0})
    found = describe(material)
    buffers = dict(found.buffers)
    if not (isinstance(mesh, str) and mesh in SHAPES):
        extra["mesh"], held = packed_mesh(mesh)
        extra["shape"] = None
        buffers |= held
    pictures: list[Still] = object_stills(material, mesh) if stills else []
    element = viewer_element(found.description, buffers, extra, pictures, options, level)
    return Shown(material, element, True, tuple(notes), {name: len(one) for name, one in buffers.items()})


def _small_enough(material: Material, most: int) -> tuple[Material, list[str]]:
    height, width = material.size
    factor = most / max(height, width)
    if factor >= 1:
        return material, []
    size = (max(1, math.floor(height * factor)), max(1, math.floor(width * factor)))
    return resized(material, size), [f"The maps are shown in {size[0]} x {size[1]} texels; the material has {height} x {width}."]
