"""The tiles of one material on a cluster: the same plan and the same tiles as in one process."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchmat.btf import Btf, load_btf
from torchmat.errors import DataError, message
from torchmat.fitting import FitResult, fit
from torchmat.fitting.relief.window import Window
from torchmat.fitting.tiles.fit import fit_tile, tiles_fitted_by
from torchmat.fitting.tiles.memory import USUAL_SIDE
from torchmat.fitting.tiles.plan import TilePart, TilePlan
from torchmat.fitting.training import Training
from torchmat.many.cluster import cluster
from torchmat.many.jobs import Job

_LAST: dict[str, Btf] = {}  # what this process has loaded last


@dataclass(frozen=True)
class _Samples:
    """A training without its images: where they are, how to know them again, and the rest."""

    path: str
    reading: dict[str, Any]
    identity: str
    used: Tensor
    importance: Tensor | None
    seed: int
    tiles: bool
    dtype: torch.dtype

    def training(self) -> Training:
        btf = _loaded(self.path, self.reading)
        if btf.identity() != self.identity:
            step = "Give all workers the same files, by a path that means them everywhere."
            fact = "a worker found other data there"
            raise DataError(message(self.path, "the data", "be the same for all workers", fact, step))
        return Training(btf, self.used, self.seed, self.tiles, self.dtype, False, self.importance)


def _loaded(path: str, reading: dict[str, Any]) -> Btf:
    """Return a BTF, the same one as long as tiles of the same data follow each other."""
    key = repr((path, sorted(reading.items())))
    if key not in _LAST:
        _LAST.clear()
        _LAST[key] = load_btf(path, **reading, progress=False)
    return _LAST[key]


def _fit_tile(samples: _Samples, plan: TilePlan, window: Window, seconds: float) -> TilePart:
    with torch.no_grad():
        return fit_tile(samples.training(), plan, window, seconds)


def fit_by_tiles(
    job: Job, *, workers: int = 0, scheduler: str | None = None, work: str | Path | None = None,
    show: bool | None = None,
) -> tuple[Btf, FitResult]:
    """Fit one material, its tiles on a cluster; return its BTF and the result, as `fit` would.

    What the tiles share is found here, each tile on a worker, which reads the data by its path. Finished tiles are kept
    in `work`, as `fit` keeps them. A worker that dies is replaced and its tile fitted again.
    """
    config = job.settled
    config = config if config.tile_size or config.memory_mb else replace(config, tile_size=USUAL_SIDE)
    btf = load_btf(job.data, **job.reading, progress=show)
    with cluster(workers, scheduler) as client, tiles_fitted_by(_runner(client, job)):
        return btf, fit(btf, config, work=work, progress=show)


def _runner(client: Any, job: Job) -> Callable[[Training, TilePlan, Sequence[Window]], Iterable[TilePart]]:
    def run(training: Training, plan: TilePlan, windows: Sequence[Window]) -> Iterator[TilePart]:
        from distributed import KilledWorker, as_completed

        samples = _Samples(
            str(job.data), job.reading, training.btf.identity(), training.used, training.importance, training.seed,
            training.tiles, training.dtype,
        )
        # Sent once to each worker, where it stays one object: what a relief's lights see is then found once there.
        shared = client.scatter([samples, plan], broadcast=True)
        seconds = max(0.0, training.watch.limit - training.watch.seconds) / max(1, len(windows))
        futures = [client.submit(_fit_tile, *shared, window, seconds, pure=False) for window in windows]
        try:
            for future, part in as_completed(futures, loop=client.loop, with_results=True):
                yield part
                future.release()
        except KilledWorker as error:
            fact = f"it died {error.allowed_failures + 1} times at one tile"
            step = "Use smaller tiles, or fewer workers."
            raise DataError(message("fit-many", "a worker", "fit a tile", fact, step)) from error

    return run


