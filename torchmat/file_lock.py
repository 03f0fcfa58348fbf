"""A lock that the system takes back when its process ends, however that ends."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import IO, Any


def take(stream: IO[Any]) -> bool:
    """Return whether the lock of an open file could be taken; the file itself says nothing, so none is left stuck."""
    try:
        if sys.platform == "win32":
            import msvcrt

            stream.seek(1_000_000)  # far behind the text, which others may read
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def taken_file(path: Path) -> IO[bytes] | None:
    """Return the file `path`, made where there is none, with its lock, which goes when it is closed; None where another has it.

    Raises OSError where it cannot be opened.
    """
    stream = open(path, "ab")
    # Who had the lock may have removed the file meanwhile: then it is that of nothing.
    if take(stream) and os.path.lexists(path) and os.path.samestat(os.fstat(stream.fileno()), os.stat(path)):
        return stream
    stream.close()
    return None
