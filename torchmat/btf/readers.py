"""Which file shows which light and view: one small parser per way of saying so.

A parser takes a source (folder or zip) and returns a Listing. `find_kind` looks at names only, so that asking is cheap.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import PurePosixPath

import torch
from torch import Tensor

from torchmat.btf.listing import Listing, from_degrees, is_image
from torchmat.btf.lp import read_lp
from torchmat.btf.manifest import read_manifest
from torchmat.btf.source import Folder, Zip
from torchmat.errors import DataError, check_option, message

_UNIT_TOLERANCE = 1e-3
_ANGLES = re.compile(r"tl([0-9]{3})([ _])pl([0-9]{3})[ _]tv([0-9]{3})[ _]pv([0-9]{3})(?![0-9])", re.IGNORECASE)


def _read_names(source: Folder | Zip, kind: str) -> Listing:
    files = [name for name in source.names if is_image(name)]
    if not files:
        fact = f"none of {len(source.names)} files is one"
        step = "Give the folder or the zip that holds the images."
        raise DataError(message(str(source.path), "the data", "hold images", fact, step))
    matches = [_ANGLES.search(PurePosixPath(name).name) for name in files]
    missing = [name for name, match in zip(files, matches, strict=True) if match is None]
    if missing:
        fact = f"{len(missing)} of {len(files)} image files do not, first {missing[0]!r}"
        step = "Rename those files or move them out."
        raise DataError(
            message(str(source.path), "each image name", "hold tlTTT plPPP tvTTT pvPPP (degrees)", fact, step)
        )
    angles = [[float(match[k]) for k in (1, 3, 4, 5)] for match in matches if match]
    for name, (light_polar, light_azimuth, view_polar, view_azimuth) in zip(files, angles, strict=True):
        where = f"{source.path}: {name}"
        if light_polar > 90 or view_polar >= 90:
            fact = f"light is at {light_polar:g}, view at {view_polar:g}"
            step = "tl and tv are polar angles from the normal; the view must lie above the surface."
            raise DataError(message(where, "polar angles", "be 0 to 90 degrees", fact, step))
        if max(light_azimuth, view_azimuth) > 360:
            fact = f"light is at {light_azimuth:g}, view at {view_azimuth:g}"
            step = "pl and pv are azimuths from the right of the image; correct the name."
            raise DataError(message(where, "azimuths", "be 0 to 360 degrees", fact, step))
    light_polar, light_azimuth, view_polar, view_azimuth = map(list, zip(*angles, strict=True))
    light, view = from_degrees(light_polar, light_azimuth), from_degrees(view_polar, view_azimuth)
    return Listing(kind, tuple(files), light, view)


def read_ubo2003(source: Folder | Zip) -> Listing:
    """Parse names of the Bonn 2003 database: ``00081 tl015 pl000 tv000 pv000.jpg``."""
    return _read_names(source, "ubo2003")


def read_utia(source: Folder | Zip) -> Listing:
    """Parse names of the UTIA and ATRIUM databases: ``tl015_pl000_tv000_pv000.png``."""
    return _read_names(source, "utia")


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
        if match and is_image(name):
            return "ubo2003" if match[2] == " " else "utia"
    images = sum(map(is_image, source.names))
    fact = f"there are {len(names)} files, {images} of them images"
    columns = "file, light_polar_deg, light_azimuth_deg, view_polar_deg, view_azimuth_deg"
    step = f"Add a manifest.csv with the columns {columns}."
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
    none = (length == 0) | ~torch.isfinite(length)
    bad = none if normalise else none | ((length - 1).abs() > _UNIT_TOLERANCE)
    if bool(bad.any()):
        first = int(bad[:, 0].nonzero()[0, 0])
        fact = f"{int(bad.sum())} of {len(bad)} are not, first of length {float(length[first, 0]):.6g}"
        step = "Divide each by its length, or pass normalise=True if they are positions of far lights."
        if bool(none[first]):
            step = "It says nothing about a direction; correct or remove it."
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
            where, fact = f"{source.path}: {file}", f"it has those of {seen[key]}"
            step = "Remove one of the two, or pass duplicates='keep' if both were measured."
            raise DataError(message(where, "the directions", "differ from every other's", fact, step))
        seen[key] = file
