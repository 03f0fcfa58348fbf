"""A `serve` that does what the fuzzer must survive: it dies of one task and never returns from another."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing.connection import Connection


def misbehave(connection: Connection, _room: str) -> None:
    """Die of "die", sleep at "sleep", answer anything else."""
    connection.send("ready")
    while (task := connection.recv()) is not None:
        if task == ("die",):
            os.kill(os.getpid(), signal.SIGSEGV)
        if task == ("sleep",):
            time.sleep(600)
        connection.send(("fine", f"{task[0]}"))
