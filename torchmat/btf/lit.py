"""Photographs under one view paired with a table of lights: by the names in it, or by their natural order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

import torch

from torchmat.btf.dome import is_dome, parse_dome
from torchmat.btf.light_table import LightTable, parse_lights
from torchmat.btf.listing import FileNames, Listing, is_image, is_mask, natural, read_text
from torchmat.btf.source import Folder, Zip
from torchmat.errors import DataError, message

if TYPE_CHECKING:
    from torchmat.btf.btf import Btf

KIND = "rti"
NAMES_FILE = "filenames.txt"


def in_order(source: Folder | Zip, folder: str | None = None) -> tuple[list[str], str]:
    """Return the photographs of a source as tables of numbers mean them, and in words what order that is.

    They are those that a ``filenames.txt`` among them lists, in its order; else all images of the shallowest folder that
    has any, or of `folder` alone, as people count (img2 before img10). Raises DataError when there are none.
    """
    lists = [name for name in source.names if PurePosixPath(name).name.lower() == NAMES_FILE]
    lists = [name for name in lists if folder is None or str(PurePosixPath(name).parent) == folder]
    if lists:
        name = min(lists, key=lambda name: (name.count("/"), name))
        known = FileNames(source, name)
        lines = [(n, line.strip().strip("\"'")) for n, line in enumerate(read_text(source, name).splitlines(), 1)]
        files = [known.find(f"{source.path}: {name}: line {number}", line) for number, line in lines if line]
        if files:
            return files, f"the order of {name}"
    images = [name for name in source.names if is_image(name) and not is_mask(name)]
    folders = {str(PurePosixPath(name).parent) for name in images}
    if folder is None and folders:
        folder = min(folders, key=lambda path: (0 if path == "." else path.count("/") + 1, natural(path)))
    files = sorted((name for name in images if str(PurePosixPath(name).parent) == folder), key=natural)
    if not files:
        step = "Check the spelling."
        raise DataError(message(str(source.path), "the folder", "hold photographs", "it holds none", step))
    return files, "their natural order"


def parse_table(source: Folder | Zip, where: str, text: str, beside: str, folder: str | None = None) -> LightTable:
    """Return the lights of a table that is about the photographs of `source`; `beside` is its own name there, or empty."""
    if is_dome(where):
        return parse_dome(where, text)
    known = FileNames(source, beside)
    try:
        images = len(in_order(source, folder)[0])
    except DataError:
        images = None  # a table with names does without
    return parse_lights(where, text, lambda name: bool(known.lookup(name)), images)


def paired(source: Folder | Zip, table: LightTable, beside: str = "", folder: str | None = None) -> Listing:
    """Return the photographs of `source` with their lights; the camera looks along the normal.

    A table without names goes with the photographs `in_order`, which must be as many; one with names may leave
    photographs out, and where it names one that is not there, that is a fault of the listing.
    """
    if table.names is None:
        files, order = in_order(source, folder)
        if len(files) != len(table.light):
            fact = f"there are {len(table.light)} lights and {len(files)} photographs, {files[0]} to {files[-1]}"
            step = f"Move out what is no photograph, or list the photographs in a {NAMES_FILE} beside them."
            raise DataError(message(table.path, "the lights", "be as many as the photographs", fact, step))
        return _listing(files, table, (f"{len(files)} photographs, in {order}, have the lights of {table.path}",))
    known, files, kept, faults = FileNames(source, beside), [], [], []
    for row, (where, name) in enumerate(zip(table.where, table.names, strict=True)):
        missing = known.missing(where, name)
        if missing:
            faults.append(missing)
        else:
            files.append(known.find(where, name))
            kept.append(row)
    if not files:
        raise DataError(faults[0])
    chosen = replace(
        table, light=table.light[kept], intensity=None if table.intensity is None else table.intensity[kept]
    )
    return _listing(files, chosen, _unlisted(source, files), tuple(faults))


def _unlisted(source: Folder | Zip, files: Sequence[str]) -> tuple[str, ...]:
    """Return a note on photographs beside the listed ones that no line names."""
    folders, listed = {PurePosixPath(name).parent for name in files}, set(files)
    left = [name for name in source.names if is_image(name) and not is_mask(name) and PurePosixPath(name).parent in folders and name not in listed]
    if not left:
        return ()
    return (f"{len(left)} images are not in the table of lights and are left out, first {min(left, key=natural)}",)


def _listing(files: Sequence[str], table: LightTable, notes: tuple[str, ...], faults: tuple[str, ...] = ()) -> Listing:
    view = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).repeat(len(files), 1)
    notes = (*table.notes, *notes)
    return Listing(KIND, tuple(files), table.light, view, table.intensity, notes, faults, near=table.near, width=table.width)


def paired_lights(btf: Btf) -> dict[str, list[float]]:
    """Return x, y, z of the light of each photograph of one view, by its file; nothing of several views."""
    if len(btf.views) > 1 or len(btf.source.files) != len(btf):
        return {}
    return {file: [round(x, 6) for x in light] for file, light in zip(btf.source.files, btf.light.tolist(), strict=True)}
