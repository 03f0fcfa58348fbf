"""A process that does tasks one after the other, and is replaced when one of them kills it or keeps it."""

from __future__ import annotations

import multiprocessing
import resource
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

CRASH, HANG = "crash", "hang"
ADDRESS_BYTES = 12 * 2**30  # of the process: torch alone maps several
_Serve = Callable[[Connection, str], None]


def _limited(serve: _Serve, connection: Connection, room: str) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_BYTES, ADDRESS_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    serve(connection, room)


class Worker:
    """Runs `serve`, a function that says it is ready, then answers each task with (outcome, words) until None comes.

    It works in a folder of its own in `room`. `wall_seconds` is how long one task may take before its process is ended.
    """

    def __init__(self, serve: _Serve, room: Path, wall_seconds: float) -> None:
        self._serve, self._room, self._wall_seconds, self._started = serve, room, wall_seconds, 0
        self._start()

    def _start(self) -> None:
        self._started += 1
        context = multiprocessing.get_context("spawn")  # forking a process with threads is asking for trouble
        self._connection, theirs = context.Pipe()
        place = str(self._room / str(self._started))
        self._process = context.Process(target=_limited, args=(self._serve, theirs, place), daemon=True)
        self._process.start()
        theirs.close()
        self._connection.recv()

    def ask(self, *task: object) -> tuple[str, str]:
        """Return what came of a task; HANG or CRASH when that is what it did."""
        self._connection.send(task)
        try:
            if self._connection.poll(self._wall_seconds):
                return self._connection.recv()
            outcome = HANG, f"more than {self._wall_seconds:g} s"
        except EOFError:
            self._process.join()
            outcome = CRASH, f"the process ended with {self._process.exitcode}"
        self._process.kill()
        self._process.join()
        self._connection.close()
        self._start()
        return outcome

    def close(self) -> None:
        """End the process."""
        self._connection.send(None)
        self._process.join()
        self._connection.close()
