"""The short form of the hostile files, and proof that the fuzzer sees what it looks for."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from random import Random

import numpy as np
import pytest
from tests.hard_cases import fuzz_worker
from tests.hard_cases.faults import misbehave
from tests.hard_cases.fuzz import Found, fuzz, rows_of
from tests.hard_cases.fuzz_readers import READERS, Reader
from tests.hard_cases.fuzz_worker import ACCEPTED, REFUSED, Judge, mutated, put_tree, tree_of
from tests.hard_cases.mutate import cut, flip
from tests.hard_cases.mutate_formats import png_chunks, png_of
from tests.hard_cases.worker import CRASH, HANG, Worker

from torchmat import DataError

SHORT = 12  # inputs for each reader


def test_hostile_files():
    found = fuzz(SHORT * len(READERS), seed=0)
    findings = [(name, *finding) for name, one in found.items() for finding in one.findings]
    assert findings == []
    assert all(sum(one.counts.values()) == SHORT for one in found.values())
    total = {outcome: sum(one.counts[outcome] for one in found.values()) for outcome in (ACCEPTED, REFUSED)}
    assert min(total.values()) > 0.1 * SHORT * len(READERS), "mutations that all load, or never do, test nothing"


def test_a_row_tells_what_was_found():
    good, bad = Found(seconds=2.0), Found()
    for number, outcome in enumerate((REFUSED, REFUSED, ACCEPTED)):
        good.add(number, outcome, "")
    bad.add(7, "hang", "more than 60 s")
    rows = rows_of({"a": good, "b": bad}, seed=5)
    assert rows[0] == {
        "case": "hostile files", "component": "a", "count": 3, "passed": True, "figure": 1.5,
        "note": "2 refused, 1 accepted",
    }
    assert not rows[1]["passed"]
    assert rows[1]["note"] == "0 refused, 0 accepted; 1 findings, first hang at number 7, seed 5: more than 60 s"


def test_a_process_that_dies_or_hangs_is_replaced(tmp_path):
    worker = Worker(misbehave, tmp_path, wall_seconds=1.0)
    assert worker.ask("a") == ("fine", "a")
    assert worker.ask("die")[0] == CRASH
    assert worker.ask("b") == ("fine", "b")
    assert worker.ask("sleep")[0] == HANG
    assert worker.ask("c") == ("fine", "c")
    worker.close()


@pytest.fixture
def judge(tmp_path, monkeypatch):
    """A judge whose folder and environment end with the test."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", None)
    for name in ("HOME", "TORCHMAT_CACHE"):
        monkeypatch.setenv(name, str(tmp_path))
    return Judge(tmp_path / "room")


def _put(folder):
    (folder / "a.txt").write_bytes(b"good" * 10)
    return folder / "a.txt"


def _refuse_with(words):
    def read(path):
        if path.is_file() and path.read_bytes() == b"good" * 10:
            return ["good"]
        raise DataError(words.format(path=path))

    return read


def _on_change(act):
    """Return a reader that is fine with the good file and does `act` with any other."""
    return lambda path: ["good"] if path.is_file() and path.read_bytes() == b"good" * 10 else act(path)


def _raise(error):
    raise error


FAULTS = {
    REFUSED: _refuse_with("{path}: bad"),
    "names no file": _refuse_with("bad"),
    "KeyError": _on_change(lambda path: _raise(KeyError("a"))),
    "RecursionError": _on_change(lambda path: _raise(RecursionError("deep"))),
    "RuntimeWarning": _on_change(lambda path: [np.float32(1) / np.zeros(1, np.float32)]),
    "slow": _on_change(lambda path: _raise(_late(path))),
    "memory": _on_change(lambda path: ["good"] if np.ones(20_000_000).all() else []),
    "files left": _on_change(lambda path: ["good"] if Path("left.txt").write_text("a") else []),
    "another result": _on_change(lambda path: ["bad"]),
    "unsound": _on_change(lambda path: _raise(AssertionError("not unit"))),
    ACCEPTED: lambda path: ["good"],
}


def _late(path):
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass
    return DataError(f"{path}: bad")


@pytest.mark.parametrize("outcome", FAULTS)
def test_what_is_wrong_is_seen(outcome, judge, monkeypatch):
    if outcome == "memory" and not os.access("/proc/self/clear_refs", os.W_OK):
        pytest.skip("this system does not tell the peak of memory")
    if outcome == "slow":
        monkeypatch.setattr(fuzz_worker, "SECONDS", 0.15)
    exact = ("cut", "flip", "in_table", "in_bytes", "folder")
    monkeypatch.setitem(fuzz_worker.BY_NAME, "fault", Reader("fault", _put, FAULTS[outcome], exact=exact))
    outcomes = {judge("fault", number, 0)[0] for number in range(4)}
    assert outcomes <= {outcome, ACCEPTED} and outcome in outcomes


def test_the_same_number_makes_the_same_bytes(tmp_path):
    for reader in READERS[:6]:
        folder = tmp_path / reader.name
        folder.mkdir()
        reader.put(folder)
        good = tree_of(folder)
        made = [mutated(reader, good, Random(f"0/{reader.name}/{number}")) for number in (3, 3, 4)]
        assert made[0] == made[1] != made[2]


def test_a_tree_is_written_as_it_was_read(tmp_path):
    (tmp_path / "one" / "sub").mkdir(parents=True)
    (tmp_path / "one" / "sub" / "a").write_bytes(b"a")
    (tmp_path / "one" / "link").symlink_to("sub")
    put_tree(tmp_path / "two", tree_of(tmp_path / "one"))
    assert tree_of(tmp_path / "two") == tree_of(tmp_path / "one")


def test_cutting_and_flipping_always_change_something():
    data = bytes(range(50))
    for seed in range(50):
        assert data.startswith(cut(data, Random(seed))) and len(cut(data, Random(seed))) < 50
        assert sum((a ^ b).bit_count() for a, b in zip(data, flip(data, Random(seed)), strict=True)) == 1


def test_a_png_put_together_again_is_the_same(tmp_path):
    from tests.btf.files import put_image, random_codes

    data = put_image(tmp_path / "a.png", random_codes(0)).read_bytes()
    assert png_of(png_chunks(data)) == data
