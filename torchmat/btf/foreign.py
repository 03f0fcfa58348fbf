"""Files of this field that are no photographs with their lights: what each is, and the way on from it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import PurePosixPath

from torchmat.btf.listing import is_image

_RAW = (
    "Develop it, linearly if you can, into a 16-bit TIFF or EXR (RawTherapee, darktable, dcraw -4 -T) and give that; "
    "say --encoding linear."
)
_FITTED = (
    "Give the photographs that it was made of, with their .lp file; torchmat fit ptm --data PHOTOGRAPHS (or hsh) then makes "
    "maps of its own. As it is it is a material: torchmat info, render and export take it."
)
_LIGHTS = "Export the light positions from it as an .lp file, and give that or the photographs' folder."
_ONE_FILE = "Give the file itself where it lies in a folder or zip; if this is it, it begins "
_ELSEWHERE = "Export its images, and write a manifest.csv with a line for each, or register a reader (tm.register_reader)."

# By suffix: what the format is called, and what to do.
FORMATS: dict[str, tuple[str, str]] = {
    ".ptm": ("a fitted Polynomial Texture Map (PTM), not the photographs", _FITTED),
    ".rti": ("a fitted RTI file (harmonics or PTM), not the photographs", _FITTED),
    ".hsh": ("a fitted RTI file (hemispherical harmonics), not the photographs", _FITTED),
    ".relight": ("a project of RelightLab, not the photographs", _LIGHTS),
    ".btf": ("a BTF in one file", _ONE_FILE + "not as Bonn's UBO2014 do. " + _ELSEWHERE),
    **dict.fromkeys((".h5", ".hdf5"), ("an HDF5 container", _ONE_FILE + "not as HDF5 does. " + _ELSEWHERE)),
    ".mat": ("a MATLAB file", "Save its lights as text, x y z a line, and its images as PNG or EXR."),
    **dict.fromkeys(
        (
            ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".dng", ".raf", ".orf", ".rw2", ".pef", ".srw", ".3fr",
            ".iiq",
        ),
        ("a raw camera file", _RAW),
    ),
}


def told(name: str) -> tuple[str, str] | None:
    """Return what a file is by its suffix, and the way on; None for what is not of these kinds."""
    return FORMATS.get(PurePosixPath(name).suffix.lower())


def told_of_all(names: Iterable[str]) -> tuple[str, str] | None:
    """Return what the first of these files is, with its name and how many are alike, and the way on; None without any.

    Raw files count only where there are no pictures: cameras write both.
    """
    names = list(names)
    pictures = any(map(is_image, names))
    found = [(name, told(name)) for name in names]
    kinds = [(name, kind) for name, kind in found if kind and not (pictures and kind[1] == _RAW)]
    if not kinds:
        return None
    name, (what, step) = kinds[0]
    alike = sum(1 for _, kind in kinds if kind == (what, step))
    return f"{name} is {what}" + (f" ({alike} files are of that kind)" if alike > 1 else ""), step
