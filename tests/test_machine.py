"""What a report says of the process: memory that a piece of work takes, beside that of the whole process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from torchmat import machine
from torchmat.machine import MemoryMark, peak_memory_mb

linux = pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the system keeps no high-water mark")
_MB = 40


def _take(megabytes: int) -> None:
    block = np.ones(megabytes * 125_000)
    assert block[-1] == 1


@linux
def test_the_memory_of_a_piece_of_work_is_its_own():
    _take(3 * _MB)  # an earlier peak that is none of its business
    before = peak_memory_mb()
    mark = MemoryMark()
    assert mark.taken_mb < _MB / 4
    _take(_MB)
    assert 0.95 * _MB < mark.taken_mb < 1.4 * _MB
    assert peak_memory_mb() >= before  # the whole process' own peak is not forgotten


@linux
def test_memory_that_is_held_already_is_not_counted():
    held = np.ones(_MB * 125_000)
    mark = MemoryMark()
    _take(_MB // 4)
    assert mark.taken_mb < _MB / 2 and held[0] == 1


@pytest.mark.parametrize("absent", ["VmHWM", "VmRSS"])
def test_without_the_kernels_account_nothing_is_said(monkeypatch, absent):
    known = machine._status_mb
    monkeypatch.setattr(machine, "_status_mb", lambda name: None if name == absent else known(name))
    assert MemoryMark().taken_mb is None
    assert peak_memory_mb() > 0
