"""File names that tell directions: those of the Bonn 2003 database, and of UTIA and ATRIUM."""

from __future__ import annotations

import re
from pathlib import PurePosixPath

from torchmat.btf.listing import Listing, from_degrees, is_image, is_mask
from torchmat.btf.pixels import images_of_files
from torchmat.btf.reader import Reader
from torchmat.btf.source import Folder, Zip
from torchmat.errors import DataError, message

_ANGLES = re.compile(r"tl([0-9]{3})([ _])pl([0-9]{3})[ _]tv([0-9]{3})[ _]pv([0-9]{3})(?![0-9])", re.IGNORECASE)


def _separator(source: Folder | Zip) -> str | None:
    """Return what stands between the angles of the first image that is called so; None where none is."""
    for name in source.names:
        match = _ANGLES.search(PurePosixPath(name).name)
        if match and is_image(name):
            return match[2]
    return None


def _read_names(source: Folder | Zip, kind: str) -> Listing:
    files = [name for name in source.names if is_image(name) and not is_mask(name)]
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
    columns = [list(column) for column in zip(*angles, strict=True)]
    light, view = from_degrees(columns[0], columns[1]), from_degrees(columns[2], columns[3])
    return Listing(kind, tuple(files), light, view)


def read_ubo2003(source: Folder | Zip) -> Listing:
    """Parse names of the Bonn 2003 database: ``00081 tl015 pl000 tv000 pv000.jpg``."""
    return _read_names(source, "ubo2003")


def read_utia(source: Folder | Zip) -> Listing:
    """Parse names of the UTIA and ATRIUM databases: ``tl015_pl000_tv000_pv000.png``."""
    return _read_names(source, "utia")


UBO2003 = Reader(
    "ubo2003", "Bonn 2003: `00081 tl015 pl000 tv000 pv000.jpg`", lambda source: _separator(source) == " ", read_ubo2003,
    images_of_files, version=0,
)
UTIA = Reader(
    "utia", "UTIA and ATRIUM: `tl015_pl000_tv000_pv000.png`", lambda source: _separator(source) == "_", read_utia,
    images_of_files, version=0,
)
