"""Memory and time do not grow over many runs; the short form of `long_runs`."""

from __future__ import annotations

from tests.hard_cases import long_runs


def test_fits_and_renders_leave_no_memory_behind():
    for row in long_runs.run(60):
        assert row["figure"] <= long_runs.MOST_GROWTH_MB, row


def test_what_is_kept_would_be_found():
    kept = []
    # Blocks of that size are new memory always: smaller ones may fit into what earlier work has left.
    row = long_runs.repeated("kept", lambda number: kept.append(b"x" * 40_000_000), 10)
    assert not row["passed"] and row["figure"] > long_runs.MOST_GROWTH_MB
