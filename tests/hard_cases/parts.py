"""The long form of the hard cases, part by part. Each part yields the rows of its engine: case, component, count, passed, figure, note.

`Settings.share` multiplies the number of inputs (1 is the whole long form); pictures go into `Settings.out`.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tests.hard_cases.components import Room, outcome


class Settings(NamedTuple):
    """What a run of the long form may choose."""

    out: Path
    share: float = 1.0
    seed: int = 1

    def count(self, whole: int, least: int = 1) -> int:
        """Return its share of a whole number of inputs."""
        return max(least, round(self.share * whole))


Rows = Iterator[dict]


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="torchmat-hard-") as name:
        yield Path(name)


def table(settings: Settings) -> Rows:
    """Every case with every component, with all inputs."""
    import torch
    from tests.hard_cases.table import entries, measured

    for entry in list(entries()):
        torch.manual_seed(0)
        with _folder() as folder:
            yield {**measured(entry, Room(folder, thorough=settings.share >= 1)), "count": 1}


def fuzz(settings: Settings) -> Rows:
    """20,000 changed files."""
    from tests.hard_cases import fuzz as engine
    from tests.hard_cases.fuzz_readers import READERS

    yield from engine.run(settings.count(20_000, len(READERS)), settings.seed)


def sweeps(settings: Settings) -> Rows:
    """About 10,000 floats for each input of each public function against mpmath, and of each model against float64 and loops."""
    from tests.hard_cases import sweep_models
    from tests.hard_cases import sweeps as engine
    from tests.hard_cases.sweep_entries import ENTRIES
    from tests.models.examples import CASES

    for name in ENTRIES:
        yield from engine.run(settings.count(_FLOATS, 4), settings.seed, [name])
    for case in CASES:
        for dtype in sweep_models.DTYPES:
            yield from sweep_models.sweep_directions(*case.values, case.id, dtype, settings.count(_PAIRS, 4), settings.seed)
            yield from sweep_models.sweep_maps(*case.values, case.id, dtype, settings.count(10_000, 4), settings.seed)


_FLOATS, _PAIRS = 10_000, 800  # 800 draw 12 times as many hard pairs


def conditioning(settings: Settings) -> Rows:
    """Solvers at condition numbers from 1 to 1e12, drawn as conditioning.png."""
    from tests.hard_cases import conditioning as engine

    rows = engine.run(settings.count(13, 3), settings.seed)
    engine.plot(rows, settings.out / "conditioning.png")
    yield from ({**row, "count": row.get("count", 1)} for row in rows)


def noise(settings: Settings) -> Rows:
    """Fits of ever worse photographs, drawn as noise.png; a row tells by how much the worst harm multiplies the error."""
    from tests.hard_cases import noise as engine

    models = None if settings.share >= 1 else {"lambert": {}}
    rows = engine.run(5, settings.seed, models)
    engine.plot(rows, settings.out / "noise.png")
    said = engine.jumps(rows)
    for harm, model in dict.fromkeys((row["harm"], row["model"]) for row in rows):
        line = [row["relative_error"] for row in rows if (row["harm"], row["model"]) == (harm, model)]
        own = [words for words in said if words.startswith(f"{harm}, {model}:")]
        note = "; ".join(own) or "relative error " + " ".join(f"{error:.3g}" for error in line)
        yield {
            "case": harm, "component": model, "count": len(line), "passed": not own, "figure": line[-1] / line[0], "note": note,
        }


def kills(settings: Settings) -> Rows:
    """At least 200 kills of fits and exports."""
    from tests.hard_cases import kills as engine

    each = -(-settings.count(200, len(engine.WORKS)) // len(engine.WORKS))
    with _folder() as folder:
        yield from engine.run(each, settings.seed, folder)


def disks(settings: Settings) -> Rows:
    """Disks that fill up at every moment, and ones that nobody may write to, for every writer and for the cache."""
    from tests.hard_cases import cases_files
    from tests.hard_cases.writers import writers

    amounts = range(0, 420, max(4, round(4 / settings.share)))
    for writer in writers():
        for case, act in (
            ("full disk", lambda room, writer=writer: cases_files.fill_up(writer, room, amounts)),
            ("read-only disk", lambda room, writer=writer: cases_files.read_only_target(writer, room)),
        ):
            yield _tried(case, writer.name, len(amounts) if case == "full disk" else 1, act)
    yield _tried("full disk", "cache", len(amounts), lambda room: cache_on_a_full_disk(room, amounts))


def _tried(case: str, component: str, count: int, act: Callable[[Room], int | None]) -> dict:
    with _folder() as folder:
        found = outcome(lambda: act(Room(folder)))
    if found["figure"] is not None:
        found["note"] = f"{found['figure']} of {count} writes were stopped"
    return {"case": case, "component": component, "count": count, **found}


def cache_on_a_full_disk(room: Room, kilobytes: range) -> int:
    """Load through a cache whose disk fills up: the images are right, and what is not kept is said; return how often."""
    import warnings

    import torch
    from tests.hard_cases.kills import photographs
    from tests.hard_cases.writers import leave_free, small_disk

    import torchmat as tm

    source, stopped = photographs(room.folder / "photographs"), 0
    plain = tm.load_btf(source, cache=False, progress=False)
    wanted = plain.images(range(len(plain)))
    with small_disk(room.folder / "disk", 256) as disk:
        for free in (*kilobytes, 10_000):
            (disk / "filler").unlink(missing_ok=True)
            leave_free(disk, free)
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                btf = tm.load_btf(source, cache=disk / "cache", progress=False)
            assert torch.equal(btf.images(range(len(btf))), wanted), "the cache brought other images"
            del btf
            stopped += bool(said)
            assert all(str(disk) in str(one.message) for one in said), f"{said} does not name the disk"
            shutil.rmtree(disk / "cache", ignore_errors=True)
    return stopped


def digests(settings: Settings) -> Rows:
    """The same bits as stored, with one thread and two, in fresh processes, out of the cache."""
    from tests.hard_cases import digests as engine

    yield from engine.run()


def long_runs(settings: Settings) -> Rows:
    """2,000 fits and 2,000 renders in one process."""
    from tests.hard_cases import long_runs as engine

    yield from engine.run(settings.count(2000, 20), settings.seed)


PARTS: dict[str, Callable[[Settings], Rows]] = {
    # The longest first: parts run two at a time.
    "sweeps": sweeps, "table": table, "fuzz": fuzz, "long": long_runs, "kills": kills, "disks": disks, "noise": noise,
    "digests": digests, "conditioning": conditioning,
}


def alone() -> None:
    """Give this process what it would share with others: one thread, and a cache that goes when it ends."""
    import torch

    torch.set_num_threads(1)
    room = tempfile.TemporaryDirectory(prefix="torchmat-cache-")
    atexit.register(room.cleanup)
    os.environ.update(OMP_NUM_THREADS="1", TORCHMAT_CACHE=room.name)
