"""One studio a folder: a lock that the system takes back when its process ends, however that ends."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import IO

from torchmat.errors import DataError, message
from torchmat.file_lock import take

_NAME = "lock"


class Held(DataError):
    """Another studio has the folder; `address` is where it answers, "" if it does not say."""

    def __init__(self, folder: Path, address: str, process: object) -> None:
        step = "Close that one first, or look at a copy of the folder."
        fact = f"process {process} has it open" if process else "another process has it open"
        super().__init__(message(str(folder), "the folder", "be open in one studio only", fact, step))
        self.address = address


class Lock:
    """The lock of a studio in its own folder `own`, held until `release` or the end of the process."""

    def __init__(self, own: Path, folder: Path) -> None:
        self._path = own / _NAME
        self._stream: IO[str] = open(self._path, "a+", encoding="utf-8")
        os.chmod(self._path, 0o600)
        if not take(self._stream):
            address, process = self._said()
            self._stream.close()
            raise Held(folder, address, process)
        self.say("")

    def say(self, address: str) -> None:
        """Write down where this studio answers, for a second one."""
        self._stream.seek(0)
        self._stream.truncate()
        self._stream.write(json.dumps({"address": address, "process": os.getpid()}))
        self._stream.flush()

    def _said(self) -> tuple[str, object]:
        try:
            self._stream.seek(0)
            table = json.loads(self._stream.read(10_000))
            return str(table["address"]), table["process"]
        except (OSError, ValueError, LookupError, TypeError):
            return "", None

    def release(self) -> None:
        """Let others have the folder."""
        if not self._stream.closed:
            self.say("")
            self._stream.close()
