"""The page of a viewer: one file that holds the material, its maps, style and script, and fetches nothing."""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any, NamedTuple

from torchmat.web.bundle import bundle

ROOT = "torchmat-viewer"
DATA = "torchmat-material"
SMALL, QUICK = 6, 1  # gzip's levels: the quick one takes half the time, and 2 to 7 % more bytes


class Still(NamedTuple):
    """A picture for browsers that cannot draw the material: a data URI, its height and width, and what it shows."""

    uri: str
    size: tuple[int, int]
    said: str


def embedded(description: Mapping[str, Any], buffers: Mapping[str, bytes], extra: Mapping[str, Any], level: int = SMALL) -> str:
    """Return the element that holds a material, as `js/embedded.js` reads it, packed at one of gzip's levels."""
    data = base64.b64encode(gzip.compress(b"".join(buffers.values()), level, mtime=0)).decode("ascii")
    parts = [[name, len(one)] for name, one in buffers.items()]
    held = {"description": dict(description), "extra": dict(extra), "parts": parts, "data": data}
    # "<" as its number: no text of a user can end the element.
    return f'<script type="application/json" id="{DATA}">{json.dumps(held, allow_nan=False).replace("<", chr(92) + "u003c")}</script>'


def stills_element(stills: Sequence[Still]) -> str:
    """Return pictures that stand in for the viewer until it runs, and where it cannot."""
    shown = "".join(
        f'<figure><img alt="{html.escape(one.said)}" width="{one.size[1]}" height="{one.size[0]}" src="{one.uri}">'
        f"<figcaption>{html.escape(one.said)}</figcaption></figure>" for one in stills
    )
    return f'<div class="tmv-stills">{shown}</div>'


def viewer_element(
    description: Mapping[str, Any], buffers: Mapping[str, bytes], extra: Mapping[str, Any], stills: Sequence[Still] = (),
    options: Mapping[str, Any] | None = None, level: int = SMALL,
) -> str:
    """Return all that a page needs to show a material: style, root, data and script.

    Args:
        description: of the material (`payload.describe`).
        buffers: the codes of its maps by name, and of a mesh (`mesh_data.packed_mesh`).
        extra: what stands beside it: "mesh", "errors", "notes", "shape".
        stills: pictures for browsers that cannot draw it.
        options: of `mount` in `js/viewer.js`.
        level: of gzip, SMALL or QUICK.
    """
    style = resources.files("torchmat.web").joinpath("style.css").read_text(encoding="utf-8")
    start = f'$viewer.mount(document.getElementById("{ROOT}"), {json.dumps({"intro": True, **(options or {})})});'
    without = "<noscript><p>Without JavaScript the material does not move.</p></noscript>"
    return (
        f'<style>{style}</style><div class="tmv" id="{ROOT}">{without}{stills_element(stills)}</div>'
        f'{embedded(description, buffers, extra, level)}<script type="module">\n{bundle("viewer")}\n{start}\n</script>'
    )


def whole_page(title: str, said: str, viewer: str) -> str:
    """Return a page of its own of what `viewer_element` returned, under a title and a line of what it shows."""
    page = resources.files("torchmat.web").joinpath("page.html").read_text(encoding="utf-8")
    for mark, content in (("<!--TITLE-->", html.escape(title)), ("<!--SAID-->", html.escape(said)), ("<!--VIEWER-->", viewer)):
        page = page.replace(mark, content)
    return page
