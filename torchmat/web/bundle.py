"""Modules of JavaScript as one text: pages that open from disk may not load others.

The modules keep to what is read here: ``import { a, b as c } from "./x.js";`` and ``export`` before a function, class or const.
"""

from __future__ import annotations

import re
from importlib import resources
from importlib.resources.abc import Traversable

from torchmat.errors import DataError, message

_IMPORT = re.compile(r'^import \{([^}]*)\} from "\./(\w+)\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (async function|function|class|const) (\w+)", re.MULTILINE)
_OTHER = re.compile(r"^(import|export)\b.*", re.MULTILINE)


def scripts() -> Traversable:
    """Return the folder of the modules."""
    return resources.files("torchmat.web").joinpath("js")


def bundle(entry: str) -> str:
    """Return the module `entry` (without ".js") and all that it imports as one script, each a constant ``$name`` of its exports.

    Raises DataError, which names the module, for imports in a circle or in another form, and for what would end a script element.
    """
    written: dict[str, str] = {}
    _add(entry, written, ())
    return "\n".join(written.values())


def _add(name: str, written: dict[str, str], above: tuple[str, ...]) -> None:
    where = f"{name}.js"
    if name in above:
        raise DataError(message(where, "imports", "not go in a circle", " imports ".join((*above, name)), "Move what both need to a third module."))
    if name in written:
        return
    source = scripts().joinpath(where).read_text(encoding="utf-8")
    for _, other in _IMPORT.findall(source):
        _add(other, written, (*above, name))
    body = _IMPORT.sub(lambda found: f"const {{{_renamed(found[1])}}} = ${found[2]};\n", source)
    names = [found[1] for found in _EXPORT.findall(body)]
    body = _EXPORT.sub(r"\1 \2", body)
    odd = _OTHER.search(body)
    if odd or "</script" in body or "<!--" in body:
        fact = f"it has {odd[0]!r}" if odd else "it has '</script' or '<!--'"
        raise DataError(message(where, "the module", "keep to plain imports and exports", fact, "See torchmat/web/bundle.py."))
    written[name] = f"const ${name} = (() => {{\n{body.rstrip()}\nreturn {{ {', '.join(names)} }};\n}})();"


def _renamed(names: str) -> str:
    return ", ".join(one.strip().replace(" as ", ": ") for one in names.split(",") if one.strip())
