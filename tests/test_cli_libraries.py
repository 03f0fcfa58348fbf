"""A command loads the largest library of torch without Python's lock, and is loaded by torch alike."""

from __future__ import annotations

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
