"""Every numbered hard case for every registered model, solver, reader, writer and the renderer; and that none is left out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.hard_cases import table
from tests.hard_cases.components import KINDS, NotHere, Room
from tests.hard_cases.table import NOT_YET_CHECKED, TABLE, TITLES, Entry, Row, entries, measured, summary

from torchmat.fitting.recipe import RECIPES, Recipe
from torchmat.models import MATERIALS, Texture
from torchmat.models.storage import STORAGES

LISTED = Path(__file__).resolve().parents[3] / "shared" / "HARD_CASES.md"
EVERY = list(entries())


@pytest.mark.parametrize("entry", EVERY, ids=[entry.label for entry in EVERY])
def test_hard(entry, tmp_path):
    room = tmp_path / "room"
    room.mkdir()
    try:
        figure = entry.row.check(entry.component.given, Room(room))
    except NotHere as missing:
        pytest.skip(str(missing))
    assert (figure is not None) == bool(entry.row.figure), "a figure has a name, and a name a figure"


def test_all_cases_stand_in_the_table_with_a_check_or_a_reason_for_every_kind():
    assert list(TABLE) == list(TITLES) == list(range(1, 19))
    for kinds in TABLE.values():
        assert set(kinds) == set(KINDS)
        assert all(isinstance(row, Row) or len(row) > 10 for row in kinds.values())
        assert any(isinstance(row, Row) for row in kinds.values()), "a case that nothing meets"


def test_the_cases_are_those_of_the_list():
    if not LISTED.exists():
        pytest.skip("the list of hard cases is not on this machine")
    numbers = [int(found) for found in re.findall(r"^(\d+)\. ", LISTED.read_text("utf-8"), re.MULTILINE)]
    assert numbers == [*TITLES, *NOT_YET_CHECKED]


def test_everything_registered_is_in_the_table():
    of_kind = {kind: {entry.component.name for entry in EVERY if entry.component.kind == kind} for kind in KINDS}
    models = {entry.component.given[0] for entry in EVERY if entry.component.kind == "model"}
    assert models == set(MATERIALS) == set(RECIPES)
    assert of_kind["solver"] == {f"{model}-{solver}" for model, recipe in RECIPES.items() for solver in recipe.all_solvers}
    assert {f"folder, {storage}" for storage in STORAGES} < of_kind["writer"]
    assert {".3pm", "packed, 8 bits", "relief, 16", "picture", "report"} < of_kind["writer"]
    assert len({entry.label for entry in EVERY}) == len(EVERY)


def _new_model(monkeypatch):
    class Added(Texture):
        name = "added"

    monkeypatch.setitem(MATERIALS, "added", Added)
    return Added


def test_a_model_is_covered_as_soon_as_it_is_registered(monkeypatch, tmp_path):
    kind = _new_model(monkeypatch)
    monkeypatch.setitem(RECIPES, "added", Recipe(kind, lambda training: None, descends=False))
    found = [entry for entry in entries() if entry.component.name.startswith("added")]
    cases = {kind: {case for case, rows in TABLE.items() if isinstance(rows[kind], Row)} for kind in KINDS}
    assert {entry.case for entry in found if entry.component.kind == "model"} == cases["model"]
    assert {entry.case for entry in found if entry.component.kind == "solver"} == cases["solver"]
    for entry in found:
        if entry.component.kind == "model" and entry.case < 8:
            entry.row.check(entry.component.given, Room(tmp_path))


def test_a_model_that_breaks_a_case_fails_it(monkeypatch, tmp_path):
    model = _new_model(monkeypatch)
    monkeypatch.setattr(model, "value", lambda self, light, view: self.maps["albedo"] / (light - view)[..., 2:3, :, :])
    row = measured(next(entry for entry in entries() if entry.component.name == "added"), Room(tmp_path))
    assert row["passed"] is False and "finite" in row["note"]


def test_the_summary_counts_and_names_the_worst():
    rows = [
        {"case": 1, "kind": "model", "component": name, "passed": passed, "figure": figure, "unit": "", "note": ""}
        for name, passed, figure in (("a", True, 6.0), ("b", False, None), ("c", True, 4.5), ("d", None, None))
    ]
    found = next(row for row in summary(rows) if (row["case"], row["kind"]) == (1, "model"))
    assert (found["passed"], found["skipped"], found["count"]) == (2, 1, 4)
    assert (found["figure"], found["component"]) == (4.5, "c")
    assert next(row for row in summary(rows) if (row["case"], row["kind"]) == (1, "writer"))["reason"] == table._NO_MAPS


def test_what_is_not_permitted_here_is_no_failure(tmp_path):
    def missing(given, room):
        raise NotHere("no disk")

    entry = Entry(1, EVERY[0].component, Row(missing))
    assert measured(entry, Room(tmp_path))["passed"] is None
