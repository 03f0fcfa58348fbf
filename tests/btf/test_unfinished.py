"""A load that is stopped goes on from what was finished, and from nothing else."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tests.btf.files import put_btf, put_image, random_codes, srgb_decoded, zipped
from tests.support import assert_close

from torchmat import DataError, load_btf
from torchmat.btf import cache as cache_module
from torchmat.btf import pixels as pixels_module

_KILLED = """
import os, signal, sys, time
from pathlib import Path
from torchmat import load_btf
from torchmat.btf import pixels

pixels.CHUNK = 1
root, usual, calls = Path(os.environ["TORCHMAT_CACHE"]), pixels.read_picture, []

def read(path, *rest):
    calls.append(path)
    while len(calls) > 4:  # the first file is read once more than the others
        if any(len(journal.read_text().splitlines()) >= 3 for journal in root.glob(".*/journal.jsonl")):
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.005)
    return usual(path, *rest)

pixels.read_picture = read
load_btf(sys.argv[1])
"""


@pytest.fixture
def root(tmp_path, monkeypatch) -> Path:
    """The cache folder that `own_cache` sets; single images are decoded at a time."""
    monkeypatch.setattr(pixels_module, "CHUNK", 1)
    return tmp_path / "torchmat-cache"


def put_six(folder: Path) -> Path:
    """Write six images, of which the second has a clipped texel."""
    for seed in range(6):
        pixels = random_codes(seed)
        pixels[0, 0, 0] = 255 if seed == 1 else 7
        put_image(folder / f"{seed}.png", pixels)
    rows = [f"{n}.png,{10 * n},{20 * n},0,0" for n in range(6)]
    folder.joinpath("manifest.csv").write_text(
        "\n".join(["file,light_polar_deg,light_azimuth_deg,view_polar_deg,view_azimuth_deg", *rows]), encoding="utf-8")
    return folder


def unfinished(root: Path) -> list[Path]:
    return sorted(root.glob(".*.unfinished"))


def finished_rows(folder: Path) -> list[int]:
    return [json.loads(line)["row"] for line in (folder / "journal.jsonl").read_text().splitlines()[1:]]


@pytest.fixture
def decoded(monkeypatch) -> list[int]:
    """The numbers of the images that are decoded, the first once more than it is."""
    found: list[int] = []
    usual = pixels_module.read_picture

    def read(path, *rest):
        found.append(int(Path(path).stem) if Path(path).stem.isdigit() else -1)
        return usual(path, *rest)

    monkeypatch.setattr(pixels_module, "read_picture", read)
    return found


def stop_after(monkeypatch, count: int, stop: BaseException) -> None:
    """Make the load end with `stop` once `count` images are finished."""
    usual = pixels_module._in_threads

    def some(work, starts, show, threads):
        usual(work, starts[:count], show, threads)
        raise stop

    monkeypatch.setattr(pixels_module, "_in_threads", some)


def same(btf, folder: Path) -> None:
    """Hold a BTF to the images of `folder` as they are now."""
    again = load_btf(folder, cache=False)
    assert btf.images(range(len(btf))).numpy().tobytes() == again.images(range(len(again))).numpy().tobytes()
    assert btf.weights(range(len(btf))).numpy().tobytes() == again.weights(range(len(again))).numpy().tobytes()
    assert (btf.clipped_share, btf.value_range, btf.digest()) == (again.clipped_share, again.value_range, again.digest())


def test_a_killed_load_goes_on_from_what_was_finished(tmp_path, root, decoded):
    folder = put_six(tmp_path / "d")
    killed = subprocess.run([sys.executable, "-c", _KILLED, str(folder)], env={**os.environ, "TORCHMAT_CACHE": str(root)}, timeout=120)
    assert killed.returncode == -signal.SIGKILL
    (left,) = unfinished(root)
    done = finished_rows(left)
    assert 2 <= len(done) < 6
    btf = load_btf(folder)
    assert sorted(decoded) == sorted([0, *set(range(6)) - set(done)])
    assert not btf.source.from_cache and unfinished(root) == []
    assert len(list(root.iterdir())) == 1
    same(btf, folder)
    assert load_btf(folder).source.from_cache


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), MemoryError(), DataError("5.png is damaged")])
def test_what_changed_or_was_lost_since_a_stop_is_decoded_again(tmp_path, root, monkeypatch, decoded, stop):
    folder = put_six(tmp_path / "d")
    with monkeypatch.context() as patch, pytest.raises(type(stop)):
        stop_after(patch, 4, stop)
        load_btf(folder)
    (left,) = unfinished(root)
    assert sorted(finished_rows(left)) == [0, 1, 2, 3]
    put_image(folder / "1.png", random_codes(11))  # was clipped, and is not now
    pixels = np.memmap(left / "pixels.raw", np.uint8, "r+")
    pixels[2 * 36 + 5] ^= 1  # a page of the third that never came to the disk
    pixels.flush()
    with open(left / "journal.jsonl", "a") as journal:
        journal.write('{"row": 4, "chec')  # a line that was begun
    decoded.clear()
    btf = load_btf(folder)
    assert sorted(decoded) == [0, 1, 2, 4, 5]  # the first for its size alone
    assert btf.clipped_share == 0 and unfinished(root) == []
    assert_close(btf.image(1), srgb_decoded(random_codes(11).transpose(2, 0, 1) / 255), 1e-6)
    same(btf, folder)


def test_a_file_with_the_old_size_and_time_is_decoded_again(tmp_path, root, monkeypatch, decoded):
    folder = put_six(tmp_path / "d")
    before = os.stat(folder / "1.png")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        stop_after(patch, 4, KeyboardInterrupt())
        load_btf(folder)
    data = bytearray((folder / "1.png").read_bytes())
    (folder / "1.png").write_bytes(data)
    os.utime(folder / "1.png", ns=(before.st_atime_ns, before.st_mtime_ns))
    decoded.clear()
    load_btf(folder)
    assert sorted(decoded) == [0, 1, 4, 5]


def test_images_in_a_zip_are_told_by_their_content(tmp_path, root, monkeypatch):
    folder = put_six(tmp_path / "d")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        stop_after(patch, 4, KeyboardInterrupt())
        load_btf(zipped(folder))
    put_image(folder / "2.png", random_codes(12))
    archive = zipped(folder)
    os.utime(archive, ns=(5, 5))
    rows, usual = [], pixels_module.Journal.add
    monkeypatch.setattr(pixels_module.Journal, "add", lambda journal, new: (rows.extend(row["row"] for row in new), usual(journal, new)))
    same(load_btf(archive), folder)
    assert sorted(rows) == [2, 4, 5]


def test_other_images_begin_anew(tmp_path, root, monkeypatch, decoded):
    folder = put_six(tmp_path / "d")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        stop_after(patch, 4, KeyboardInterrupt())
        load_btf(folder)
    for seed in range(6):
        put_image(folder / f"{seed}.png", random_codes(seed, (3, 5, 3)))
    decoded.clear()
    btf = load_btf(folder)
    assert sorted(decoded) == [0, 0, 1, 2, 3, 4, 5]
    same(btf, folder)


def test_small_images_are_finished_by_the_run(tmp_path, monkeypatch, root, decoded):
    monkeypatch.setattr(pixels_module, "CHUNK", 3)
    folder = put_six(tmp_path / "d")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        stop_after(patch, 1, KeyboardInterrupt())
        load_btf(folder)
    put_image(folder / "1.png", random_codes(11))
    decoded.clear()
    btf = load_btf(folder)
    assert sorted(decoded) == [0, 1, 3, 4, 5]
    same(btf, folder)


def test_a_second_process_leaves_it_alone(tmp_path, root, monkeypatch):
    folder = put_six(tmp_path / "d")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        stop_after(patch, 4, KeyboardInterrupt())
        load_btf(folder)
    (left,) = unfinished(root)
    before = (left / "journal.jsonl").read_bytes()
    with open(left / "lock", "ab") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        same(load_btf(folder), folder)
        assert (left / "journal.jsonl").read_bytes() == before


# What is left goes.


def test_what_nobody_goes_on_with_is_bounded(tmp_path, root, monkeypatch):
    folders = [put_btf(tmp_path / name, shape=(64, 64, 3)) for name in "abc"]
    for age, folder in enumerate(folders):
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            stop_after(patch, 2, KeyboardInterrupt())
            load_btf(folder)
        newest = max(unfinished(root), key=lambda path: path.stat().st_mtime)
        os.utime(newest, (time.time() - 1000 * (3 - age),) * 2)
    assert len(unfinished(root)) == 3
    size = sum(cache_module._size_on_disk(left) for left in unfinished(root)) / 3
    monkeypatch.setenv("TORCHMAT_CACHE_GB", str(2.5 * size / 1e9))
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        stop_after(patch, 2, KeyboardInterrupt())
        load_btf(put_btf(tmp_path / "d", shape=(64, 64, 3)))
    assert len(unfinished(root)) == 3  # the oldest went
    os.utime(max(unfinished(root)), (1, 1))
    monkeypatch.setenv("TORCHMAT_CACHE_GB", "20")
    load_btf(put_btf(tmp_path / "e"))
    assert len(unfinished(root)) == 2  # a week is enough
    monkeypatch.setenv("TORCHMAT_CACHE_GB", "0")
    load_btf(put_btf(tmp_path / "f"))
    assert unfinished(root) == []


def test_the_scratch_folder_of_a_killed_load_is_removed(tmp_path, root, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    old, new, held = (tmp_path / f"torchmat-store-{name}" for name in ("old", "new", "held"))
    for folder in (old, new, held):
        folder.mkdir()
        (folder / "pixels.raw").write_bytes(b"half")
    (held / "lock").touch()
    for folder in (old, held):
        os.utime(folder, (1, 1))
    with open(held / "lock", "ab") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        load_btf(put_btf(tmp_path / "d"), cache=False)
    assert not old.exists() and new.exists() and held.exists()
