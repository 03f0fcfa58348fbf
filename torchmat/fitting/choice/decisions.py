"""The log of the automatic choice: what was tried, what it cost and brought, and what was made of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from torchmat.fitting.choice.measured import Measured

KEPT, LEFT, SKIPPED = "kept", "left", "skipped"


def gain_db(before: float, after: float) -> float:
    """Return by how many dB an error that adds up has fallen."""
    return 10 * math.log10(max(before, 1e-20) / max(after, 1e-20))


@dataclass
class Decisions:
    """Rows of one choice; `seconds` tells the time since it began."""

    seconds: Callable[[], float]
    rows: list[dict[str, Any]] = field(default_factory=list)
    _best: tuple[float, float] | None = None  # cost and bytes of the truest so far

    def skip(self, candidate: str, why: str) -> None:
        """Note a candidate that was not tried."""
        self.rows.append({"candidate": candidate, "decision": SKIPPED, "why": why, "at_seconds": self.seconds()})

    def note(self, what: str, why: str, seconds: float) -> None:
        """Note a step that is no candidate by itself."""
        row = {"candidate": what, "decision": KEPT, "why": why, "seconds": seconds, "at_seconds": self.seconds()}
        self.rows.append(row)

    def tried(
        self, candidate: str, bytes: float, measured: Measured, cost: float, seconds: float, kept: bool, why: str
    ) -> None:
        """Note a candidate that was fitted, its gain against the truest before it, for each byte and second more."""
        row = {
            "candidate": candidate, "decision": KEPT if kept else LEFT, "why": why, "bytes": bytes,
            **measured._asdict(), "seconds": seconds, "at_seconds": self.seconds(),
        }
        if self._best is not None:
            gain = gain_db(self._best[0], cost)
            row |= {"gain_db": gain, "gain_db_per_second": gain / max(seconds, 1e-6)}
            more = bytes - self._best[1]
            row["gain_db_per_byte"] = gain / more if more > 0 else None
        if self._best is None or cost < self._best[0]:
            self._best = (cost, bytes)
        self.rows.append(row)
