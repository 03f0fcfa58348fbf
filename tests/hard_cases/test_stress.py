"""The long form: its parts work with few inputs, what it writes can be read again, and what fails is named."""

from __future__ import annotations

from tests.hard_cases import parts, stress_report
from tests.hard_cases.parts import PARTS, Settings

ROW = {"case": 1, "kind": "model", "component": "a", "count": 1, "passed": True, "figure": 5.0, "unit": "digits", "note": ""}


def _part(*rows):
    return {"seconds": 1.0, "share": 1.0, "seed": 1, "rows": list(rows)}


def _sound(rows):
    assert all({"case", "component", "count", "passed", "figure", "note"} <= set(row) for row in rows)
    assert [row for row in rows if row["passed"] is False] == []


def test_a_cache_on_a_full_disk_brings_the_images_or_says_so():
    row = parts._tried("full disk", "cache", 4, lambda room: parts.cache_on_a_full_disk(room, range(0, 64, 16)))
    _sound([row])
    assert row["passed"] is None or row["figure"] is not None


def test_a_digest_is_compared_in_every_way(monkeypatch):
    from tests.hard_cases import digests

    one = {"ptm": {"digest": "a", "numbers": [0.1, 0.2, 0.3]}}
    monkeypatch.setattr(digests, "stored", lambda: {"numbers": {"ptm": [0.1, 0.2, 0.3]}, "digests": {}})
    monkeypatch.setattr(digests, "results", lambda cached=False: one)
    monkeypatch.setattr(digests, "in_fresh_process", lambda threads, cached: {"ptm": {**one["ptm"], "digest": "b" if cached else "a"}})
    rows = list(PARTS["digests"](Settings(None)))
    assert [row["passed"] for row in rows] == [True, True, True, True, False] and rows[-1]["note"] == "ptm"


def test_a_share_of_the_inputs_is_never_nothing():
    assert Settings(None, 0.5).count(2000) == 1000 and Settings(None, 1e-6).count(2000, 5) == 5


def test_what_is_written_is_read_again_and_failures_are_named(tmp_path):
    failed = {**ROW, "component": "b", "passed": False, "figure": None, "note": "AssertionError: a value is not finite"}
    skipped = {**ROW, "case": "full disk", "passed": None, "figure": None}
    written = {"table": _part(ROW, failed), "disks": _part(skipped)}
    stress_report.write(tmp_path, written, {"cores": 2})
    assert stress_report.read(tmp_path) == written
    text = (tmp_path / "hard_cases.md").read_text("utf-8")
    assert "| 1. equal, opposite and grazing directions | 1/2; 5 digits of float32, a |" in text
    assert "| disks | 1 | 0/1, 1 not permitted | - | 1 |" in text
    assert stress_report.failures(written) == ["table: 1, b, figure None: AssertionError: a value is not finite"]
    assert stress_report.read(tmp_path / "nowhere") == {}


def test_a_share_is_said(tmp_path):
    assert "| fuzz (a share of 0.5) | 1 | 1/1 |" in stress_report.markdown({"fuzz": {**_part(ROW), "share": 0.5}})


def test_a_check_that_breaks_is_a_row(tmp_path):
    def act(room):
        raise ValueError("broken")

    row = parts._tried("full disk", "a", 3, act)
    assert row["passed"] is False and row["note"] == "ValueError: broken"
