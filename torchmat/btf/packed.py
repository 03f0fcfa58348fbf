"""A file of a kind of its own that was packed: a `.gz`, or a zip that holds nothing else."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from torchmat.brdf.archive import DAMAGED, opened, unpack
from torchmat.btf.source import File
from torchmat.errors import DataError, TorchmatError, message
from torchmat.zip_names import zip_names

_GZIP = b"\x1f\x8b"
_SHARE_OF_DISK = 0.9  # what may be filled of what is free


class Packed(File):
    """A packed file: `start` unpacks no more than it returns, `content` all of it, into a scratch file that `close` removes."""

    def __init__(self, path: Path, member: str | None) -> None:
        super().__init__(path)
        self._member = member
        self._room: str | None = None

    def start(self, count: int) -> bytes:
        try:
            with opened(self.path, self._member) as stream:
                return stream.read(count)
        except DAMAGED as error:
            step = "Unpack it, or download it again."
            fact = (str(error) or type(error).__name__).rstrip(".")
            raise DataError(message(str(self.path), "the archive", "unpack without damage", fact, step)) from error

    @property
    def content(self) -> Path:
        """The path of the unpacked file."""
        if self._room is None:
            room = tempfile.mkdtemp(prefix="torchmat-btf-")
            self._room = room
            # Under a name of our own: that of a member may lead anywhere.
            with open(Path(room) / "content", "wb") as target:
                unpack(self.path, self._member, target, int(_SHARE_OF_DISK * shutil.disk_usage(room).free))
        return Path(self._room) / "content"

    def told(self, error: TorchmatError) -> TorchmatError:
        """Return an error about the scratch file as one about the archive."""
        name = str(self.path) if self._member is None else f"{self.path}: {self._member}"
        return error if self._room is None else type(error)(str(error).replace(str(Path(self._room) / "content"), name))

    def close(self) -> None:
        if self._room is not None:
            shutil.rmtree(self._room, ignore_errors=True)
            self._room = None


def packed_file(path: Path) -> Packed | None:
    """Return the one file that `path` holds packed; None when it is no `.gz`, and no zip of a single file."""
    try:
        with open(path, "rb") as stream:
            if stream.read(2) == _GZIP:
                return Packed(path, None)
    except OSError:
        return None
    names = _members(path)
    return Packed(path, names[0]) if len(names) == 1 else None


def _members(path: Path) -> list[str]:
    return [name for name in zip_names(path) if not any(map(_hidden, name.split("/")))]


def _hidden(part: str) -> bool:
    return part == "__MACOSX" or part.startswith(".")  # so does a name that leads out of the archive, which `Zip` then refuses
