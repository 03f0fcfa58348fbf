"""A folder, a zip or a file as one thing: names of files, their content, and a fingerprint that changes with them."""

from __future__ import annotations

import hashlib
import itertools
import os
import re
import shutil
import stat
import tempfile
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path

from torchmat.errors import DataError, TorchmatError, message
from torchmat.text_file import MOST_BYTES, check_size

_LARGEST_MEMBER = 2**31  # bytes of one file in a zip; a larger one is no photograph
_PIECE = 2**20  # bytes of it that are unpacked in a go
_MEMORY, _FILES_AT_ONCE = "/dev/shm", 64  # where files lie in memory, and more than are ever open together
_IGNORED_PARTS = ("__MACOSX",)
_REPACK = "Repack the archive from the original files."


def _hidden(name: str) -> bool:
    return any(part.startswith(".") or part in _IGNORED_PARTS for part in name.split("/"))


def _unlistable(error: OSError) -> None:
    step = "Check the permissions of the folder."
    raise DataError(message(str(error.filename), "the folder", "be readable", str(error), step)) from error


def _first_visit(folder: str, base: str, seen: set[str]) -> bool:
    """Tell whether a walk from `base` should enter `folder`: links lead out of it, never back or round in a circle."""
    real = os.path.realpath(folder)
    if os.path.islink(folder) and (real + os.sep).startswith(base + os.sep):
        return False
    if any((known + os.sep).startswith(real + os.sep) for known in seen):
        return False
    seen.add(real)
    return True


def _files_below(path: Path) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield (relative name, (size, time of the content, time of the entry)) of the files below `path`; what hides or is no file is left out."""
    base = os.path.realpath(path)
    seen = {base}
    for root, folders, files in os.walk(path, onerror=_unlistable, followlinks=True):
        folders[:] = [f for f in sorted(folders) if not _hidden(f) and _first_visit(os.path.join(root, f), base, seen)]
        for file in files:
            if _hidden(file):
                continue
            full = os.path.join(root, file)
            name = Path(os.path.relpath(full, path)).as_posix()
            try:
                found = os.stat(full)
            except OSError:
                # A link to nothing stays listed: a sample that cannot be read is an error, not one sample fewer.
                yield name, (-1, 0, 0)
                continue
            if stat.S_ISREG(found.st_mode):
                yield name, (found.st_size, found.st_mtime_ns, found.st_ctime_ns)


class Folder:
    """The files below a folder, by their names relative to it; `by_profile` says to follow colour profiles of images."""

    by_profile = True

    def __init__(self, path: Path) -> None:
        self.path = path
        self._marks = marks = dict(_files_below(path))
        self.names = sorted(marks)
        lines = (f"{name}\0{marks[name][0]}\0{marks[name][1]}" for name in self.names)
        self.fingerprint = hashlib.sha256("\n".join(lines).encode("utf-8", "surrogateescape")).hexdigest()

    def mark(self, name: str) -> str:
        """Return a text that changes with one file: it has changed, or was put there anew, if any of its times has."""
        return ":".join(map(str, self._marks[name]))

    def read(self, name: str) -> bytes:
        """Return the content of a table; raises DataError when it cannot be read or is far too long for one."""
        where = f"{self.path}: {name}"
        try:
            with open(self.path / name, "rb") as stream:
                data = stream.read(MOST_BYTES + 1)
        except OSError as error:
            step = "Check that it exists and may be read."
            raise DataError(message(where, "the file", "be readable", str(error), step)) from error
        check_size(where, len(data))
        return data

    @contextmanager
    def file(self, name: str) -> Iterator[Path]:
        """Yield a path under which one file can be opened."""
        yield self.path / name

    def close(self) -> None:
        """Release what the source holds: nothing, for a folder."""


class File:
    """One file that holds everything: directions and images."""

    by_profile = True

    def __init__(self, path: Path) -> None:
        self.path = path
        self.names = [path.name]
        self.fingerprint = _mark(path)

    @property
    def content(self) -> Path:
        """Where its bytes lie: a packed file unpacks them for it, and is still called by its `path`."""
        return self.path

    def told(self, error: TorchmatError) -> TorchmatError:
        """Return an error about the bytes as one about the file that the user gave."""
        return error

    def start(self, count: int) -> bytes:
        """Return the first `count` bytes, fewer of a shorter file: by them a kind of file is told."""
        try:
            with open(self.path, "rb") as stream:
                return stream.read(count)
        except OSError as error:
            step = "Check that it may be read."
            raise DataError(message(str(self.path), "the file", "be readable", str(error), step)) from error

    def close(self) -> None:
        """Release what the source holds: nothing."""


def _mark(path: Path) -> str:
    found = path.stat()
    return hashlib.sha256(f"{found.st_size}\0{found.st_mtime_ns}".encode()).hexdigest()


class Zip:
    """The files of a zip archive, as those of a Folder. Nothing is ever unpacked under a name that the archive chose."""

    by_profile = True

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._archive: zipfile.ZipFile | None = None
        self._scratch: Path | None = None
        self._count = itertools.count()
        self.fingerprint = _mark(path)

    @cached_property
    def _members(self) -> dict[str, zipfile.ZipInfo]:
        """The files of the archive. Read when asked for: a BTF that comes from the cache does without."""
        try:
            self._archive = zipfile.ZipFile(self.path)
        except Exception as error:  # zipfile lets struct, Unicode and other errors of a damaged directory through
            step = "Check that the download or copy is complete."
            text = message(str(self.path), "the archive", "be a readable zip", _reason(error), step)
            raise DataError(text) from error
        # Archives made on Windows may separate folders with a backslash.
        members: dict[str, zipfile.ZipInfo] = {}
        for info in self._archive.infolist():
            name = info.filename.replace("\\", "/")
            self._refuse_unsafe(name, info)
            if name in members and not name.endswith("/"):
                fact = "it stands there twice"
                raise DataError(message(f"{self.path}: {name}", "the name", "be that of one file", fact, _REPACK))
            members[name] = info
        return {name: info for name, info in members.items() if name[-1:] not in ("", "/") and not _hidden(name)}

    @cached_property
    def names(self) -> list[str]:
        """The names of the files, sorted; raises DataError when the archive is damaged or unsafe."""
        return sorted(self._members)

    def _refuse_unsafe(self, name: str, info: zipfile.ZipInfo) -> None:
        where = f"{self.path}: {info.filename}"
        if ".." in name.split("/") or name.startswith("/") or re.match("[A-Za-z]:", name):
            step = "Repack the archive with plain relative names."
            raise DataError(message(where, "the name", "stay inside the archive", "it leads outside", step))
        if info.file_size > _LARGEST_MEMBER:
            fact = f"it would unpack to {info.file_size} bytes"
            raise DataError(message(where, "the file", "be smaller than 2 GiB", fact, "Remove it from the archive."))
        if info.flag_bits & 1:
            raise DataError(message(where, "the file", "not be encrypted", "it is", "Repack without a password."))

    def mark(self, name: str) -> str:
        """Return a text that changes with the content of one file."""
        return f"{self._members[name].file_size}:{self._members[name].CRC}"

    def read(self, name: str) -> bytes:
        """Return the content of a table; raises DataError when it is damaged or far too long for one."""
        check_size(f"{self.path}: {name}", self._members[name].file_size)
        return b"".join(self._pieces(name))

    def _pieces(self, name: str) -> Iterator[bytes]:
        """Yield the content of one file; raises DataError when it is damaged or not as large as the archive says."""
        where, stated = f"{self.path}: {name}", self._members[name].file_size
        came, archive = 0, self._archive
        assert archive is not None  # opened to list the members
        try:
            with self._lock, archive.open(self._members[name]) as stream:
                # One byte more than promised tells a lie about the size without unpacking all of it.
                while piece := stream.read(min(_PIECE, stated + 1 - came)):
                    came += len(piece)
                    yield piece
        except Exception as error:  # zlib.error, among others, has no base class beyond Exception
            raise DataError(message(where, "the file", "unpack without damage", _reason(error), _REPACK)) from error
        if came != stated:
            fact = f"the archive says {stated} bytes and {came} came"
            raise DataError(message(where, "the file", "have the stated size", fact, _REPACK))

    def _room(self) -> Path:
        """Return the folder of scratch files: in memory where there is plenty, for a disk begins a file more slowly than it is decoded."""
        with self._lock:
            if self._scratch is None:
                needed = _FILES_AT_ONCE * max(info.file_size for info in self._members.values())
                spacious = "TMPDIR" not in os.environ and os.path.isdir(_MEMORY) and shutil.disk_usage(_MEMORY).free > needed
                prefix = "torchmat-unzip-"
                self._scratch = Path(tempfile.mkdtemp(prefix=prefix, dir=_MEMORY if spacious and os.access(_MEMORY, os.W_OK) else None))
            return self._scratch

    @contextmanager
    def file(self, name: str) -> Iterator[Path]:
        """Yield a path under which one file can be opened, for the time of the block (OpenImageIO reads no memory)."""
        # The suffix tells OpenImageIO the format; what is no suffix of an image must not shape a path.
        suffix = os.path.splitext(name)[1]
        suffix = suffix if re.fullmatch(r"\.\w{1,8}", suffix, re.ASCII) else ""
        try:
            path = self._room() / f"{next(self._count)}{suffix}"  # in a folder of our own: no name is taken
            with open(path, "xb") as stream:
                stream.writelines(self._pieces(name))
        except OSError as error:
            where = f"{self.path}: {name}"
            step = "Free some space there or set TMPDIR to another folder."
            raise DataError(message(where, "the file", "fit in the temporary folder", str(error), step)) from error
        try:
            yield path
        finally:
            os.unlink(path)

    def close(self) -> None:
        """Close the archive and remove the scratch folder."""
        if self._archive is not None:
            self._archive.close()
        if self._scratch is not None:
            shutil.rmtree(self._scratch, ignore_errors=True)


def _reason(error: Exception) -> str:
    return (str(error) or type(error).__name__).rstrip(".")
