"""A cluster of Dask: a local one of processes that ends with the block, or a scheduler that runs elsewhere."""

from __future__ import annotations

import logging
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from torchmat.errors import DataError, RangeError, message

ALLOWED_FAILURES = 3  # times that the workers of one task may die before it counts as failed
PATIENCE = 10  # seconds to reach a scheduler


@contextmanager
def cluster(workers: int = 0, scheduler: str | None = None) -> Iterator[Any]:
    """Yield a `distributed.Client`: of the scheduler at an address, or of `workers` local processes (0: one a core).

    Raises DataError when `distributed` is not installed or the scheduler cannot be reached, RangeError for a number of
    workers that cannot be.
    """
    if not isinstance(workers, int) or workers < 0:
        raise RangeError(message("fit-many", "workers", "be a whole number of at least 0", f"it is {workers!r}"))
    if find_spec("distributed") is None:
        step = "pip install torchmat[dask]"
        raise DataError(message("fit-many", "the package distributed", "be installed", "it is not", step))
    with _remote(scheduler) if scheduler else _local(workers or os.cpu_count() or 1) as client:
        yield client


@contextmanager
def _remote(address: str) -> Iterator[Any]:
    from distributed import Client

    with _quiet():
        try:
            client = Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            step = "Start it with `dask scheduler`, and workers with `dask worker`; addresses are tcp://HOST:PORT."
            fact = str(error).strip().split("\n")[0] or type(error).__name__
            raise DataError(message("fit-many", f"the scheduler {address}", "be reachable", fact, step)) from error
        with client:
            yield client


@contextmanager
def _local(workers: int) -> Iterator[Any]:
    import dask
    from distributed import Client, LocalCluster

    folder = tempfile.mkdtemp(prefix="torchmat-workers-")  # workers spill and lock there, and not beside the data
    settings = {"distributed.scheduler.allowed-failures": ALLOWED_FAILURES, "temporary-directory": folder}
    try:
        # Images are mapped, and the system takes their memory back when it needs it: no limit that counts them.
        with _quiet(), dask.config.set(settings), LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, memory_limit=0, dashboard_address="127.0.0.1:0",
            local_directory=folder, silence_logs=logging.CRITICAL,
        ) as found, Client(found, set_as_default=False) as client:
            yield client
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the cluster's log off the terminal: what matters comes back as errors."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
