"""Which road is taken: every way in which there is no compiled part ends on the plain one, and says why once."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import torch

from torchmat import fast
from torchmat.errors import RangeError
from torchmat.fast import build, switch
from torchmat.fast.roughness import roughness

REAL = next((found for name in ("cc", "gcc", "clang") if (found := build.shutil.which(name))), None)
QUICKLY = f'exec {REAL} "$@" -O0'  # what is made here is loaded, and hardly used
needs_compiler = pytest.mark.skipif(REAL is None, reason="no C compiler")


@pytest.fixture(autouse=True)
def anew(monkeypatch):
    """Decide anew in each test, and as before after it."""
    monkeypatch.setattr(switch, "_found", None)
    monkeypatch.setattr(switch, "_double", None)
    fast.use(True)
    yield
    fast.use(None)


@pytest.fixture
def compiler(tmp_path, monkeypatch):
    """Return a function that puts a script in the place of the compiler; each of its calls adds a line to `calls`."""

    def put(script: str) -> Path:
        path = tmp_path / "my-cc"
        path.write_text(f"#!/bin/sh\necho \"$@\" >> {tmp_path / 'calls'}\n{script}\n")
        path.chmod(0o755)
        monkeypatch.setenv("CC", str(path))
        return tmp_path / "calls"

    return put


def test_no_compiler(monkeypatch, caplog):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    with caplog.at_level(logging.INFO, "torchmat"):
        assert fast.road() == "plain: no compiler found" and fast.library() is None
        fast.road()
    assert [one.message for one in caplog.records] == ["torchmat computes with plain torch: no compiler found."]
    switch.forget()
    monkeypatch.setenv("CC", "/no/such/compiler -v")
    assert fast.road() == "plain: no compiler found: CC is '/no/such/compiler'"


@pytest.mark.parametrize("script, why", [
    ("echo 'kernels.c:1: error: no' >&2; echo more >&2; exit 1", "failed: kernels.c:1: error: no"),
    ("exit 3", "failed: exit code 3"),
    ("exit 0", "what the compiler made cannot be loaded"),
    ('for last; do :; done; for one; do case "$before" in -o) echo rubbish > "$one";; esac; before="$one"; done', "cannot be loaded"),
])
def test_a_compiler_that_fails_or_lies(compiler, script, why):
    calls = compiler(script)
    assert fast.road().startswith("plain: ") and why in fast.road()
    assert fast.library() is None
    lines = calls.read_text().splitlines()
    assert "-fopenmp" in lines[0] and "-march" not in lines[-1]  # it was tried in simpler ways
    kept = Path(os.environ["TORCHMAT_CACHE"], "compiled")
    assert list(kept.iterdir()) == []


def test_a_compiler_that_hangs(compiler, monkeypatch):
    monkeypatch.setattr(build, "_SECONDS", 0.2)
    compiler("exec sleep 60")
    assert fast.road() == "plain: the compiler took more than 0.2 s"


def test_a_compiler_that_is_no_program(tmp_path, monkeypatch):
    path = tmp_path / "cc"
    path.write_bytes(b"\x7fELF nothing")
    path.chmod(0o755)
    monkeypatch.setenv("CC", str(path))
    assert "does not run" in fast.road()


@needs_compiler
def test_a_compiler_without_openmp(compiler):
    compiler(f'case "$*" in *-fopenmp*) exit 1;; esac\n{QUICKLY}')
    assert fast.road() == "compiled: one thread, for the compiler has no OpenMP" and fast.library() is not None


@needs_compiler
def test_a_part_is_kept_and_made_once(compiler):
    calls = compiler(QUICKLY)
    assert fast.road() == "compiled"
    made = calls.read_text()
    switch.forget()
    assert fast.road() == "compiled" and calls.read_text() == made
    (kept,) = Path(os.environ["TORCHMAT_CACHE"], "compiled").iterdir()
    whole = kept.read_bytes()
    kept.unlink()
    kept.write_bytes(whole[:-5000])  # a power cut, say: it is made again
    switch.forget()
    assert fast.road() == "compiled" and calls.read_text() != made and kept.read_bytes() == whole


@needs_compiler
@pytest.mark.skipif(hasattr(os, "geteuid") and os.geteuid() == 0, reason="a folder is never closed to root")
def test_a_cache_that_is_closed(tmp_path, monkeypatch, compiler):
    calls = compiler(QUICKLY)
    closed = tmp_path / "closed"
    closed.mkdir()
    closed.chmod(0o500)
    monkeypatch.setenv("TORCHMAT_CACHE", str(closed))
    _plain_for_it_cannot_be_kept(calls)
    closed.chmod(0o700)


def test_a_cache_that_is_a_file(tmp_path, monkeypatch, compiler):
    calls = compiler("exit 0")
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TORCHMAT_CACHE", str(tmp_path / "file"))
    _plain_for_it_cannot_be_kept(calls)


def _plain_for_it_cannot_be_kept(calls):
    assert fast.road().startswith("plain: the cache folder cannot be written (") and fast.library() is None
    assert fast.road().endswith("); TORCHMAT_CACHE names another one") and not calls.exists()


@needs_compiler
def test_a_part_that_is_kept_is_used_where_nothing_can_be_written(compiler, monkeypatch):
    compiler(QUICKLY)
    assert fast.road() == "compiled"
    switch.forget()
    monkeypatch.setattr(build, "_made", lambda *given: pytest.fail("it is there"))
    assert fast.road() == "compiled" and fast.library() is not None


def test_parts_of_other_processors_compilers_and_sources_have_other_names(monkeypatch, tmp_path):
    names = {build.key(["/usr/bin/cc"]), build.key(["/usr/bin/cc", "-m32"]), build.key([sys.executable])}
    monkeypatch.setattr(build, "processor", lambda: "one without AVX")
    names.add(build.key(["/usr/bin/cc"]))
    (tmp_path / "kernels.c").write_text("")
    monkeypatch.setattr(build, "FOLDER", tmp_path)
    names.add(build.key(["/usr/bin/cc"]))
    assert len(names) == 5


@needs_compiler
def test_double_precision_is_a_part_of_its_own_that_few_ask_for(compiler, caplog):
    calls = compiler(f'case "$*" in *-DDOUBLE*) exit 1;; esac\n{QUICKLY}')
    single, double = torch.rand(2, 3, 4), torch.rand(2, 3, 4, dtype=torch.float64)
    assert roughness(single, 0.1) is not None and "-DDOUBLE" not in calls.read_text()
    with caplog.at_level(logging.INFO, "torchmat"):
        assert roughness(double, 0.1) is None and roughness(double, 0.1) is None  # it cannot be made: plain torch, said once
    assert [one.message.split(":")[0] for one in caplog.records] == ["torchmat computes with plain torch in double precision"]
    assert roughness(single, 0.1) is not None
    switch.forget()
    compiler(QUICKLY)
    assert roughness(double, 0.1).dtype == torch.float64
    assert len(list(Path(os.environ["TORCHMAT_CACHE"], "compiled").iterdir())) == 3  # both by this script, and the one before


@needs_compiler
def test_two_that_compile_at_once_end_with_one_part(compiler):
    compiler(f'sleep 0.2; {QUICKLY}')
    found = []
    both = [threading.Thread(target=lambda: found.append(build.build())) for _ in range(2)]
    for one in both:
        one.start()
    for one in both:
        one.join()
    assert all(one.torchmat_version() == build.VERSION for one in found)
    assert len(list(Path(os.environ["TORCHMAT_CACHE"], "compiled").iterdir())) == 1


@pytest.mark.parametrize("text, expected", [("0", False), ("1", True), ("", True), (None, True)])
def test_the_variable(monkeypatch, text, expected):
    fast.use(None)
    monkeypatch.delenv("TORCHMAT_FAST", raising=False)
    if text is not None:
        monkeypatch.setenv("TORCHMAT_FAST", text)
    assert switch.wanted() is expected
    fast.use(not expected)
    assert switch.wanted() is not expected


def test_a_variable_that_is_neither(monkeypatch):
    fast.use(None)
    monkeypatch.setenv("TORCHMAT_FAST", "yes")
    with pytest.raises(RangeError, match="TORCHMAT_FAST must be 0 or 1; it is 'yes'"):
        fast.road()


def test_tests_take_the_plain_road_unless_they_say_otherwise():
    fast.use(None)
    assert fast.road() == "plain: switched off"
    assert os.environ["TORCHMAT_FAST"] == "0"


def test_asking_for_the_road_taken_decides_nothing(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert fast.road_taken() == "plain: nothing asked for the compiled part" and switch._found is None
    assert fast.library() is None and fast.road_taken() == "plain: no compiler found"
    fast.use(False)
    assert fast.road_taken() == "plain: switched off"


def test_nothing_is_compiled_before_it_is_needed():
    code = "import sys, torchmat as tm, torchmat.geometry; print(sys.modules['torchmat.fast.switch']._found)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "None"
