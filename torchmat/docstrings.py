"""What a docstring says of each argument, where it lists them in a section "Args:"."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any

_ENTRY = re.compile(r"(\*{0,2}\w+(?:, \*{0,2}\w+)*): (.*)")


def documented_arguments(function: Callable[..., Any]) -> dict[str, str]:
    """Return the meaning of each argument that a function's docstring lists, in its order.

    The section begins with a line ``Args:`` and ends with the next line that is indented no deeper. Within it an entry is
    ``name: meaning`` or ``name, other: meaning``; deeper lines go on with it.
    """
    lines = inspect.cleandoc(function.__doc__ or "").splitlines()
    if "Args:" not in lines:
        return {}
    found: dict[str, str] = {}
    names: list[str] = []
    for line in lines[lines.index("Args:") + 1 :]:
        if line and not line.startswith(" "):
            break
        entry = _ENTRY.fullmatch(line.strip()) if line.startswith("    ") and not line.startswith("     ") else None
        if entry:
            names = [name.lstrip("*") for name in entry[1].split(", ")]
            found |= dict.fromkeys(names, entry[2])
        elif line.strip():
            found |= {name: f"{found[name]} {line.strip()}" for name in names}
    return found
