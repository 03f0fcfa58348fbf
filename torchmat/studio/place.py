"""Where a studio keeps what is its own, and whether the material can be written: beside the folder, never in it."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchmat.errors import DataError, message
from torchmat.text_file import read_json

MANIFEST, _FORMAT = "manifest.json", "torchmat-material"  # as the material's folder has them, which needs torch
PICTURES = frozenset({".png", ".exr", ".tif", ".tiff", ".jpg", ".jpeg"})


@dataclass(frozen=True)
class Place:
    """A material `folder`, the hidden folder `own` for history, settings and lock, and whether the material `writable` is."""

    folder: Path
    own: Path
    writable: bool

    @property
    def manifest(self) -> Path:
        """The manifest of the material."""
        return self.folder / MANIFEST


def place_of(folder: str | Path) -> Place:
    """Return the place of a material folder; its own folder is made: ``.NAME.studio`` beside it.

    Where nothing can be written beside the material, it stands in the user's cache and the material counts as read-only.
    Raises DataError when the folder is no material.
    """
    found = Path(os.path.realpath(folder))
    if not (found / MANIFEST).is_file():
        step = "Give the folder that `save_material` or `torchmat fit --out` wrote, or one picture to make a material of."
        raise DataError(message(str(found / MANIFEST), "the manifest", "exist", "it is not there", step))
    kind = read_json(found / MANIFEST, "the manifest", "be a torchmat material").get("format")
    if kind != _FORMAT:
        raise DataError(message(str(found / MANIFEST), "format", f"be {_FORMAT!r}", f"it is {kind!r}"))
    writable = _can_write(found) and _can_write(found.parent)
    own = found.with_name(f".{found.name}.studio") if writable else _in_cache(found)
    own.mkdir(parents=True, exist_ok=True)
    own.chmod(0o700)  # its lock holds the address, and that the token
    return Place(found, own, writable)


def _in_cache(folder: Path) -> Path:
    digest = hashlib.sha256(os.fsencode(folder)).hexdigest()[:16]
    return cache_folder() / f"{folder.name}-{digest}"


def cache_folder() -> Path:
    """Return where studios keep what belongs to the user, and to no one material."""
    return Path(os.environ.get("TORCHMAT_CACHE") or Path.home() / ".cache" / "torchmat") / "studio"


def _can_write(folder: Path) -> bool:
    """Return whether a file can be made in a folder, by making one: rights alone do not tell of a read-only disk."""
    try:
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".torchmat-"):
            return True
    except OSError:
        return False


def inside(folder: Path, name: str) -> Path | None:
    """Return the path of the file `name` in a folder; None where it leads elsewhere, by its name or by a link."""
    if not name or name != os.path.basename(name) or name.startswith(".") or "\0" in name or "\\" in name:
        return None
    path = folder / name
    return path if os.path.realpath(path) == os.path.join(os.path.realpath(folder), name) else None


def check_links(folder: Path, names: list[str]) -> None:
    """Raise DataError for the first of some files of a folder that leads out of it."""
    for name in names:
        if os.path.lexists(folder / name) and inside(folder, name) is None:
            step = "Copy the file into the folder in place of the link."
            raise DataError(message(str(folder / name), "the texture", "lie in the folder", "it leads elsewhere", step))


def pictures_in(folder: Path) -> list[str]:
    """Return the names of the picture files of a folder that lead nowhere else, in order."""
    with os.scandir(folder) as entries:
        names = [entry.name for entry in entries if Path(entry.name).suffix.lower() in PICTURES and entry.is_file()]
    return sorted(name for name in names if inside(folder, name) is not None)


def write_own(path: Path, table: Any) -> None:
    """Write a file of the studio's own as JSON, whole or not at all."""
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    with open(partial, "w", encoding="utf-8") as stream:
        json.dump(table, stream, indent=1, ensure_ascii=False)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(partial, path)
