"""The annotations agree with the code, and whoever imports the package gets them (mypy, as pyproject.toml configures it)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
USE = """
import torchmat as tm
btf = tm.load_btf("folder")
result = tm.fit(btf, "ptm", measure=False)
reveal_type(result.material)
tm.render(result.material, size="large")
"""


def mypy(*arguments):
    command = [sys.executable, "-m", "mypy", "--no-error-summary", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    return done.stdout + done.stderr


def test_the_annotations_agree_with_the_code_and_reach_its_users(tmp_path):
    (tmp_path / "use.py").write_text(USE, encoding="utf-8")
    found = mypy("torchmat", tmp_path / "use.py").splitlines()
    assert len(found) == 2, "\n".join(found)  # those of the use: the package has none
    revealed, wrong = found
    assert 'Revealed type is "torchmat.models.base.Material"' in revealed
    assert "use.py:6: error" in wrong and "size" in wrong and 'expected "int | tuple[int, int]"' in wrong
