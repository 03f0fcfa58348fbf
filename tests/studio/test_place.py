"""Folders, locks and settings: what is outside stays outside, and nothing is left stuck."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from torchmat.errors import DataError, RangeError
from torchmat.studio.lock import Held, Lock
from torchmat.studio.place import check_links, inside, pictures_in, place_of
from torchmat.studio.settings import load_settings


@pytest.fixture
def folder(tmp_path):
    found = tmp_path / "wool"
    found.mkdir()
    (found / "manifest.json").write_text('{"format": "torchmat-material"}')
    (found / "diffuse.png").write_bytes(b"x")
    return found


def test_what_is_its_own_stands_beside_the_folder_and_nothing_in_it(folder):
    place = place_of(folder)
    assert place.own == folder.parent / ".wool.studio" and place.writable
    assert sorted(os.listdir(folder)) == ["diffuse.png", "manifest.json"]
    with pytest.raises(DataError, match="manifest must exist; it is not there"):
        place_of(folder.parent)
    (folder / "manifest.json").write_text('{"format": "other"}')
    with pytest.raises(DataError, match="format must be 'torchmat-material'"):
        place_of(folder)


def test_a_folder_that_cannot_be_written_is_looked_at(folder, monkeypatch):
    from torchmat.studio import place as module

    monkeypatch.setattr(module, "_can_write", lambda path: False)  # root may write anywhere
    place = place_of(folder)
    assert not place.writable and place.own.is_dir() and str(place.own).startswith(os.environ["TORCHMAT_CACHE"])


@pytest.mark.parametrize("name", ["..", "../x", "/etc/passwd", "a/b", "a\\b", "", ".", ".hidden", "a\0b", "link.png", "away.png"])
def test_only_plain_files_of_the_folder_are_inside(folder, name):
    (folder.parent / "secret.png").write_bytes(b"s")
    (folder / "link.png").symlink_to(folder.parent / "secret.png")
    (folder / "away.png").symlink_to("/dev/zero")
    assert inside(folder, name) is None
    assert inside(folder, "diffuse.png") == folder / "diffuse.png"
    assert pictures_in(folder) == ["diffuse.png"]
    with pytest.raises(DataError, match="must lie in the folder; it leads elsewhere"):
        check_links(folder, ["diffuse.png", "link.png"])


def test_a_second_lock_is_told_where_the_first_answers_and_a_killed_one_leaves_nothing_stuck(folder):
    own = place_of(folder).own
    code = (
        "import sys, pathlib\nfrom torchmat.studio.lock import Lock\n"
        f"lock = Lock(pathlib.Path({str(own)!r}), pathlib.Path('wool')); lock.say('http://here')\n"
        "print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as first:
        assert first.stdout.readline() == b"held\n"
        with pytest.raises(Held, match=f"process {first.pid} has it open") as held:
            Lock(own, folder)
        assert held.value.address == "http://here"
        first.kill()
        first.wait()
        Lock(own, folder).release()


def test_settings_come_back_and_damaged_ones_are_the_usual_ones_and_said(folder):
    own = place_of(folder).own
    settings, wrong = load_settings(own)
    settings.follow("fresnel", False, {"fresnel": "fresnel.png"})
    settings.remember({"camera": [1, 2]})
    settings.save(own)
    again, wrong = load_settings(own)
    assert (again.still, again.look, wrong) == (["fresnel"], {"camera": [1, 2]}, "")
    for text in ("", "[]", '{"still": [1]}', '{"other": 1}', '{"still": 3}', "{" * 10_000):
        (own / "settings.json").write_text(text)
        usual, wrong = load_settings(own)
        assert (usual.still, usual.look) == ([], {}) and "damaged" in wrong
    with pytest.raises(RangeError, match="be a small table"):
        settings.remember({"x": "y" * 100_000})
    with pytest.raises(RangeError, match="the texture must be one of"):
        settings.follow("none", True, {"fresnel": "fresnel.png"})
