"""The page's modules are short and hold to a few rules."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest
from tests.web.node import JS

FILES = sorted(JS.glob("*.js"))
RULES = {
    r"\bvar\s": "let and const say more than var",
    r"[^=!]==\s*['\"nu]": "=== compares, == guesses",
    r"\bconsole\.": "a page says things where they are seen",
    r"\beval\(|new Function\(|document\.write|innerHTML|outerHTML|insertAdjacentHTML": "text of a material never becomes markup or code",
    r"https?://": "nothing is fetched",
    r"\t| +$": "no tabs, nothing at the ends of lines",
    r"^.{150,}$": "lines of fewer than 150 characters",
}


def complaints(text: str) -> list[str]:
    """Return what is wrong with a module, line by line; strings of GLSL and comments are read like all else."""
    found = [f"{number}: {why}" for number, line in enumerate(text.splitlines(), 1) for rule, why in RULES.items() if re.search(rule, line)]
    for name in re.findall(r"^import \{([^}]*)\}", text, re.MULTILINE):
        for one in (part.strip().split(" as ")[-1] for part in name.split(",")):
            if one and len(re.findall(rf"\b{re.escape(one)}\b", text)) < 2:
                found.append(f"{one} is imported and not used")
    return found + (["a module has fewer than 300 lines"] if len(text.splitlines()) >= 300 else [])


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_modules_hold_to_the_rules(path):
    assert complaints(path.read_text(encoding="utf-8")) == []


def test_each_rule_can_be_broken():
    lines = ["var a", "if (a == null)", "console.log(1)", "eval('1')", "fetch('http://x')", "\tx", "x" * 150, 'import { gone } from "./a.js";']
    assert all(complaints(line) for line in lines) and complaints("x\n" * 300)
    assert complaints("const one = 1;\nif (one === 2 || one !== 3 || one <= 4) start();\n") == []


_PARSE = """
const { readFileSync } = require("fs"), { SourceTextModule } = require("vm");
for (const path of process.argv.slice(1)) {
  try { new SourceTextModule(readFileSync(path, "utf8")); } catch (error) { console.log(`${path}: ${error}`); }
}"""


def test_modules_parse(tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed: apt-get install nodejs")
    (tmp_path / "bad.js").write_text("export const one = ;\n")
    files = [*map(str, FILES), str(tmp_path / "bad.js")]
    done = subprocess.run([node, "--experimental-vm-modules", "-e", _PARSE, *files], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout == f"{files[-1]}: SyntaxError: Unexpected token ';'\n", done.stdout + done.stderr
