"""A folder or a zip as one thing: names of files, their content, and a fingerprint that changes with them."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from torchmat.errors import DataError, message

_LARGEST_MEMBER = 2**31  # bytes of one file in a zip; a larger one is no photograph
_IGNORED_PARTS = ("__MACOSX",)


def _hidden(name: str) -> bool:
    parts = PurePosixPath(name).parts
    return any(part.startswith(".") or part in _IGNORED_PARTS for part in parts)


class Folder:
    """The files below a folder, by their names relative to it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        stats = {}
        for root, folders, files in os.walk(path):
            folders.sort()
            for file in files:
                full = Path(root, file)
                name = full.relative_to(path).as_posix()
                if not _hidden(name):
                    stats[name] = full.stat()
        self.names = sorted(stats)
        lines = (f"{name}\0{stats[name].st_size}\0{stats[name].st_mtime_ns}" for name in self.names)
        self.fingerprint = hashlib.sha256("\n".join(lines).encode("utf-8", "surrogateescape")).hexdigest()

    def read(self, name: str) -> bytes:
        """Return the content of one file."""
        return (self.path / name).read_bytes()

    @contextmanager
    def file(self, name: str) -> Iterator[Path]:
        """Yield a path under which one file can be opened."""
        yield self.path / name

    def close(self) -> None:
        """Release what the source holds: nothing, for a folder."""


class Zip:
    """The files of a zip archive. Nothing is ever unpacked under a name that the archive chose."""

    def __init__(self, path: Path) -> None:
        self.path = path
        stat = path.stat()
        self.fingerprint = hashlib.sha256(f"{stat.st_size}\0{stat.st_mtime_ns}".encode()).hexdigest()
        try:
            self._archive = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, OSError, NotImplementedError) as error:
            step = "Check that the download or copy is complete."
            raise DataError(message(str(path), "the archive", "be a readable zip", str(error), step)) from error
        self._lock = threading.Lock()
        self._scratch: Path | None = None
        self._members = {i.filename: i for i in self._archive.infolist() if not i.is_dir() and not _hidden(i.filename)}
        for info in self._members.values():
            self._refuse_unsafe(info)
        self.names = sorted(self._members)

    def _refuse_unsafe(self, info: zipfile.ZipInfo) -> None:
        where = f"{self.path}: {info.filename}"
        parts = PurePosixPath(info.filename.replace("\\", "/")).parts
        if ".." in parts or info.filename.startswith(("/", "\\")) or ":" in parts[0]:
            step = "Repack the archive with plain relative names."
            raise DataError(message(where, "the name", "stay inside the archive", "it leads outside", step))
        if info.file_size > _LARGEST_MEMBER:
            fact = f"it would unpack to {info.file_size} bytes"
            raise DataError(message(where, "the file", "be smaller than 2 GiB", fact, "Remove it from the archive."))
        if info.flag_bits & 1:
            raise DataError(message(where, "the file", "not be encrypted", "it is", "Repack without a password."))

    def read(self, name: str) -> bytes:
        """Return the content of one file; raises DataError when it is damaged or larger than the archive says."""
        try:
            with self._lock, self._archive.open(self._members[name]) as stream:
                # One byte more than promised tells a lie about the size without unpacking all of it.
                data = stream.read(self._members[name].file_size + 1)
        except (zipfile.BadZipFile, OSError, EOFError, NotImplementedError, ValueError) as error:
            step = "Repack the archive from the original files."
            where = f"{self.path}: {name}"
            raise DataError(message(where, "the file", "unpack without damage", str(error), step)) from error
        except Exception as error:  # zlib.error has no public base class beyond Exception
            where = f"{self.path}: {name}"
            raise DataError(message(where, "the file", "unpack without damage", str(error))) from error
        if len(data) != self._members[name].file_size:
            fact = f"the archive says {self._members[name].file_size} bytes and {len(data)} came"
            step = "Repack the archive from the original files."
            raise DataError(message(f"{self.path}: {name}", "the file", "have the stated size", fact, step))
        return data

    @contextmanager
    def file(self, name: str) -> Iterator[Path]:
        """Yield a path under which one file can be opened, for the time of the block (OpenImageIO reads no memory)."""
        data = self.read(name)
        with self._lock:
            if self._scratch is None:
                self._scratch = Path(tempfile.mkdtemp(prefix="torchmat-unzip-"))
        handle, path = tempfile.mkstemp(suffix=PurePosixPath(name).suffix, dir=self._scratch)
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            yield Path(path)
        finally:
            os.unlink(path)

    def close(self) -> None:
        """Close the archive and remove the scratch folder."""
        self._archive.close()
        if self._scratch is not None:
            shutil.rmtree(self._scratch, ignore_errors=True)


def open_source(path: str | Path) -> Folder | Zip:
    """Open a folder or a zip; raises DataError, which names the path, for anything else."""
    path = Path(path)
    if path.is_dir():
        return Folder(path)
    if not path.exists():
        raise DataError(message(str(path), "the path", "exist", "there is nothing", "Check the spelling."))
    if zipfile.is_zipfile(path):
        return Zip(path)
    if path.suffix.lower() in (".csv", ".lp"):
        step = f"Give its folder instead: {path.parent}."
        raise DataError(message(str(path), "the path", "be a folder or a zip", "it is a file", step))
    step = "Give the folder or the zip that holds the images and their directions."
    raise DataError(message(str(path), "the path", "be a folder or a zip", "it is neither", step))
