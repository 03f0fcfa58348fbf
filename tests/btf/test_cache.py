"""The decoded store: used again, made again when it should be, and never half there."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.btf.files import either_way, put_btf, put_image, put_manifest, random_codes, srgb_decoded, zipped
from tests.support import assert_close

from torchmat import Btf, DataError, RangeError, atomic, load_btf
from torchmat.btf import cache as cache_module
from torchmat.btf import pixels as pixels_module
from torchmat.errors import Notice


@pytest.fixture
def root(tmp_path) -> Path:
    """The cache folder that `own_cache` sets."""
    return tmp_path / "torchmat-cache"


def stores(root: Path) -> list[Path]:
    return sorted(path for path in root.iterdir()) if root.exists() else []


def everything(btf: Btf) -> tuple:
    """Return all that a load decides, in comparable form."""
    samples = range(len(btf))
    return (
        btf.images(samples).numpy().tobytes(), btf.weights(samples).numpy().tobytes(), btf.light.tolist(),
        btf.view.tolist(), btf.source.files, btf.source.kind, btf.encoding, btf.exposure, btf.clip_level,
        btf.value_range, btf.clipped_share, btf.invalid_share, btf.stored_dtype,
    )


def put_mixed(folder: Path) -> Path:
    """Write images of which one has a clipped and one an uncovered texel."""
    for seed in range(4):
        pixels = random_codes(seed, (3, 4, 4))
        pixels[..., 3] = 255
        pixels[0, 0, 0] = 255 if seed == 1 else 7
        pixels[1, 1, 3] = 0 if seed == 2 else 255
        put_image(folder / f"{seed}.png", pixels)
    return put_manifest(folder)


@either_way
@pytest.mark.parametrize("options", [{}, {"crop": (0, 0, 3, 3)}, {"downscale": 2}, {"lights": [0, 2]}])
def test_the_second_load_gives_the_same_bits(tmp_path, root, pack, options):
    path = pack(put_mixed(tmp_path / "wool"))
    first, second = load_btf(path, **options), load_btf(path, **options)
    assert (first.source.from_cache, second.source.from_cache) == (False, True)
    assert everything(first) == everything(second)
    assert first.clipped_share > 0 or first.invalid_share > 0
    assert len(stores(root)) == 1
    without = load_btf(path, cache=False, **options)
    assert not without.source.from_cache
    assert everything(without) == everything(first)


def test_two_threads_decode_as_one_does(tmp_path, monkeypatch):
    put_btf(tmp_path / "d")
    several = everything(load_btf(tmp_path / "d", cache=False))
    monkeypatch.setattr(pixels_module, "CHUNK", 1)
    assert everything(load_btf(tmp_path / "d", cache=False)) == several


def test_nothing_lies_beside_the_data(tmp_path):
    folder = put_btf(tmp_path / "data" / "d")
    load_btf(zipped(folder))
    load_btf(folder)
    assert sorted(path.name for path in (tmp_path / "data").iterdir()) == ["d", "d.zip"]
    assert len(list(folder.iterdir())) == 5


def test_no_cache(tmp_path, root):
    btf = load_btf(put_btf(tmp_path / "d"), cache=False)
    assert_close(btf.image(1), srgb_decoded(random_codes(1).transpose(2, 0, 1) / 255), 1e-6)
    assert not root.exists()


def test_a_cache_folder_of_ones_own(tmp_path, root):
    folder = put_btf(tmp_path / "d")
    for cache in (tmp_path / "here" / "and there", str(tmp_path / "here" / "and there")):
        load_btf(folder, cache=cache)
    assert len(stores(tmp_path / "here" / "and there")) == 1
    assert not root.exists()


def test_a_moved_cache_still_serves(tmp_path):
    folder = put_btf(tmp_path / "d")
    first = load_btf(folder, cache=tmp_path / "old")
    expected = everything(first)
    (tmp_path / "old").rename(tmp_path / "new")
    again = load_btf(folder, cache=tmp_path / "new")
    assert again.source.from_cache
    assert everything(again) == everything(first) == expected


@pytest.mark.parametrize("own, xdg, expected", [
    ("/a/b", "/x", "/a/b"), ("", "/x", "/x/torchmat"), (None, "/x", "/x/torchmat"),
    (None, "", "/home/me/.cache/torchmat"), (None, None, "/home/me/.cache/torchmat"),
])
def test_where_the_cache_lies(monkeypatch, own, xdg, expected):
    monkeypatch.setenv("HOME", "/home/me")
    for name, value in (("TORCHMAT_CACHE", own), ("XDG_CACHE_HOME", xdg)):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    assert cache_module.cache_folder(True) == Path(expected)
    assert cache_module.cache_folder(False) is None


def test_a_user_without_a_home(monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    for name in ("TORCHMAT_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    with pytest.raises(DataError, match="the cache folder must be known.*Set TORCHMAT_CACHE"):
        cache_module.cache_folder(True)


# What makes a store anew.


def test_a_changed_image(tmp_path, root):
    folder = put_btf(tmp_path / "d")
    before = load_btf(folder)
    old = before.image(2)
    put_image(folder / "2.png", random_codes(9))
    os.utime(folder / "2.png", ns=(1, 1))
    after = load_btf(folder)
    assert not after.source.from_cache
    assert_close(after.image(2), srgb_decoded(random_codes(9).transpose(2, 0, 1) / 255), 1e-6)
    assert torch.equal(before.image(2), old), "a Btf in use keeps its images"
    assert len(stores(root)) == 1


def test_a_changed_manifest_and_an_added_image(tmp_path):
    folder = put_btf(tmp_path / "d")
    load_btf(folder)
    put_image(folder / "4.png", random_codes(4))
    with open(folder / "manifest.csv", "a") as table:
        table.write("4.png,10,10,10,10\n")
    btf = load_btf(folder)
    assert (btf.source.from_cache, len(btf)) == (False, 5)


def test_a_removed_image(tmp_path):
    folder = put_btf(tmp_path / "d")
    load_btf(folder)
    (folder / "3.png").unlink()
    with pytest.raises(DataError, match="3.png"):
        load_btf(folder)


def test_a_changed_zip(tmp_path):
    folder = put_btf(tmp_path / "d")
    load_btf(zipped(folder))
    put_image(folder / "0.png", random_codes(8))
    archive = zipped(folder)
    os.utime(archive, ns=(5, 5))
    btf = load_btf(archive)
    assert not btf.source.from_cache
    assert_close(btf.image(0), srgb_decoded(random_codes(8).transpose(2, 0, 1) / 255), 1e-6)


def test_options_that_change_the_pixels_have_a_store_each(tmp_path, root):
    folder = put_btf(tmp_path / "d")
    choices = [
        {}, {"crop": (0, 0, 2, 2)}, {"crop": (1, 0, 2, 2)}, {"downscale": 2}, {"downscale": 2, "encoding": "linear"},
        {"invalid": "mask"}, {"duplicates": "keep"}, {"normalise": True},
    ]
    for count, options in enumerate(choices, 1):
        assert not load_btf(folder, **options).source.from_cache
        assert len(stores(root)) == count
    assert all(load_btf(folder, **options).source.from_cache for options in choices)


@pytest.mark.parametrize(
    "options", [{"encoding": "linear"}, {"exposure": 3.0}, {"clipped_weight": 1.0}, {"views": [0]}]
)
def test_options_that_leave_the_pixels_share_one(tmp_path, root, options):
    folder = put_btf(tmp_path / "d")
    load_btf(folder)
    shared = load_btf(folder, **options)
    assert shared.source.from_cache
    assert len(stores(root)) == 1
    assert everything(shared) == everything(load_btf(folder, cache=False, **options))


def test_two_sources_have_two_stores(tmp_path, root):
    for name, seed in (("a", 0), ("b", 5)):
        put_manifest(tmp_path / name, ["0.png"])
        put_image(tmp_path / name / "0.png", random_codes(seed))
    first, second = load_btf(tmp_path / "a"), load_btf(tmp_path / "b")
    assert len(stores(root)) == 2
    assert not torch.equal(first.image(0), second.image(0))


def test_one_source_by_two_paths_has_one_store(tmp_path, root, monkeypatch):
    put_btf(tmp_path / "d")
    load_btf(tmp_path / "d")
    monkeypatch.chdir(tmp_path)
    assert load_btf("d").source.from_cache
    assert load_btf(tmp_path / "d" / ".." / "d").source.from_cache


# Damage.


def truncate(path: Path, share: float = 0.5) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])


def edit_header(store: Path, **changes: object) -> None:
    header = json.loads((store / "header.json").read_text())
    (store / "header.json").write_text(json.dumps(header | changes))


def edit_table(store: Path, **changes: object) -> None:
    with np.load(store / "table.npz") as table:
        arrays = dict(table)
    np.savez(store / "table.npz", **(arrays | changes))


@pytest.mark.parametrize(
    "damage",
    [
        lambda store: truncate(store / "pixels.raw"),
        lambda store: (store / "pixels.raw").write_bytes(bytes((store / "pixels.raw").stat().st_size)),
        lambda store: (store / "pixels.raw").unlink(),
        lambda store: truncate(store / "flags.raw", 0),
        lambda store: (store / "flags.raw").unlink(),
        lambda store: (store / "table.npz").unlink(),
        lambda store: truncate(store / "table.npz"),
        lambda store: (store / "table.npz").write_text("no table"),
        lambda store: edit_table(store, light=np.zeros((2, 3))),
        lambda store: (store / "header.json").unlink(),
        lambda store: (store / "header.json").write_bytes(b"\xff\x00garbage"),
        lambda store: (store / "header.json").write_text("[1, 2]"),
        lambda store: edit_header(store, dtype="no type"),
        lambda store: edit_header(store, shape=None),
        lambda store: edit_header(store, shape=[4, 3, 4, 3.5]),
        lambda store: edit_header(store, format=99),
        lambda store: edit_header(store, fingerprint="other"),
        lambda store: shutil.rmtree(store),
    ],
)
def test_a_damaged_store_is_made_again(tmp_path, root, damage):
    folder = put_mixed(tmp_path / "d")
    expected = everything(load_btf(folder))
    damage(stores(root)[0])
    healed = load_btf(folder)
    assert not healed.source.from_cache
    assert everything(healed) == expected
    assert load_btf(folder).source.from_cache
    assert len(stores(root)) == 1


def test_an_unwritable_cache_folder_is_done_without_and_said(tmp_path):
    (tmp_path / "file").write_text("no folder")
    folder = put_btf(tmp_path / "d")
    with pytest.warns(Notice, match="file/cache: decoded images are not kept, since the cache cannot be written"):
        found = load_btf(folder, cache=tmp_path / "file" / "cache")
    assert everything(found) == everything(load_btf(folder, cache=False))
    assert (tmp_path / "file").read_text() == "no folder"


def test_a_cache_that_may_only_be_read_serves(tmp_path, root, monkeypatch):
    folder = put_btf(tmp_path / "d")
    load_btf(folder)

    def refuse(*_):
        raise PermissionError(errno.EACCES, "read-only")

    monkeypatch.setattr(os, "utime", refuse)
    assert load_btf(folder).source.from_cache


def test_too_little_room(tmp_path, root, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=100))
    said = pytest.warns(Notice, match="cannot be written .*have room for the decoded BTF")
    with said, pytest.raises(DataError, match="have room for the decoded BTF; .*GB are free. Free some space, move"):
        load_btf(put_btf(tmp_path / "d"))
    assert stores(root) == []


@pytest.mark.parametrize("cache", [True, False])
def test_a_full_disk_while_writing(tmp_path, root, monkeypatch, cache):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    folder = put_btf(tmp_path / "d")
    monkeypatch.setattr(np, "savez", full)
    said = pytest.warns(Notice, match="No space left on device") if cache else nullcontext()
    with said, pytest.raises(DataError, match="must be written whole; .*No space left on device.*Free some space"):
        load_btf(folder, cache=cache)
    assert stores(root) == []


@either_way
def test_a_failed_load_leaves_no_store_and_the_old_one_alone(tmp_path, root, pack):
    folder = put_btf(tmp_path / "d")
    expected = everything(load_btf(pack(folder)))
    kept = stores(root)
    saved = (folder / "2.png").read_bytes()
    (folder / "2.png").write_bytes(saved[:50])
    with pytest.raises(DataError, match="2.png"):
        load_btf(pack(folder))
    assert stores(root) == kept
    (folder / "2.png").write_bytes(saved)
    assert everything(load_btf(pack(folder))) == expected


@pytest.mark.parametrize("stop", [KeyboardInterrupt, MemoryError])
def test_an_interrupted_load_leaves_nothing(tmp_path, root, monkeypatch, stop):
    def interrupted(*_):
        raise stop

    monkeypatch.setattr(pixels_module, "read_picture", interrupted)
    with pytest.raises(stop):
        load_btf(zipped(put_btf(tmp_path / "d")))
    assert stores(root) == []


def ended_process() -> int:
    """Return the number of a process that is no more."""
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


def test_what_a_killed_load_left_is_swept_away(tmp_path, root):
    folder = put_btf(tmp_path / "d")
    load_btf(folder)
    store = stores(root)[0]
    shutil.rmtree(store)
    half = root / f".{store.name}.building-{ended_process()}-abc"
    half.mkdir()
    (half / "pixels.raw").write_bytes(b"half")
    alive = root / f".{store.name}.building-{os.getpid()}-abc"
    alive.mkdir()
    assert not load_btf(folder).source.from_cache
    assert stores(root) == [alive, store]
    alive.rmdir()


# Several at once.


def test_threads_that_load_the_same_data(tmp_path, root, monkeypatch):
    folder = zipped(put_mixed(tmp_path / "d"))
    expected = everything(load_btf(folder, cache=False))
    meet = threading.Barrier(4)
    write = cache_module._write

    def together(*arguments):
        meet.wait(30)
        write(*arguments)

    monkeypatch.setattr(cache_module, "_write", together)
    with ThreadPoolExecutor(4) as pool:
        loaded = list(pool.map(lambda _: load_btf(folder), range(4)))
    assert [everything(btf) for btf in loaded] == [expected] * 4
    assert len(stores(root)) == 1
    assert load_btf(folder).source.from_cache


def test_processes_that_load_the_same_data(tmp_path, root):
    folder = put_mixed(tmp_path / "d")
    program = (
        "import sys, hashlib, torchmat; btf = torchmat.load_btf(sys.argv[1]);"
        "sys.stdout.write(hashlib.sha256(btf.images(range(4)).numpy().tobytes()).hexdigest())"
    )
    command = [sys.executable, "-W", "error", "-c", program, str(folder)]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    results = [process.communicate(timeout=120) for process in running]
    assert [process.returncode for process in running] == [0, 0], results
    btf = load_btf(folder)
    assert btf.source.from_cache
    assert {out for out, _ in results} == {
        hashlib.sha256(btf.images(range(4)).numpy().tobytes()).hexdigest()
    }
    assert len(stores(root)) == 1


def test_another_that_is_first_by_a_moment(tmp_path, monkeypatch):
    folder = put_btf(tmp_path / "d")

    def second(built: Path, target: Path, backup: bool, late: atomic.Late) -> None:
        os.rename(built, target)
        raise OSError(errno.ENOTEMPTY, "Directory not empty")

    monkeypatch.setattr(atomic, "_install", second)
    assert everything(load_btf(folder)) == everything(load_btf(folder, cache=False))


def test_a_store_that_is_removed_at_once_is_made_again(tmp_path, root, monkeypatch):
    folder = put_btf(tmp_path / "d")
    removed = []

    def greedy(_, keep, limit):
        if len(removed) < 2:
            removed.append(keep)
            shutil.rmtree(keep)

    monkeypatch.setattr(cache_module, "_prune", greedy)
    assert len(load_btf(folder)) == 4
    assert len(removed) == 2
    monkeypatch.setattr(cache_module, "_prune", lambda _, keep, limit: shutil.rmtree(keep))
    with pytest.raises(DataError, match="the store must stay until it is opened; .*Raise TORCHMAT_CACHE_GB"):
        load_btf(folder, downscale=2)


# The limit.


def test_the_store_used_longest_ago_goes_first(tmp_path, root, monkeypatch):
    folders = [put_btf(tmp_path / name, shape=(64, 64, 3)) for name in "abc"]
    for age, folder in enumerate(folders[:2]):
        load_btf(folder)
        newest = max(stores(root), key=lambda path: path.stat().st_mtime)
        os.utime(newest, (100 + age, 100 + age))
    load_btf(folders[0])  # used again, so b is now the older one
    size = sum(cache_module._size_on_disk(store) for store in stores(root)) / 2
    monkeypatch.setenv("TORCHMAT_CACHE_GB", str(2.5 * size / 1e9))
    load_btf(folders[2])
    assert len(stores(root)) == 2
    assert [load_btf(folder).source.from_cache for folder in (folders[0], folders[2])] == [True, True]
    assert not load_btf(folders[1]).source.from_cache


def test_the_store_just_made_stays_however_small_the_limit(tmp_path, root, monkeypatch):
    monkeypatch.setenv("TORCHMAT_CACHE_GB", "0")
    for name in "ab":
        load_btf(put_btf(tmp_path / name))
        assert len(stores(root)) == 1
    assert load_btf(tmp_path / "b").source.from_cache


def test_only_stores_are_ever_removed(tmp_path, monkeypatch):
    mine = tmp_path / "cache" / "my project"
    mine.mkdir(parents=True)
    (mine / "header.json").write_text("{}")
    (tmp_path / "cache" / "notes.txt").write_text("mine")
    monkeypatch.setenv("TORCHMAT_CACHE_GB", "0")
    for name in "ab":
        load_btf(put_btf(tmp_path / name), cache=tmp_path / "cache")
    assert (mine / "header.json").read_text() == "{}"
    assert (tmp_path / "cache" / "notes.txt").exists()
    assert len(stores(tmp_path / "cache")) == 3


@pytest.mark.parametrize("text", ["lots", "-1", "nan"])
def test_a_limit_that_is_no_size(tmp_path, root, monkeypatch, text):
    monkeypatch.setenv("TORCHMAT_CACHE_GB", text)
    with pytest.raises(RangeError, match=f"TORCHMAT_CACHE_GB must be a number >= 0; it is '{text}'. Set it"):
        load_btf(put_btf(tmp_path / "d"))
    assert stores(root) == []


def test_quiet_unless_asked(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr("torchmat.progress._DELAY", 0.0)  # what is over sooner has no bar
    load_btf(put_btf(tmp_path / "d"))
    assert capfd.readouterr() == ("", "")
    load_btf(tmp_path / "d", cache=False, progress=True)
    assert "decoding" in capfd.readouterr().err
