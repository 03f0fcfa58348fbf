"""Folders that appear whole or not at all."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from torchmat import DataError, atomic


def write(folder, text):
    (folder / "file.txt").write_text(text, encoding="utf-8")


def content(folder):
    return {path.name: path.read_text("utf-8") for path in folder.iterdir()}


def build(target, text="new"):
    with atomic.building(target) as folder:
        write(folder, text)


def dead_process():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


NAMES = ["plain", "with spaces", "grün-мох-苔", "a [v2]*?", "-dash", "dot.ted"]


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_appears_and_is_replaced(name, tmp_path):
    target = tmp_path / "deep" / name
    build(target, "old")
    assert content(target) == {"file.txt": "old"}
    build(target, "new")
    assert content(target) == {"file.txt": "new"}
    assert [path.name for path in target.parent.iterdir()] == [name]


def test_the_target_is_not_there_before_the_end(tmp_path):
    with atomic.building(tmp_path / "out") as folder:
        write(folder, "new")
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, DataError])
def test_an_error_inside_leaves_the_old_and_no_rest(error, tmp_path):
    target = tmp_path / "out"
    build(target, "old")
    with pytest.raises(error), atomic.building(target) as folder:
        write(folder, "half")
        raise error("stop")
    assert content(target) == {"file.txt": "old"} and len(list(tmp_path.iterdir())) == 1


def test_an_os_error_inside_names_the_folder(tmp_path):
    target = tmp_path / "out"
    build(target, "old")
    with pytest.raises(DataError, match=r"out: the folder must be written whole.*No space.*untouched"):
        with atomic.building(target):
            raise OSError(28, "No space left on device")
    assert content(target) == {"file.txt": "old"} and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("name", NAMES)
def test_rests_of_dead_builders_are_swept_and_others_stay(name, tmp_path):
    stale = tmp_path / f".{name}.building-{dead_process()}-abc"
    alive = tmp_path / f".{name}.building-{os.getpid()}-abc"
    other = tmp_path / f".other.building-{dead_process()}-abc"
    for folder in (stale, alive, other):
        folder.mkdir()
        write(folder, "half")
    build(tmp_path / name)
    assert not stale.exists() and alive.exists() and other.exists()


def test_without_an_exchange_the_old_is_moved_aside(tmp_path, monkeypatch):
    monkeypatch.setattr(atomic, "_exchange", lambda first, second: False)
    build(tmp_path / "out", "old")
    build(tmp_path / "out", "new")
    assert content(tmp_path / "out") == {"file.txt": "new"} and len(list(tmp_path.iterdir())) == 1


def test_a_failing_second_rename_brings_the_old_back(tmp_path, monkeypatch):
    build(tmp_path / "out", "old")
    monkeypatch.setattr(atomic, "_exchange", lambda first, second: False)
    rename = os.rename

    def failing(source, target):
        if str(target) == str(tmp_path / "out") and not str(source).endswith("-old"):
            raise OSError(5, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(os, "rename", failing)
    with pytest.raises(DataError, match="written whole"):
        build(tmp_path / "out", "new")
    assert content(tmp_path / "out") == {"file.txt": "old"} and len(list(tmp_path.iterdir())) == 1


def test_an_old_folder_set_aside_by_a_killed_builder_comes_back(tmp_path):
    aside = tmp_path / f".out.building-{dead_process()}-abc-old"
    aside.mkdir()
    write(aside, "old")
    with pytest.raises(RuntimeError), atomic.building(tmp_path / "out"):
        raise RuntimeError("the new one fails as well")
    assert content(tmp_path / "out") == {"file.txt": "old"} and len(list(tmp_path.iterdir())) == 1


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "disk").mkdir()
    build(tmp_path / "disk" / "real", "old")
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "disk" / "real")
    build(link, "new")
    assert link.is_symlink() and content(tmp_path / "disk" / "real") == {"file.txt": "new"}
    assert len(list(tmp_path.iterdir())) == 2 and len(list((tmp_path / "disk").iterdir())) == 1


def test_a_path_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    with pytest.raises(DataError, match=r"file/out: the folder must be writable"):
        build(tmp_path / "file" / "out")
    assert (tmp_path / "file").read_text("utf-8") == "mine"


def test_files_below_are_asked_for_by_their_relative_names(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "mine.txt").write_text("mine")
    (tmp_path / "ours.txt").write_text("ours")
    asked = []
    atomic.refuse_foreign(tmp_path, lambda name: asked.append(name) is None, "ours")
    assert asked == ["ours.txt", "sub/mine.txt"]
    with pytest.raises(DataError, match=r"1 of 2 files there are something else, first 'sub/mine\.txt'"):
        atomic.refuse_foreign(tmp_path, lambda name: name == "ours.txt", "ours")
    atomic.refuse_foreign(tmp_path / "absent", lambda name: False, "ours")
    with pytest.raises(DataError, match="it is a file"):
        atomic.refuse_foreign(tmp_path / "ours.txt", lambda name: True, "ours")


def test_a_file_appears_whole(tmp_path):
    target = tmp_path / "a b ü.bin"
    with atomic.building_file(target) as built:
        assert built.name == target.name
        built.write_bytes(b"new")
        assert not target.exists()
    assert target.read_bytes() == b"new" and [path.name for path in tmp_path.iterdir()] == [target.name]


def test_a_file_that_fails_leaves_the_old_one(tmp_path):
    target = tmp_path / "a.bin"
    target.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), atomic.building_file(target) as built:
        built.write_bytes(b"half")
        raise ZeroDivisionError
    with pytest.raises(DataError, match="a.bin: the file must be written whole"), atomic.building_file(target):
        pass  # nothing was built
    assert target.read_bytes() == b"old" and [path.name for path in tmp_path.iterdir()] == ["a.bin"]


def test_a_link_to_a_file_stays_a_link(tmp_path):
    (tmp_path / "real.bin").write_bytes(b"old")
    link = tmp_path / "link.bin"
    link.symlink_to(tmp_path / "real.bin")
    with atomic.building_file(link) as built:
        built.write_bytes(b"new")
    assert link.is_symlink() and (tmp_path / "real.bin").read_bytes() == b"new"


def test_a_file_where_none_can_be_is_an_error(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(DataError, match="must be writable"), atomic.building_file(tmp_path / "file" / "a.bin"):
        pass
    (tmp_path / "folder").mkdir()
    with pytest.raises(DataError, match="written whole"), atomic.building_file(tmp_path / "folder") as built:
        built.write_bytes(b"new")
    assert (tmp_path / "folder").is_dir()
