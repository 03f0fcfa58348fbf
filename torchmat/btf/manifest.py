"""``manifest.csv``: one line an image, with its light and view as angles or vectors, or where they stand."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

from torchmat.btf.listing import FileNames, Listing, from_degrees, read_text, the_one
from torchmat.btf.pixels import images_of_files
from torchmat.btf.reader import Reader
from torchmat.btf.source import Folder, Zip
from torchmat.errors import DataError, message


_WIDTH, _FALLOFF = "sample_width", "falloff"


def _number(where: str, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        step = "Fill in the direction or remove the line."
        if re.fullmatch(r"[-+]?\d+,\d+", text):
            step = "Write decimals with a point."
        raise DataError(message(where, column, "be a finite number", f"it is {text!r}", step))
    return value


class _Columns:
    """The two or three columns that give one direction, in whichever of the accepted units they come."""

    def __init__(self, where: str, which: str, header: list[str]) -> None:
        self.which = which
        choices = {
            "deg": (f"{which}_polar_deg", f"{which}_azimuth_deg"),
            "rad": (f"{which}_polar_rad", f"{which}_azimuth_rad"),
            "xyz": (f"{which}_x", f"{which}_y", f"{which}_z"),
        }
        found = [unit for unit, names in choices.items() if all(name in header for name in names)]
        if len(found) != 1:
            listed = " or ".join(", ".join(names) for names in choices.values())
            fact = f"the columns are {', '.join(header) or 'none'}"
            step = "Add the missing columns." if not found else "Keep one unit only."
            raise DataError(message(where, f"the {which} direction", f"have the columns {listed}", fact, step))
        self.unit = found[0]
        self.names = choices[self.unit]

    def read(self, where: str, row: dict[str, str]) -> list[float]:
        values = [_number(where, name, row[name]) for name in self.names]
        if self.unit == "xyz":
            return values
        if self.unit == "rad":
            values = [math.degrees(value) for value in values]
        if not 0 <= values[0] <= 90 or abs(values[1]) > 720:
            unit = "degrees" if self.unit == "deg" else "radians"
            fact = f"it is {row[self.names[0]]}, azimuth {row[self.names[1]]}"
            step = "Polar is measured from the normal; check the unit."
            raise DataError(message(where, self.names[0], f"be an angle of 0 to 90 degrees, in {unit}", fact, step))
        return values

    def directions(self, where: str, values: list[list[float]]) -> Tensor:
        if self.unit == "xyz":
            return torch.tensor(values, dtype=torch.float64)
        polar, azimuth = map(list, zip(*values, strict=True))
        self._refuse_radians(where, polar, azimuth)
        return from_degrees(polar, azimuth)

    def _refuse_radians(self, where: str, polar: list[float], azimuth: list[float]) -> None:
        # Many directions, none beyond 1.6 degrees, azimuths that fill one turn in radians: the unit is wrong.
        small = max(polar) <= math.pi / 2 + 1e-3 and max(map(abs, azimuth)) <= 2 * math.pi + 1e-3
        if self.unit == "deg" and small and max(polar) > 0.1 and len(set(azimuth)) > 2:
            fact = f"the largest polar angle is {max(polar):.4g} and the largest azimuth {max(azimuth):.4g}"
            step = f"These look like radians: name the columns {self.which}_polar_rad, {self.which}_azimuth_rad."
            raise DataError(message(where, f"the {self.which} angles", "be in degrees", fact, step))


def _lines(where: str, text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, cells) of each line that is not blank."""
    first_line = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=first_line.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True)
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            if any(cells):
                yield reader.line_num, cells
    except csv.Error as error:
        raise DataError(message(where, "the table", "be readable CSV", str(error), "Export it again.")) from error


def _table(where: str, text: str) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """Return the header, in small letters, and (line number, cells by column) of each line below it."""
    lines = list(_lines(where, text))
    if len(lines) < 2:
        step = "List one image a line below a header line."
        fact = f"it has {len(lines)}"
        raise DataError(message(where, "the table", "hold a header and at least one line", fact, step))
    header = [cell.lower() for cell in lines[0][1]]
    twice = sorted({name for name in header if name and header.count(name) > 1})
    if twice:
        step = "Remove or rename one of them."
        raise DataError(message(where, "the header", "name each column once", f"{twice[0]!r} stands twice", step))
    for number, cells in lines[1:]:
        if len(cells) != len(header):
            fact = f"it has {len(cells)} cells and the header {len(header)}"
            step = "Fill in the missing cells, or put names that hold the separator in quotes."
            raise DataError(message(f"{where}: line {number}", "each line", "have a cell per column", fact, step))
    return header, [(number, dict(zip(header, cells, strict=True))) for number, cells in lines[1:]]


def _is_manifest(name: str) -> bool:
    return name.rpartition("/")[2].lower() == "manifest.csv"


def _one_number(where: str, name: str, rows: list[tuple[int, dict[str, str]]], allowed: str, good: Callable[[float], bool]) -> float:
    """Return the number of a column that has one throughout; raises DataError, which names the line, where it has not."""
    first: float | None = None
    for number, row in rows:
        value = _number(f"{where}: line {number}", name, row[name])
        if not good(value) or (first is not None and value != first):
            fact = f"it is {value:g}" + ("" if first is None else f", above {first:g}")
            raise DataError(message(f"{where}: line {number}", name, f"be {allowed}, and the same on all lines", fact))
        first = value
    assert first is not None  # a table has a line
    return first


def _positions(where: str, header: list[str], rows: list[tuple[int, dict[str, str]]], columns: list[_Columns], found: list[Tensor]) -> dict[str, Any]:
    """Return the fields of a Listing that say where lights and cameras stand; none without a column `sample_width`."""
    if _WIDTH not in header:
        if _FALLOFF in header:
            step = "Add sample_width, in the unit of light_x, light_y, light_z, or remove the column."
            raise DataError(message(where, _FALLOFF, f"come with {_WIDTH}", "there is none", step))
        return {}
    width = _one_number(where, _WIDTH, rows, "positive", lambda value: value > 0)
    near = {f"{one.which}_position": value / width for one, value in zip(columns, found, strict=True) if one.unit == "xyz"}
    if not near:
        step = "Give light_x, light_y, light_z from the sample's centre in its unit, or remove the column."
        raise DataError(message(where, _WIDTH, "come with positions", "lights and views are angles", step))
    falloff = _FALLOFF not in header or _one_number(where, _FALLOFF, rows, "0 or 1", lambda value: value in (0, 1)) == 1
    named = " and ".join({"light_position": "lights", "view_position": "cameras"}[name] for name in near)
    return {**near, "falloff": falloff, "notes": (f"{named} are near: positions over a sample {width:g} wide",)}


def read_manifest(source: Folder | Zip) -> Listing:
    """Parse ``manifest.csv``: a column `file`, and light and view as polar and azimuth (deg or rad) or x, y, z.

    With a column `sample_width`, how wide the pictured sample is, x, y, z are positions from its centre in the same unit: of
    near lights, and of near cameras where views have x, y, z too. Column `falloff`: 1 where the images darken with the
    distance to the light (as without the column), 0 where that was taken out.
    """
    name = the_one(source, _is_manifest, "manifest.csv")
    where = f"{source.path}: {name}"
    header, rows = _table(where, read_text(source, name))
    if "file" not in header:
        step = "Name the column with the image files `file`."
        raise DataError(message(where, "the header", "have a column `file`", f"it has {', '.join(header)}", step))
    columns = [_Columns(where, which, header) for which in ("light", "view")]
    known = FileNames(source, name)
    files: list[str] = []
    values: tuple[list[list[float]], list[list[float]]] = ([], [])
    for number, row in rows:
        line = f"{where}: line {number}"
        files.append(known.find(line, row["file"]))
        for column, target in zip(columns, values, strict=True):
            target.append(column.read(line, row))
    light, view = (column.directions(where, target) for column, target in zip(columns, values, strict=True))
    near = _positions(where, header, rows, columns, [light, view])
    return Listing("manifest", tuple(files), light, view, **near)


MANIFEST = Reader(
    "manifest", "a `manifest.csv` with a line for each image", lambda source: any(map(_is_manifest, source.names)),
    read_manifest, images_of_files, version=0,
)
