"""Saves are seen however a program makes them, and a folder that takes the place of another is followed."""

from __future__ import annotations

import asyncio
import os
import time

import pytest

from torchmat import swap
from torchmat.studio.watch import Watch

NAMES = ("a.png", "b.png")
pytest.importorskip("watchfiles")


def seen(folder, act, wanted):
    """Return the seconds from the start of `act` until a watch has seen all of `wanted`."""
    async def watch():
        eye = Watch(folder, lambda: NAMES)
        found: set[str] = set()
        began = None

        async def later():
            nonlocal began
            await asyncio.sleep(0.3)  # until the system's notices are asked for
            began = time.perf_counter()
            await asyncio.to_thread(act)

        acting = asyncio.create_task(later())
        async for names in eye.changes():
            found |= set(names)
            if found >= wanted:
                eye.stop()
        await acting
        return time.perf_counter() - began

    return asyncio.run(asyncio.wait_for(watch(), 10))


@pytest.fixture
def folder(tmp_path):
    found = tmp_path / "wool"
    found.mkdir()
    for name in NAMES:
        (found / name).write_text("first")
    return found


def by_rename(path, text):
    partial = path.with_suffix(".part")
    partial.write_text(text)
    os.replace(partial, path)


def test_saves_in_place_by_rename_and_by_a_new_folder_are_seen(folder):
    def replaced():
        swap.replace_files(folder, {"b.png": folder / "a.png"})

    def then_in_the_new_one():
        replaced()
        time.sleep(0.2)
        (folder / "a.png").write_text("in the new folder")

    assert seen(folder, lambda: (folder / "a.png").write_text("second"), {"a.png"}) < 2
    assert seen(folder, lambda: by_rename(folder / "b.png", "second"), {"b.png"}) < 2
    assert seen(folder, replaced, {"b.png"}) < 2
    assert seen(folder, then_in_the_new_one, {"a.png", "b.png"}) < 2
    assert seen(folder, (folder / "a.png").unlink, {"a.png"}) < 2


def test_a_look_sees_what_no_notice_told_of_and_what_is_forgotten(folder, monkeypatch):
    from torchmat.studio import watch as module

    def none(*_):
        raise OSError("no more notices to be had")

    monkeypatch.setattr(module, "_events", none)
    monkeypatch.setattr(module, "_LOOK", 0.1)
    assert seen(folder, lambda: (folder / "a.png").write_text("second"), {"a.png"}) < 2
    eye = Watch(folder, lambda: NAMES)
    assert eye.look() == []
    eye.forget("b.png")
    assert eye.look() == ["b.png"]
