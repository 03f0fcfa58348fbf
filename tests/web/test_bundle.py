"""Modules become one script that opens from disk."""

from __future__ import annotations

import pytest

from torchmat.errors import DataError
from torchmat.web import bundle, environments
from torchmat.web.bundle import scripts


def test_the_viewer_is_one_script_without_imports():
    script = bundle.bundle("viewer")
    assert "$viewer = " in script and "import {" not in script and "\nexport " not in script
    assert script.index("const $dom") < script.index("const $panels") < script.index("const $viewer")


def test_bad_modules_are_refused_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr(bundle, "scripts", lambda: tmp_path)
    for text, words in (
        ('import { b } from "./b.js";\n', "a.js: imports must not go in a circle; a imports b imports a"),
        ("export default 1;\n", "a.js: the module must keep to plain imports and exports; it has 'export default 1;'"),
        ('const x = "</script>";\n', "it has '</script' or '<!--'"),
    ):
        (tmp_path / "a.js").write_text(text)
        (tmp_path / "b.js").write_text('import { a } from "./a.js";\n')
        with pytest.raises(DataError, match=words):
            bundle.bundle("a")


def test_the_environments_are_those_that_are_made():
    assert scripts().joinpath("environments.js").read_text(encoding="utf-8") == environments.source()
