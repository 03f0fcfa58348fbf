"""The clock of a fit: what counts as its time, when it must stop, and its error as it went on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any


_FIRST, _GROWTH = 0.02, 1.25  # seconds until the curve's first point, and from each to the next


class Watch:
    """Counts a fit's seconds, apart from those spent on measuring it.

    `limit` is after how many seconds an iterative solver must stop, with its best so far and the reason "budget spent";
    `measure` gives the error of a material on samples that the fit never sees, which makes `history` a curve of
    (seconds, error). Points grow apart with time, so that measuring never costs more than fitting.
    """

    def __init__(self, limit: float = math.inf, measure: Callable[[Any], float] | None = None) -> None:
        self.limit = limit
        self.history: list[tuple[float, float]] = []
        self._measure = measure
        self._start = time.perf_counter()
        self._outside = 0.0
        self._next = _FIRST

    def restart(self) -> None:
        """Begin to count anew; the curve so far is forgotten."""
        self._start, self._outside, self._next, self.history = time.perf_counter(), 0.0, _FIRST, []

    @property
    def seconds(self) -> float:
        """Seconds of work so far."""
        return time.perf_counter() - self._start - self._outside

    @property
    def spent(self) -> bool:
        """Whether the limit has been reached."""
        return self.seconds >= self.limit

    @property
    def due(self) -> bool:
        """Whether the curve wants a point: solvers then call `note` with what they have."""
        return self._measure is not None and self.seconds >= self._next

    def note(self, material: Callable[[], Any]) -> None:
        """Measure the material that `material` makes, off the clock, and add a point to the curve."""
        if self._measure is None:
            return
        seconds = self.seconds
        before = time.perf_counter()
        self.history.append((seconds, self._measure(material())))
        self._outside += time.perf_counter() - before
        self._next = seconds * _GROWTH
