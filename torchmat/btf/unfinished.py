"""A store that is being made, and which of its samples are finished: what a stopped process leaves, the next one goes on with.

Beside the codes lies a journal with a line for each finished sample: the mark of the file it came from (size and times, so that
one that changed is decoded again) and the checksum of what was written (so that what a power cut lost is too). A lock says
whether somebody is at work on it.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from torchmat.atomic import Unwritable
from torchmat.file_lock import take, taken_file

_SUFFIX = ".unfinished"
_NAME = re.compile(r"\.[0-9a-f]{24}" + re.escape(_SUFFIX))
_LOCK, _JOURNAL = "lock", "journal.jsonl"
_BEING_MADE = 60.0  # seconds in which a new folder gets its lock
_MOST_SECONDS = 7 * 86400.0  # since it was begun or gone on with
Row = dict[str, Any]


def unfinished_name(store: Path) -> Path:
    """Return where the store of that name is made."""
    return store.with_name(f".{store.name}{_SUFFIX}")


def is_unfinished(path: Path) -> bool:
    """Tell by its name whether a folder of the cache is a store that is being made, or was."""
    return bool(_NAME.fullmatch(path.name))


@contextmanager
def at_work(folder: Path) -> Iterator[Path | None]:
    """Take `folder` for the block, made where it is missing, and give it; None, and it left alone, where somebody else has it.

    It stays when the block is stopped, or ends with an error that says nothing against what is finished; else it is removed.
    """
    folder.mkdir(exist_ok=True)
    lock = _lock(folder)
    if lock is None:
        yield None
        return
    keep = False
    try:
        yield folder
    except (OSError, Unwritable):  # a full disk is not to be kept full
        raise
    except BaseException:
        keep = len(_lines(folder)) > 1
        raise
    finally:
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)
        lock.close()


def _lock(folder: Path) -> IO[bytes] | None:
    try:
        return taken_file(folder / _LOCK)
    except FileNotFoundError:  # removed since by who had it
        return None


def sweep(root: Path, keep: Path, limit: float) -> None:
    """Remove what stopped processes left in `root` and nobody went on with: what is old, and the oldest above `limit` bytes."""
    left = []
    for folder in root.iterdir():
        with suppress(OSError):  # another process may be sweeping too
            if is_unfinished(folder) and folder != keep:
                left.append((folder.stat().st_mtime, folder, sum(map(bytes_there, folder.iterdir()))))
    total = 0
    for begun, folder, size in sorted(left, reverse=True):
        total += size
        if total > limit or time.time() - begun > _MOST_SECONDS:
            remove_abandoned(folder)


@contextmanager
def scratch(place: Path, prefix: str) -> Iterator[Path]:
    """Give a folder for the block; what killed processes left of that name in `place` is removed."""
    for left in place.glob(f"{prefix}*"):
        remove_abandoned(left, _BEING_MADE)
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=place))
    try:
        with open(folder / _LOCK, "ab") as stream:
            take(stream)
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def remove_abandoned(folder: Path, age: float = 0.0) -> None:
    """Remove a folder unless somebody is at work on it, or it is younger than `age` in seconds."""
    with suppress(OSError):
        lock = _lock(folder) if time.time() - folder.stat().st_mtime >= age else None
        if lock is not None:
            shutil.rmtree(folder, ignore_errors=True)
            lock.close()


def _lines(folder: Path) -> list[Any]:
    """Return what the whole lines of a journal say; one that a stopped process began is none."""
    found = []
    try:
        text = (folder / _JOURNAL).read_bytes()
    except OSError:
        return []
    for line in text.split(b"\n"):
        try:
            found.append(json.loads(line))
        except ValueError:
            continue
    return found


class Journal:
    """The finished samples of the store in `folder`.

    Args:
        folder: where it is made.
        about: what its samples must agree in: of another the journal begins anew. Plain JSON.
        marks: of each sample, text that changes with what it is read from.
    """

    def __init__(self, folder: Path, about: object, marks: Sequence[str]) -> None:
        self._path, self._marks, self._lock = folder / _JOURNAL, marks, threading.Lock()
        lines = _lines(folder)
        same = bool(lines) and lines[0] == json.loads(json.dumps(about))
        known = [line for line in lines[1:] if isinstance(line, dict) and self._counts(line)] if same else []
        self.begun = same
        self._rows: dict[int, Row] = {line["row"]: line for line in known}
        text = b"".join(json.dumps(line).encode() + b"\n" for line in (about, *self._rows.values()))
        anew = self._path.with_suffix(".new")
        anew.write_bytes(text)
        os.replace(anew, self._path)

    def _counts(self, line: Row) -> bool:
        row = line.get("row")
        return isinstance(row, int) and 0 <= row < len(self._marks) and line.get("mark") == self._marks[row]

    def finished(self, row: int) -> Row | None:
        """Return what was written down of a sample, None where it has to be decoded."""
        return self._rows.get(row)

    def add(self, rows: Sequence[Row]) -> None:
        """Write down that samples are finished, each a table with `row`, in one go."""
        text = b"".join(json.dumps({**row, "mark": self._marks[row["row"]]}).encode() + b"\n" for row in rows)
        with self._lock, open(self._path, "ab") as stream:
            stream.write(text)


def mapped(path: Path, dtype: np.dtype, shape: tuple[int, ...], begun: bool) -> np.ndarray:
    """Return an array mapped from a file, with what is in it where it was `begun`, else of zeros."""
    whole = begun and path.is_file() and path.stat().st_size == int(np.prod(shape)) * dtype.itemsize
    return np.memmap(path, dtype, "r+" if whole else "w+", shape=shape)


def bytes_there(path: Path) -> int:
    """Return the room that a file takes on its disk, 0 of none."""
    try:
        found = path.stat()
    except OSError:
        return 0
    return 512 * getattr(found, "st_blocks", found.st_size // 512)


def runs_of(rows: Sequence[int]) -> list[range]:
    """Return the consecutive runs of rising numbers."""
    breaks = [n for n in range(1, len(rows)) if rows[n] != rows[n - 1] + 1]
    ends = zip([0, *breaks], [*breaks, len(rows)], strict=True)
    return [range(rows[first], rows[last - 1] + 1) for first, last in ends if first < last]

