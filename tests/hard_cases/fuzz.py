"""Hostile files: thousands of changed inputs for everything that reads a file, in processes that may die of them.

What is read must be sound, what is refused must be refused in the package's own words that name the file, within a
bound of time and memory, and without a trace outside of the caches. A finding is told by (reader, number, seed), which
make the same bytes again.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.hard_cases.fuzz_readers import READERS
from tests.hard_cases.fuzz_worker import ACCEPTED, REFUSED, serve
from tests.hard_cases.worker import Worker

WALL_SECONDS = 60.0  # for one input; processor time has a narrower bound


@dataclass
class Found:
    """What came of the inputs of one reader: how often each outcome, and (number, outcome, words) of the wrong ones."""

    counts: Counter = field(default_factory=Counter)
    findings: list[tuple[int, str, str]] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, number: int, outcome: str, words: str) -> None:
        """Count an outcome; keep it when it is neither of the two right ones."""
        self.counts[outcome] += 1
        if outcome not in (ACCEPTED, REFUSED):
            self.findings.append((number, outcome, words))


def fuzz(count: int, seed: int, names: tuple[str, ...] = ()) -> dict[str, Found]:
    """Read `count` changed inputs in all, shared among the readers (those called `names`, or all)."""
    readers = [reader for reader in READERS if not names or reader.name in names]
    found = {reader.name: Found() for reader in readers}
    with tempfile.TemporaryDirectory(prefix="torchmat-fuzz-") as room:
        worker = Worker(serve, Path(room), WALL_SECONDS)
        try:
            for place, reader in enumerate(readers):
                start = time.perf_counter()
                for number in range(count // len(readers) + (place < count % len(readers))):
                    found[reader.name].add(number, *worker.ask(reader.name, number, seed))
                found[reader.name].seconds = time.perf_counter() - start
        finally:
            worker.close()
    return found


def run(count: int, seed: int) -> list[dict[str, Any]]:
    """Read `count` changed inputs in all and return `rows_of` what came of them."""
    return rows_of(fuzz(count, seed), seed)


def rows_of(every: dict[str, Found], seed: int) -> list[dict[str, Any]]:
    """Return a row a reader; `figure` is inputs per second, the note counts outcomes and tells the first finding."""
    rows = []
    for name, found in every.items():
        total = sum(found.counts.values())
        note = f"{found.counts[REFUSED]} refused, {found.counts[ACCEPTED]} accepted"
        if found.findings:
            number, outcome, words = found.findings[0]
            note += f"; {len(found.findings)} findings, first {outcome} at number {number}, seed {seed}: {words}"
        rows.append({
            "case": "hostile files", "component": name, "count": total, "passed": not found.findings,
            "figure": total / max(found.seconds, 1e-9), "note": note,
        })
    return rows
