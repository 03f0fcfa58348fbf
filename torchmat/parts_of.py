"""One function of a large library, without all that its packages import on the way.

``import kornia`` takes 0.36 s: it brings what trains networks, finds features and calibrates cameras. A function of its colours is
had in a twentieth of that. What is imported here is a copy of its own, which leaves no trace: whoever imports the library gets it whole.
"""

from __future__ import annotations

import ast
import functools
import importlib
import sys
import threading
from collections.abc import Sequence
from importlib.abc import Loader
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import resolve_name
from pathlib import Path
from types import ModuleType
from typing import Any

_lock = threading.RLock()


@functools.cache
def part_of(module: str, name: str) -> Any:
    """Return what is called `name` in a module, importing of its library what that needs; where it is loaded already, it is that.

    Raises ImportError or AttributeError where there is no such thing.
    """
    library = module.partition(".")[0]
    with _lock:
        if library not in sys.modules:
            finder = _Lazily(library)
            sys.meta_path.insert(0, finder)
            try:
                return getattr(importlib.import_module(module), name)
            except Exception:  # a version whose modules need what their packages run: it is imported as it is
                pass
            finally:
                sys.meta_path.remove(finder)
                for one in [one for one in sys.modules if one.partition(".")[0] == library]:
                    del sys.modules[one]
        return getattr(importlib.import_module(module), name)


class _Lazily:
    """Finds the modules of a library; its packages run nothing, and import what is asked of them where they would import it from."""

    def __init__(self, library: str) -> None:
        self._library = library

    def find_spec(self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path) if name.partition(".")[0] == self._library else None
        if spec is not None and spec.submodule_search_locations is not None and spec.origin is not None:
            spec.loader = _Package(Path(spec.origin))
        return spec


class _Package(Loader):
    def __init__(self, source: Path) -> None:
        self._source = source

    def exec_module(self, module: ModuleType) -> None:
        places = _imported(self._source, module.__name__)

        def found(name: str) -> Any:
            if name not in places:
                raise AttributeError(f"module {module.__name__!r} has no attribute {name!r}")
            place, there = places[name]
            value = getattr(importlib.import_module(place), there)
            setattr(module, name, value)  # in the place of a module of the same name, as where all is run
            return value

        module.__dict__["__getattr__"] = found


def _imported(source: Path, package: str) -> dict[str, tuple[str, str]]:
    """Return the module, and the name there, of each name that a package imports from others."""
    found = {}
    for statement in ast.parse(source.read_bytes()).body:
        if isinstance(statement, ast.ImportFrom):
            place = resolve_name("." * statement.level + (statement.module or ""), package)
            found.update({alias.asname or alias.name: (place, alias.name) for alias in statement.names if place != package})
    return found
