"""A measured BRDF that was packed: `.binary.gz`, or a zip that holds one `.binary` or `.bsdf`."""

from __future__ import annotations

import gzip
import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import BinaryIO, IO, cast

from torchmat.errors import DataError, message
from torchmat.zip_names import zip_names

SUFFIXES = {".binary": "merl", ".bsdf": "rgl"}
_MOST_BYTES = 2**31  # larger than any published file, and than what fits into memory as a table
_PIECE = 2**20
_STEP = "Unpack it, or download it again."


def kind_by_name(path: str | Path) -> str | None:
    """Return what the name says that a file, or the one in an archive, is: "merl", "rgl" or None."""
    kind = SUFFIXES.get(Path(path).suffix.lower())
    if kind is None and Path(path).suffix.lower() == ".gz":
        kind = SUFFIXES.get(Path(Path(path).stem).suffix.lower())
    return kind or next((SUFFIXES[PurePosixPath(name).suffix.lower()] for name in _in_zip(path)), None)


def _in_zip(path: str | Path) -> list[str]:
    """Return the BRDF files in a zip; of one that holds pictures too none, for a BTF may come with its BRDF."""
    names = [name for name in zip_names(path) if not name.startswith("__MACOSX")]
    suffixes = {name: os.path.splitext(name)[1].lower() for name in names}
    if set(suffixes.values()) - set(SUFFIXES) - {".txt", ".md", ".pdf", ""}:
        return []
    return [name for name, suffix in suffixes.items() if suffix in SUFFIXES]


@contextmanager
def unpacked(path: str | Path) -> Iterator[Path]:
    """Yield a path to the BRDF file itself, for the time of the block; errors of what was packed name the archive.

    Raises DataError when an archive holds several, is damaged, or unpacks to more than 2 GiB.
    """
    path = Path(path)
    names = _in_zip(path)
    with open(path, "rb") as stream:
        packed = stream.read(2) == b"\x1f\x8b"
    if not names and not packed:
        yield path
        return
    if len(names) > 1:
        fact = f"it holds {len(names)}: {', '.join(sorted(names)[:3])}"
        raise DataError(message(str(path), "the archive", "hold one BRDF", fact, "Unpack it, and give one of them."))
    handle, scratch = tempfile.mkstemp(prefix="torchmat-brdf-", suffix=f".{kind_by_name(path) or 'merl'}")
    try:
        with os.fdopen(handle, "wb") as target:
            unpack(path, names[0] if names else None, target)
        try:
            yield Path(scratch)
        except DataError as error:
            raise DataError(str(error).replace(scratch, f"{path}: {names[0]}" if names else str(path))) from error
    finally:
        os.unlink(scratch)


def unpack(path: Path, name: str | None, target: BinaryIO, most: int = _MOST_BYTES) -> None:
    """Write what a `.gz`, or the member `name` of a zip, holds; raises DataError when it is damaged, or more than `most` bytes."""
    count = 0
    try:
        with opened(path, name) as stream:
            while piece := stream.read(_PIECE):
                count += len(piece)
                if count > most:
                    fact, requirement = "it is more", f"be at most {most / 2**30:.3g} GiB"
                    raise DataError(message(str(path), "what it unpacks to", requirement, fact, _STEP))
                target.write(piece)
    except DAMAGED as error:
        fact = str(error) or type(error).__name__
        raise DataError(message(str(path), "the archive", "unpack without damage", fact.rstrip("."), _STEP)) from error


DAMAGED = (OSError, EOFError, zlib.error, zipfile.BadZipFile, RuntimeError, NotImplementedError, ValueError)


@contextmanager
def opened(path: Path, name: str | None) -> Iterator[IO[bytes]]:
    """Open a `.gz`, or the member `name` of a zip, to be read from its start."""
    if name is None:
        with gzip.open(path) as stream:
            yield cast(IO[bytes], stream)
        return
    with zipfile.ZipFile(path) as archive, archive.open(name) as member:
        yield member
