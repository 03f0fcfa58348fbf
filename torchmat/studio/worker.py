"""The process that knows torch: the studio answers while torch is loaded, and lives on when a damaged file ends that.

Calls go through pipes as pickled pairs, one after the other. What a call warns of comes back beside its result.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pickle
import struct
import subprocess
import sys
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, BinaryIO, NamedTuple

from torchmat.errors import DataError, Notice, TorchmatError, message

_LENGTH = struct.Struct("<Q")


class Answer(NamedTuple):
    """What a call gave: its `value`, and in `notices` what was taken otherwise than it stood there."""

    value: Any
    notices: list[str]


class Worker:
    """A process with a `torchmat.studio.session.Session` of these keywords, started by `start` or the first call."""

    def __init__(self, **session: Any) -> None:
        self._session = session
        self._thread = ThreadPoolExecutor(1, "worker")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Let the process start loading what it needs."""
        self._thread.submit(self._running)

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            self._process = self._start()
        return self._process

    def _start(self) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "torchmat.studio.worker"]
        # Of its own group: Ctrl-C is the studio's, which then ends it.
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        assert process.stdin is not None
        _send(process.stdin, self._session)
        return process

    async def call(self, name: str, **keywords: Any) -> Answer:
        """Return what a method of the session gives; raises what it raises, DataError when the process ended over it."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, self.wait_for, name, keywords)

    def wait_for(self, name: str, keywords: dict[str, Any]) -> Answer:
        """Do as `call`, and wait for it."""
        process = self._running()
        assert process.stdin is not None and process.stdout is not None
        try:
            _send(process.stdin, (name, keywords))
            fine, value, notices = _receive(process.stdout)
        except (OSError, EOFError, ValueError) as error:
            code = process.wait()
            self._process = None
            step = "It is started again; look at the file that was saved last."
            raise DataError(message("studio", "the process that reads maps", "go on", f"it ended with {code}", step)) from error
        if not fine:
            raise value
        return Answer(value, notices)

    def stop(self) -> None:
        """End the process."""
        self._thread.shutdown(wait=False, cancel_futures=True)
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            with contextlib.suppress(OSError):
                stream.close() if stream is not None else None


def _send(stream: BinaryIO | Any, value: Any) -> None:
    data = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
    stream.write(_LENGTH.pack(len(data)))
    stream.write(data)
    stream.flush()


def _receive(stream: BinaryIO | Any) -> Any:
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError
    data = stream.read(_LENGTH.unpack(head)[0])
    return pickle.loads(data)  # from the process that this one started


def answered(call: Callable[..., Any], keywords: dict[str, Any]) -> tuple[bool, Any, list[str]]:
    """Return whether a call went well, what it gave or raised, and what it warned of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", Notice)
        try:
            fine, value = True, call(**keywords)
        except TorchmatError as error:
            fine, value = False, DataError(str(error), map=error.map)
        except Exception as error:  # whatever a call of the page does, the next one is answered
            step = "The material stays as it was."
            text = message("studio", "what was asked for", "be done", f"{type(error).__name__}: {error}", step)
            fine, value = False, DataError(text)
    return fine, value, [str(one.message) for one in caught]


def main() -> None:
    """Answer calls until there are no more."""
    calls, results = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what anything prints is no answer
    keywords = _receive(calls)
    from torchmat.studio.session import Session

    session = Session(**keywords)
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            name, given = _receive(calls)
            _send(results, answered(getattr(session, name), given))


if __name__ == "__main__":
    main()
