"""Every state comes back, whoever saved it; a crash, a full history and a damaged one lose nothing that is not said."""

from __future__ import annotations

import json
import os

import pytest

from torchmat import swap
from torchmat.studio.history import History

NAMES = ("manifest.json", "a.png", "b.png")


@pytest.fixture
def folder(tmp_path):
    found = tmp_path / "wool"
    found.mkdir()
    for name in NAMES:
        (found / name).write_text(f"first {name}")
    (found / "notes.txt").write_text("mine")
    (tmp_path / "own").mkdir()
    return found


def history(folder, **bounds):
    return History(folder, folder.parent / "own", lambda: NAMES, **bounds)


def texts(folder):
    return {name: (folder / name).read_text() for name in sorted(os.listdir(folder))}


def test_undo_and_redo_bring_every_state_back_and_touch_nothing_else(folder):
    past = history(folder)
    states = [texts(folder)]
    assert past.take("opened") and not past.take("again")
    for number, name in enumerate(("a.png", "b.png", "a.png")):
        (folder / name).write_text(f"edit {number}")
        assert past.take(f"saved {name}")
        states.append(texts(folder))
    (folder / "b.png").unlink()
    assert past.take("without b")
    for number in (3, 0, 4, 1):
        past.back_to(past.states[number])
        wanted = states[number] if number < 4 else {name: text for name, text in states[3].items() if name != "b.png"}
        assert texts(folder) == wanted and past.at == number
    again = history(folder)
    assert [one.what for one in again.states] == ["opened", "saved a.png", "saved b.png", "saved a.png", "without b"]
    assert again.at == 1 and not again.take("nothing new")


def test_what_was_not_seen_before_an_undo_is_kept_and_what_was_undone_stays(folder):
    past = history(folder)
    past.take("opened")
    (folder / "a.png").write_text("seen")
    past.take("saved")
    (folder / "a.png").write_text("not seen")

    assert past.back_to(past.states[0]) == ["a.png"]
    assert (folder / "a.png").read_text() == "first a.png"
    (folder / "a.png").write_text("another way")
    past.take("saved anew")
    found = []
    for state in list(past.states):
        past.back_to(state)
        found.append((folder / "a.png").read_text())
    assert found == ["first a.png", "seen", "not seen", "first a.png", "another way"]


def test_states_and_bytes_are_bounded_and_only_named_contents_stay(folder):
    past = history(folder, most_states=5)
    for number in range(40):
        (folder / "a.png").write_text(f"{number:06d}" * 100)
        past.take(f"save {number}")
    assert len(past.states) == 5 and past.at == 4
    assert len(os.listdir(folder.parent / "own" / "content")) == 2 + 5
    small = History(folder, folder.parent / "own", lambda: NAMES, most_bytes=1500)
    (folder / "a.png").write_text("x" * 600)
    small.take("one more")
    assert len(small.states) == 2 and small.at == 1
    small.back_to(small.states[0])
    assert (folder / "a.png").read_text() == "000039" * 100


def test_a_damaged_journal_begins_anew_and_a_lost_content_drops_its_states_only(folder):
    past = history(folder)
    past.take("opened")
    (folder / "a.png").write_text("second")
    past.take("saved")
    (folder / "a.png").write_text("third")
    past.take("saved")
    content = folder.parent / "own" / "content" / past.states[1].files["a.png"]
    content.unlink()
    again = history(folder)
    assert len(again.states) == 2 and again.at == 1
    for text in ("", "[1]", '{"at": 0}', '{"at": "x", "states": []}', '{"at": 5, "states": [{"files": 3}]}'):
        (folder.parent / "own" / "history.json").write_text(text)
        assert history(folder).states == []
    journal = {"at": 0, "states": [{"files": {"../../x": "../../../etc/passwd"}, "when": 0, "what": ""}]}
    (folder.parent / "own" / "history.json").write_text(json.dumps(journal))
    assert history(folder).states == []  # a digest is a plain name


@pytest.mark.parametrize("way", ["in place", "by rename", "a new file"])
def test_what_another_program_saves_while_files_are_replaced_is_carried_over(folder, way):
    before = (folder / "a.png").stat().st_ino
    with swap.swapping(folder, ["b.png"]) as building:
        (building / "b.png").write_text("ours")
        if way == "in place":
            (folder / "a.png").write_text("theirs")
        elif way == "by rename":
            (folder / "partial").write_text("theirs")
            os.replace(folder / "partial", folder / "a.png")
        else:
            (folder / "new.png").write_text("theirs")
    found = texts(folder)
    assert found["b.png"] == "ours" and found["notes.txt"] == "mine"
    assert found["new.png" if way == "a new file" else "a.png"] == "theirs"
    assert way != "in place" or (folder / "a.png").stat().st_ino == before
    assert os.listdir(folder.parent) == ["wool", "own"] or sorted(os.listdir(folder.parent)) == ["own", "wool"]


def test_a_save_of_a_file_that_is_replaced_meanwhile_wins_and_an_error_changes_nothing(folder):
    with swap.swapping(folder, ["b.png"]) as building:
        (building / "b.png").write_text("ours")
        (folder / "b.png").write_text("theirs, later")
    assert (folder / "b.png").read_text() == "theirs, later"
    before = texts(folder)
    with pytest.raises(ZeroDivisionError), swap.swapping(folder, ["a.png"]) as building:
        (building / "a.png").write_text("half")
        raise ZeroDivisionError
    assert texts(folder) == before
