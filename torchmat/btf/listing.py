"""What a reader returns, and what readers share: degrees, text files, and the files that a table means."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePosixPath

import torch
from torch import Tensor

from torchmat import frames
from torchmat.btf.source import Folder, Zip
from torchmat.errors import DataError, message
from torchmat.images import IMAGE_SUFFIXES
from torchmat.text_file import decode_text


@dataclass(frozen=True)
class Listing:
    """Image files with their directions: `files` [n] names, `light` and `view` [n, 3] unit vectors, float64.

    `intensity` [n, 3] is what values are divided by: how bright each light was. `notes` say what was taken for what;
    `faults` are the texts of errors that are raised unless bad lights are to be skipped.

    Near lights and cameras have positions [n, 3], float64, in widths of the whole picture from its centre; `light` or `view`
    then follow from them. `falloff` says whether the images show how light falls off with distance.

    Where only `near` says that `light` are positions, they are in a unit in which the picture is `width` wide, if that is known.
    """

    kind: str
    files: tuple[str, ...]
    light: Tensor
    view: Tensor
    intensity: Tensor | None = None
    notes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    light_position: Tensor | None = None
    view_position: Tensor | None = None
    falloff: bool = True
    near: bool = False
    width: float | None = None


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return the key that sorts names as people count: img2 before img10, whatever the capitals."""
    parts = re.split(r"([0-9]+)", unicodedata.normalize("NFC", name).casefold())
    return (*((0, int(part), part) if part[:1].isdecimal() and len(part) < 4000 else (1, 0, part) for part in parts if part), (-1, 0, name))


def is_image(name: str) -> bool:
    """Tell whether a file is an image, by its suffix."""
    return os.path.splitext(name)[1].lower() in IMAGE_SUFFIXES


def is_mask(name: str) -> bool:
    """Tell whether an image is by its name the mask of others: ``mask.png``, ``cat.mask.png``."""
    if "mask" not in name.casefold():  # of thousands of names hardly one goes further
        return False
    stem = PurePosixPath(name).stem.casefold()
    return is_image(name) and (stem == "mask" or stem.endswith(".mask"))


def from_degrees(polar_deg: list[float], azimuth_deg: list[float]) -> Tensor:
    """Return unit directions [n, 3], float64, of angles in degrees."""
    polar = torch.deg2rad(torch.tensor(polar_deg, dtype=torch.float64))
    azimuth = torch.deg2rad(torch.tensor(azimuth_deg, dtype=torch.float64))
    return frames.from_polar(polar, azimuth)


def read_text(source: Folder | Zip, name: str) -> str:
    """Return a text file in UTF-8 (with or without a byte-order mark) or UTF-16 (with one)."""
    return decode_text(f"{source.path}: {name}", source.read(name))


def the_one(source: Folder | Zip, wanted: Callable[[str], bool], what: str) -> str:
    """Return the one name that is wanted; the shallowest wins, two at the same depth are an error."""
    found = sorted(filter(wanted, source.names), key=lambda name: (name.count("/"), name))
    if not found:
        step = "Add it, or leave `kind` out to have the kind found."
        raise DataError(message(str(source.path), what, "be there", "there is none", step))
    if len(found) > 1 and found[0].count("/") == found[1].count("/"):
        fact = f"there are {len(found)}: {found[0]}, {found[1]}"
        raise DataError(message(str(source.path), what, "be the only one", fact, "Keep one, or give the file's own path."))
    return found[0]


def _folded(name: str) -> str:
    # macOS takes letters with accents apart, Windows does not tell capitals from small letters.
    return unicodedata.normalize("NFC", name).casefold()


class FileNames:
    """Finds the file that a table means, whatever slashes, case or folders it was written with."""

    def __init__(self, source: Folder | Zip, table: str) -> None:
        self._folder = PurePosixPath(table).parent
        self._exact = set(source.names)
        self._whole: dict[str, list[str]] = {}
        self._last: dict[str, list[str]] = {}
        self._listed_at: dict[str, str] = {}
        for name in source.names:
            self._whole.setdefault(_folded(name), []).append(name)
            self._last.setdefault(_folded(name.rpartition("/")[2]), []).append(name)

    def lookup(self, text: str) -> list[str]:
        """Return the files that `text` may mean: beside the table, from the top, or anywhere by the last part alone."""
        text = text.replace("\\", "/")
        if text in self._exact and not self._folder.parts:  # as nearly all names are written
            return [text]
        ways = (str(self._folder / text), str(PurePosixPath(text)))
        for name in ways:
            if name in self._exact:
                return [name]
        for name in ways:
            if _folded(name) in self._whole:
                return self._whole[_folded(name)]
        return self._last.get(_folded(PurePosixPath(text).name), [])

    def missing(self, where: str, text: str) -> str | None:
        """Return the text of the error when no file is meant by `text`, None when there is one."""
        if self.lookup(text):
            return None
        step = "Put the image there, or correct or remove the line."
        return message(where, f"the file {text!r}", "exist", "it is not there", step)

    def find(self, where: str, text: str) -> str:
        """Return the one file that `text` means; raises DataError when it is none, several, or listed before."""
        found = self.lookup(text)
        if not found:
            raise DataError(self.missing(where, text))
        if len(found) > 1:
            fact = f"it may be {found[0]} or {found[1]}"
            step = "Write its folder too."
            raise DataError(message(where, f"the file {text!r}", "be one file", fact, step))
        if found[0] in self._listed_at:
            fact = f"{found[0]} also stands at {self._listed_at[found[0]]}"
            step = "Correct the name, or remove one of the two lines."
            raise DataError(message(where, f"the file {text!r}", "be listed once", fact, step))
        self._listed_at[found[0]] = where.rpartition(": ")[2]
        return found[0]
