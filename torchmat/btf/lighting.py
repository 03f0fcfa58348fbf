"""Lights that are given beside the photographs: a table that lies elsewhere, or photographs of a chrome ball."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from torchmat.btf.ball import ball_lights
from torchmat.btf.light_table import LightTable
from torchmat.btf.listing import Listing, is_image
from torchmat.btf.lit import in_order, paired, parse_table
from torchmat.btf.source import Folder, Zip
from torchmat.errors import DataError, RangeError, message
from torchmat.text_file import read_text


@dataclass(frozen=True)
class Lighting:
    """How photographs get their lights: `lister` pairs a source with them, and `key` changes when they do."""

    lister: Callable[[Folder | Zip], Listing]
    key: tuple[object, ...]


def home_of(table: Path) -> Path:
    """Return the folder of the photographs that an ``.lp`` file is about: its own, or the one above where that has none.

    RTIBuilder keeps its tables in a folder of their own (`assembly-files`) beside the photographs' one.
    """
    if any(map(is_image, Folder(table.parent).names)):
        return table.parent
    above = table.parent.resolve().parent
    return above if any(map(is_image, Folder(above).names)) else table.parent


def by_table(table: str | Path, home: Path | None = None) -> Lighting:
    """Return the lighting of a table of lights; `home` is the folder of the photographs where the table lies in it."""
    table = Path(table)
    text = read_text(table, "the lights")
    beside = "" if home is None else Path(os.path.relpath(table.resolve(), home.resolve())).as_posix()

    def lister(source: Folder | Zip) -> Listing:
        return paired(source, parse_table(source, str(table), text, beside), beside)

    return Lighting(lister, (beside, hashlib.sha256(text.encode()).hexdigest()))


def by_ball(ball: str | Path, circle: Sequence[float] | None) -> Lighting:
    """Return the lighting that a chrome ball shows: one photograph of it for each of the surface, called alike or in order."""
    if circle is None or len(circle) != 3:
        fact = "the circle is missing" if circle is None else f"it has {len(circle)} numbers"
        step = "Give the ball's circle in pixels: --circle COLUMN ROW RADIUS (circle=(column, row, radius))."
        raise RangeError(message(str(ball), "the ball", "be calibrated", fact, step))
    column, row, radius = map(float, circle)
    folder = Path(ball)
    if not os.path.isdir(folder):
        raise DataError(message(str(folder), "the ball", "be a folder of photographs", "it is none", "Check the spelling."))

    def lister(source: Folder | Zip) -> Listing:
        found = ball_lights(folder, (column, row), radius)
        files = _partners(source, folder, found.files)
        names = tuple(file for file, light in zip(files, found.good, strict=True) if light)
        where = tuple(f"{folder}: {file}" for file, light in zip(found.files, found.good, strict=True) if light)
        table = LightTable(str(folder), names, where, found.light[found.good])
        listing = paired(source, table)
        notes = (f"{len(files)} lights come from the chrome ball in {folder}", *listing.notes)
        return Listing(listing.kind, listing.files, listing.light, listing.view, None, notes, (*found.faults, *listing.faults))

    return Lighting(lister, (Folder(folder).fingerprint, column, row, radius))


def _partners(source: Folder | Zip, ball: Path, balls: Sequence[str]) -> list[str]:
    """Return the photographs in the order of those of the ball: called alike, or else as many, in natural order."""
    files, _ = in_order(source)
    by_stem = {Path(file).stem.casefold(): file for file in files}
    stems = [Path(name).stem.casefold() for name in balls]
    if all(stem in by_stem for stem in stems):
        return [by_stem[stem] for stem in stems]
    if len(files) != len(balls):
        fact = f"there are {len(balls)} for {len(files)} photographs"
        step = "Give one photograph of the ball for each light, or call them as the photographs."
        raise RangeError(message(str(ball), "the photographs of the ball", "be as many as the photographs", fact, step))
    return files
