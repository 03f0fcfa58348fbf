"""Node without a browser, for tests of modules that need no page."""

from __future__ import annotations

import json
import shutil
import subprocess
from typing import Any

import pytest
from tests.web.browser import PACKAGE

JS = PACKAGE / "web" / "js"


def evaluate(code: str) -> Any:
    """Return what the body `code` of a function returns, as JSON has it; `load("x.js")` imports a module. Skips without node."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed: apt-get install nodejs")
    script = f"""
const load = (name) => import("{JS.as_uri()}/" + name);
console.log(JSON.stringify(await (async () => {{ {code} }})()));
"""
    done = subprocess.run([node, "--input-type=module", "-e", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
