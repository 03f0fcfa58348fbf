"""The maps of a material on a page: a small picture each, what it is, its range with the unit, and its files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from torchmat.fitting.evaluate import LARGE_TEXELS
from torchmat.models import Material
from torchmat.models.storage import STORAGES, MapSpec
from torchmat.report.inline import data_uri
from torchmat.report.maps import hue, logarithmic, seen
from torchmat.report.pictures import thinned
from torchmat.report.tables import number
from torchmat.report.words import parameter, spaced, texture_name, unit_of

_SIDE = 128  # pixels along a side of a picture
MOST = 64  # cards on a page; of hundreds of principal images the folder has the rest


class MapCard(NamedTuple):
    """One texture: its name in words, what it holds, "0 to 0.6 (unit)", a picture as data URI with its size, its files."""

    name: str
    meaning: str
    extent: str
    picture: str
    size: tuple[int, int]
    files: tuple[str, ...]


def map_cards(material: Material, folder: Path) -> list[MapCard]:
    """Return a card for every texture that the material has in `folder`, at most MOST."""
    cards: list[MapCard] = []
    for spec in material.specs():
        if spec.constant or spec.name not in material.maps:
            continue
        value = material.maps[spec.name].detach()
        parts = [(spec.textures, value)] if spec.name == "rotation" else [
            ((name,), part) for name, part in zip(spec.textures, value.split(spec.layer_channels), strict=True)
        ]
        for names, part in parts:
            if len(cards) == MOST:
                return cards
            cards.append(_card(spec, names, part, folder))
    return cards


def parameter_rows(material: Material) -> list[list[str]]:
    """Return name, value and unit of the numbers that all texels share: of a lobe by its parameters, others by their map."""
    named = getattr(material, "parameters_by_name", {})
    rows = [[name, number(value), unit] for name, value, unit in (parameter(*item) for item in named.items())]
    for spec in material.specs():
        if spec.constant and not (named and spec.name == "lobe"):
            values = ", ".join(number(value) for value in material.maps[spec.name].flatten().tolist())
            rows.append([f"{spaced(spec.name)}: {spec.meaning}", values, unit_of(spec.name)])
    return rows


def _card(spec: MapSpec, names: tuple[str, ...], part: Tensor, folder: Path) -> MapCard:
    unit = f" ({unit_of(spec.name)})" if unit_of(spec.name) else ""
    low, high = number(float(part.min())), number(float(part.max()))
    extent = f"{low} to {high}{unit}" if low != high else f"everywhere {low}{unit}"
    name = texture_name(names[0], spec.name) if len(names) == 1 else spaced(spec.name)
    picture, size = _picture(spec, part)
    return MapCard(name, spec.meaning, extent, picture, size, _files(folder, {*names, spec.name}))


def _picture(spec: MapSpec, part: Tensor) -> tuple[str, tuple[int, int]]:
    step = math.ceil(math.sqrt(part.shape[1] * part.shape[2] / LARGE_TEXELS))  # of a large map some rows and columns are enough
    part = part[:, ::step, ::step]
    planes, colours = (hue(part), "gray") if spec.name == "rotation" else (logarithmic(part), "gray") \
        if spec.name == "specular" else seen(spec, part)
    # A table of one row is a strip, not a line.
    rows = planes.repeat_interleave(16, dim=1) if planes.shape[1] == 1 and planes.shape[2] > 16 else planes
    pixels = thinned(rows.float(), _SIDE)
    return data_uri(pixels, colours), (int(pixels.shape[1]), int(pixels.shape[2]))


def _files(folder: Path, names: set[str]) -> tuple[str, ...]:
    suffixes = {storage.suffix for storage in STORAGES.values()}
    return tuple(sorted(path.name for path in folder.iterdir() if path.stem in names and path.suffix in suffixes))
