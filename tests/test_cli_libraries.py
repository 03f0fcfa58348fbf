"""A command loads the largest library of torch without Python's lock, and is loaded by torch alike."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from torchmat.cli import libraries

_LOADED = """
import gc, sys
from torchmat.cli import libraries

libraries.prepare()
libraries.prepare()
found, usual = [], libraries.load
libraries.load = lambda path: found.append((path.rpartition("/")[2], usual(path), "torch" in sys.modules))
import torch
frozen = gc.get_freeze_count()
import OpenImageIO
print(found, frozen, gc.get_freeze_count() > 10_000, [one for one in sys.meta_path if isinstance(one, libraries._Ahead)])
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="loads as elsewhere")
def test_torch_finds_its_library_loaded_and_nothing_is_said_to_leak():
    done = subprocess.run([sys.executable, "-c", _LOADED], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[('libtorch_cpu.so', True, False)] 0 True []" and done.stderr == ""


def test_what_is_no_library_is_not_loaded(tmp_path):
    (tmp_path / "lib.so").write_text("no library")
    assert not libraries.load(str(tmp_path / "lib.so")) and not libraries.load(str(tmp_path / "none.so"))


_ENDS = """
import atexit, sys, threading, time
from torchmat import cli

class Kept:
    def __del__(self):
        print("taken apart")

kept = Kept()
def run(arguments=None, command=None):
    atexit.register(print, "at the end")
    threading.Thread(target=lambda: (time.sleep(0.05), print("a thread"))).start()
    {what}
cli.main = run
cli.program()
"""


def _ended(what: str, **out):
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}  # so that the end has to write
    return subprocess.run([sys.executable, "-c", _ENDS.format(what=what)], text=True, env=kept, **(out or {"capture_output": True}))


def test_a_process_ends_with_its_code_when_threads_and_what_is_registered_have_run():
    done = _ended("return 3")
    assert (done.returncode, done.stdout, done.stderr) == (3, "a thread\nat the end\n", "")


@pytest.mark.parametrize(("what", "code"), [("sys.exit(2)", 2), ("raise ValueError('wrong')", 1)])
def test_what_ends_otherwise_ends_as_python_does(what, code):
    done = _ended(what)
    assert done.returncode == code and done.stdout == "a thread\nat the end\ntaken apart\n"
    assert ("wrong" in done.stderr) == (code == 1)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="has no full device")
def test_what_cannot_be_written_to_the_end_is_said():
    with open("/dev/full", "w") as full:
        done = _ended("print('much'); return 0", stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 120 and "No space left" in done.stderr
