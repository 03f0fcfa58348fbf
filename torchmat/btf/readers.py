"""Which file shows which light and view: one small parser per way of saying so. The only home of degrees.

A parser takes a source (folder or zip) and returns a Listing. `find_kind` looks at names only, so that asking is cheap.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePosixPath

import torch
from torch import Tensor

from torchmat import frames
from torchmat.btf.source import Folder, Zip
from torchmat.errors import DataError, check_option, message
from torchmat.images import IMAGE_SUFFIXES

_UNIT_TOLERANCE = 1e-3
_ANGLES = re.compile(r"tl(\d{3})([ _])pl(\d{3})[ _]tv(\d{3})[ _]pv(\d{3})", re.IGNORECASE)


@dataclass(frozen=True)
class Listing:
    """Image files with their directions: `files` [n] names, `light` and `view` [n, 3] unit vectors, float64."""

    kind: str
    files: tuple[str, ...]
    light: Tensor
    view: Tensor


def _is_image(name: str) -> bool:
    return PurePosixPath(name).suffix.lower() in IMAGE_SUFFIXES


def _directions(polar_deg: list[float], azimuth_deg: list[float]) -> Tensor:
    polar = torch.deg2rad(torch.tensor(polar_deg, dtype=torch.float64))
    azimuth = torch.deg2rad(torch.tensor(azimuth_deg, dtype=torch.float64))
    return frames.from_polar(polar, azimuth)


# Names that carry the angles: Bonn 2003 (spaces) and UTIA / ATRIUM (underscores).


def _read_names(source: Folder | Zip, kind: str) -> Listing:
    files = [name for name in source.names if _is_image(name)]
    matches = [_ANGLES.search(PurePosixPath(name).name) for name in files]
    missing = [name for name, match in zip(files, matches, strict=True) if match is None]
    if missing:
        fact = f"{len(missing)} of {len(files)} image files do not, first {missing[0]!r}"
        step = "Rename those files or move them out."
        raise DataError(
            message(str(source.path), "each image name", "hold tlTTT plPPP tvTTT pvPPP (degrees)", fact, step)
        )
    angles = [[float(match[k]) for k in (1, 3, 4, 5)] for match in matches if match]
    for name, (light_polar, _, view_polar, _) in zip(files, angles, strict=True):
        if light_polar > 90 or view_polar >= 90:
            fact = f"light is at {light_polar:g}, view at {view_polar:g}"
            step = "tl and tv are polar angles from the normal; the view must lie above the surface."
            raise DataError(message(f"{source.path}: {name}", "polar angles", "be 0 to 90 degrees", fact, step))
    light_polar, light_azimuth, view_polar, view_azimuth = map(list, zip(*angles, strict=True))
    light, view = _directions(light_polar, light_azimuth), _directions(view_polar, view_azimuth)
    return Listing(kind, tuple(files), light, view)


def read_ubo2003(source: Folder | Zip) -> Listing:
    """Parse names of the Bonn 2003 database: ``00081 tl015 pl000 tv000 pv000.jpg``."""
    return _read_names(source, "ubo2003")


def read_utia(source: Folder | Zip) -> Listing:
    """Parse names of the UTIA and ATRIUM databases: ``tl015_pl000_tv000_pv000.png``."""
    return _read_names(source, "utia")


# manifest.csv


def _decode_text(source: Folder | Zip, name: str) -> str:
    data = source.read(name)
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        where = f"{source.path}: {name}"
        raise DataError(message(where, "the text", "be UTF-8", str(error), "Save it as UTF-8.")) from error


def _number(where: str, column: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        step = "Fill in the direction or remove the line."
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
        values = [_number(where, name, row.get(name)) for name in self.names]
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
        return _directions(polar, azimuth)

    def _refuse_radians(self, where: str, polar: list[float], azimuth: list[float]) -> None:
        # Many directions, none beyond 1.6 degrees, azimuths that fill one turn in radians: the unit is wrong.
        small = max(polar) <= math.pi / 2 + 1e-3 and max(map(abs, azimuth)) <= 2 * math.pi + 1e-3
        if self.unit == "deg" and small and max(polar) > 0.1 and len(set(azimuth)) > 2:
            fact = f"the largest polar angle is {max(polar):.4g} and the largest azimuth {max(azimuth):.4g}"
            step = f"These look like radians: name the columns {self.which}_polar_rad, {self.which}_azimuth_rad."
            raise DataError(message(where, f"the {self.which} angles", "be in degrees", fact, step))


def _csv_rows(where: str, text: str) -> tuple[list[str], list[dict[str, str]]]:
    first_line = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=first_line.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True)
    try:
        lines = [[cell.strip() for cell in line] for line in reader]
    except csv.Error as error:
        raise DataError(message(where, "the table", "be readable CSV", str(error), "Export it again.")) from error
    lines = [line for line in lines if any(line)]
    if len(lines) < 2:
        step = "List one image a line below a header line."
        raise DataError(message(where, "the table", "hold a header and at least one line", f"it has {len(lines)}", step))
    header = [cell.lower() for cell in lines[0]]
    for number, line in enumerate(lines[1:], 2):
        if len(line) != len(header):
            fact = f"it has {len(line)} cells and the header {len(header)}"
            raise DataError(message(f"{where}: line {number}", "each line", "have a cell per column", fact))
    return header, [dict(zip(header, line, strict=True)) for line in lines[1:]]


def read_manifest(source: Folder | Zip) -> Listing:
    """Parse ``manifest.csv``: a column `file`, and light and view as polar and azimuth (deg or rad) or x, y, z."""
    name = _one(source, lambda n: PurePosixPath(n).name.lower() == "manifest.csv", "manifest.csv")
    where = f"{source.path}: {name}"
    header, rows = _csv_rows(where, _decode_text(source, name))
    if "file" not in header:
        step = "Name the column with the image files `file`."
        raise DataError(message(where, "the header", "have a column `file`", f"it has {', '.join(header)}", step))
    columns = [_Columns(where, which, header) for which in ("light", "view")]
    known = _Names(source, name)
    files, values = [], ([], [])
    for number, row in enumerate(rows, 2):
        line = f"{where}: line {number}"
        files.append(known.find(line, row["file"]))
        for column, target in zip(columns, values, strict=True):
            target.append(column.read(line, row))
    light, view = (column.directions(where, target) for column, target in zip(columns, values, strict=True))
    return Listing("manifest", tuple(files), light, view)


class _Names:
    """Finds the file that a table means, whatever slashes, case or folders it was written with."""

    def __init__(self, source: Folder | Zip, table: str) -> None:
        self._folder = PurePosixPath(table).parent
        self._exact = set(source.names)
        self._by_name: dict[str, list[str]] = {}
        for name in source.names:
            self._by_name.setdefault(PurePosixPath(name).name.lower(), []).append(name)

    def lookup(self, text: str) -> str | None:
        text = text.replace("\\", "/")
        beside = (self._folder / text).as_posix()
        for name in (beside, text):
            if name in self._exact:
                return name
        alike = self._by_name.get(PurePosixPath(text).name.lower(), [])
        return alike[0] if len(alike) == 1 else None

    def find(self, where: str, text: str) -> str:
        found = self.lookup(text)
        if found is None:
            step = "Put the image there, or correct or remove the line."
            raise DataError(message(where, f"the file {text!r}", "exist", "it is not there", step))
        return found


def _one(source: Folder | Zip, wanted: Callable[[str], bool], what: str) -> str:
    """Return the one name that is wanted; the shallowest wins, two at the same depth are an error."""
    found = sorted(filter(wanted, source.names), key=lambda name: (name.count("/"), name))
    if not found:
        raise DataError(message(str(source.path), what, "be there", "there is none"))
    if len(found) > 1 and found[0].count("/") == found[1].count("/"):
        fact = f"there are {len(found)}: {found[0]}, {found[1]}"
        raise DataError(message(str(source.path), what, "be the only one", fact, "Keep one, or give its folder."))
    return found[0]


# RTI light positions


def _lp_number(token: str) -> float | None:
    try:
        value = float(token)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _lp_line(line: str, known: _Names) -> tuple[str, list[float]] | None:
    """Split one line into (text that names the file, x y z); None when no three numbers stand together at an end."""
    tokens = line.replace(",", " ").replace(";", " ").split()
    numbers = [_lp_number(token) for token in tokens]
    for rest, triple in ((tokens[:-3], numbers[-3:]), (tokens[3:], numbers[:3])):
        if len(triple) == 3 and None not in triple and rest:
            # A leading running number is not part of the name, unless a file is really called so.
            options = [" ".join(rest), " ".join(rest[1:])] if len(rest) > 1 and rest[0].isdigit() else [" ".join(rest)]
            for text in options:
                if known.lookup(text) is not None:
                    return text, triple
    for rest, triple in ((tokens[:-3], numbers[-3:]), (tokens[3:], numbers[:3])):
        if len(triple) == 3 and None not in triple and rest:
            return " ".join(rest), triple
    return None


def read_lp(source: Folder | Zip) -> Listing:
    """Parse an RTI ``.lp`` file: ``name x y z`` or ``x y z name`` a line, with or without a leading count line.

    The camera looks along the normal. A running number before the name is allowed.
    """
    name = _one(source, lambda n: n.lower().endswith(".lp"), "an .lp file")
    where = f"{source.path}: {name}"
    lines = [line.strip() for line in _decode_text(source, name).splitlines()]
    numbered = [(number, line) for number, line in enumerate(lines, 1) if line and not line.startswith("#")]
    announced = None
    if numbered and numbered[0][1].isdigit():
        announced = int(numbered.pop(0)[1])
    known = _Names(source, name)
    files, light = [], []
    for number, line in numbered:
        parsed = _lp_line(line, known)
        if parsed is None:
            step = "Write `name x y z` or `x y z name`."
            raise DataError(message(f"{where}: line {number}", "the line", "hold a name and x y z", repr(line), step))
        files.append(known.find(f"{where}: line {number}", parsed[0]))
        light.append(parsed[1])
    if announced is not None and announced != len(files):
        fact = f"it says {announced} and {len(files)} follow"
        raise DataError(message(where, "the count line", "match the lines below it", fact, "Complete the file."))
    if not files:
        raise DataError(message(where, "the file", "list at least one image", "it lists none"))
    view = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).repeat(len(files), 1)
    return Listing("rti", tuple(files), torch.tensor(light, dtype=torch.float64), view)


READERS: dict[str, Callable[[Folder | Zip], Listing]] = {
    "manifest": read_manifest,
    "rti": read_lp,
    "ubo2003": read_ubo2003,
    "utia": read_utia,
}


def find_kind(source: Folder | Zip) -> str:
    """Return which reader fits the names in `source`; raises DataError when none does."""
    names = [PurePosixPath(name).name.lower() for name in source.names]
    if "manifest.csv" in names:
        return "manifest"
    if any(name.endswith(".lp") for name in names):
        return "rti"
    for name in source.names:
        match = _ANGLES.search(PurePosixPath(name).name)
        if match and _is_image(name):
            return "ubo2003" if match[2] == " " else "utia"
    images = sum(map(_is_image, source.names))
    fact = f"there are {len(names)} files, {images} of them images"
    step = "Add a manifest.csv with the columns file, light_polar_deg, light_azimuth_deg, view_polar_deg, view_azimuth_deg."
    raise DataError(message(str(source.path), "the data", "tell its directions", fact, step))


def read_listing(source: Folder | Zip, kind: str | None, duplicates: str, normalise: bool) -> Listing:
    """Parse `source` as `kind` (None: found from its content) and check the directions."""
    if kind is not None:
        check_option("load_btf", "kind", kind, READERS)
    listing = READERS[kind or find_kind(source)](source)
    light, view = (_unit(source, listing, which, normalise) for which in ("light", "view"))
    listing = Listing(listing.kind, listing.files, light, view)
    _refuse_below(source, listing)
    if duplicates == "error":
        _refuse_duplicates(source, listing)
    return listing


def _unit(source: Folder | Zip, listing: Listing, which: str, normalise: bool) -> Tensor:
    directions: Tensor = getattr(listing, which)
    length = directions.norm(dim=1, keepdim=True)
    bad = ((length - 1).abs() > _UNIT_TOLERANCE)[:, 0]
    if bool((length == 0).any()) or (bool(bad.any()) and not normalise):
        first = int((bad | (length == 0)[:, 0]).nonzero()[0, 0])
        fact = f"{int(bad.sum())} of {len(bad)} are not, first of length {float(length[first, 0]):.6g}"
        step = "Divide each by its length, or pass normalise=True if they are positions of far lights."
        where = f"{source.path}: {listing.files[first]}"
        raise DataError(message(where, f"the {which} direction", "be a unit vector", fact, step))
    return directions / length


def _refuse_below(source: Folder | Zip, listing: Listing) -> None:
    for which in ("light", "view"):
        directions: Tensor = getattr(listing, which)
        # A light exactly on the horizon is legal (its images are black); rounding may put cos(90 deg) at 6e-17.
        below = directions[:, 2] < -1e-9 if which == "light" else directions[:, 2] <= 1e-9
        if bool(below.any()):
            first = int(below.nonzero()[0, 0])
            x, y, z = directions[first].tolist()
            fact = f"{int(below.sum())} of {len(below)} do not, first is ({x:.4g}, {y:.4g}, {z:.4g})"
            where = f"{source.path}: {listing.files[first]}"
            step = "z points away from the surface; remove the image or correct the sign."
            raise DataError(message(where, f"the {which} direction", "lie above the surface", fact, step))


def _refuse_duplicates(source: Folder | Zip, listing: Listing) -> None:
    seen: dict[tuple[float, ...], str] = {}
    keys = torch.round(torch.cat((listing.light, listing.view), dim=1), decimals=5) + 0.0
    for file, key in zip(listing.files, map(tuple, keys.tolist()), strict=True):
        if key in seen:
            fact = f"it has those of {seen[key]}"
            step = "Remove one of the two, or pass duplicates='keep' if both were measured."
            raise DataError(message(f"{source.path}: {file}", "the directions", "differ from every other's", fact, step))
        seen[key] = file
