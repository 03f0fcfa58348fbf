"""The standard errors of maps on a page: one small picture a map, in colours from 0 to what nearly all texels stay below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchmat.models import Material
from torchmat.models.uncertainty import Uncertainty
from torchmat.report.inline import data_uri
from torchmat.report.map_cards import MapCard
from torchmat.report.page import Markup, Picture, paragraph
from torchmat.report.pictures import colour_strip, thinned
from torchmat.report.tables import number
from torchmat.report.words import spaced, unit_of

_COLOURS = "magma"
_SIDE = 128  # pixels along a side of a picture
_NEARLY_ALL, _MANY = 0.99, 1_000_000


def error_cards(material: Material, found: Uncertainty, folder: Path) -> list[MapCard]:
    """Return a card for the standard error of each map: the root mean square of its channels."""
    meanings = {spec.name: spec.meaning for spec in material.specs()}
    cards = []
    for name, error in found.error.items():
        one = error.float().square().mean(dim=0, keepdim=True).sqrt()
        some = one.flatten()[:: 1 + one.numel() // _MANY]
        most = float(some.quantile(_NEARLY_ALL))
        pixels = thinned(one, _SIDE)
        unit = f" {unit_of(name)}" if unit_of(name) else ""
        extent = f"0 to {number(most)}{unit}, usually {number(float(some.median()))}"
        picture, size = data_uri(pixels, _COLOURS, 0.0, max(most, 1e-30)), (int(pixels.shape[1]), int(pixels.shape[2]))
        files = tuple(sorted(f"uncertainty/{path.name}" for path in (folder / "uncertainty").glob(f"{name}*.exr")))
        cards.append(MapCard(f"{spaced(name)}, standard error", f"standard error of: {meanings[name]}", extent, picture, size, files))
    return cards


def certain_parts(errors: Sequence[MapCard], report: Mapping[str, Any], cards: Sequence[Markup]) -> list[Markup]:
    """Return what a page says of standard errors: what they rest on, the scale of the colours, and the `cards` of `errors`."""
    if not errors:
        return []
    found = report["uncertainty"]
    strip = Picture(data_uri((colour_strip() + 1) / 2, _COLOURS, 0.0, 1.0)).tag("colour bar of standard errors, from 0 up")
    bar = Markup(f'<div class="bar"><span>0</span>{strip}<span>the end that a card names</span></div>')
    sigma = ", ".join(number(one) for one in found["sigma"])
    said = (
        f"One standard deviation of what other photographs with the same noise would give, from {found['samples']} of {found['of']} "
        f"photographs; residuals have {sigma} in red, green and blue ({found['space']}). What all texels share counts as known, and so "
        "does the model: what no texel's numbers could follow is noise here."
    )
    return [paragraph(said, "soft"), bar, *cards]
