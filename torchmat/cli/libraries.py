"""How a command comes to torch and leaves it, so that neither keeps its line on the terminal, or anyone, waiting."""

from __future__ import annotations

import atexit
import ctypes
import gc
import importlib.machinery
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from types import ModuleType

_NOW = 2  # RTLD_NOW of dlfcn.h
_LARGEST = "libtorch_cpu.so"


class _Ahead:
    """Finds no module. Asked for torch, it loads the largest of its libraries while other threads go on.

    Asked for OpenImageIO, it takes what was loaded before, torch mostly, out of what is searched for garbage as the process
    ends, which takes half a second. OpenImageIO itself has to be: what of it is not found is said to be leaked.
    """

    def find_spec(self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> None:
        if name == "torch":
            spec = importlib.machinery.PathFinder.find_spec(name)
            if spec is not None and spec.origin:
                load(os.path.join(os.path.dirname(spec.origin), "lib", _LARGEST))
        elif name == "OpenImageIO" and "torch" in sys.modules:
            gc.freeze()
            with suppress(ValueError):  # another thread was here
                sys.meta_path.remove(self)


def load(library: str) -> bool:
    """Load a shared library of the system's and let other threads of Python go on meanwhile; return whether it is there."""
    with suppress(OSError, AttributeError):
        # Called as a function of the C library: an import, and ctypes itself, keep Python's lock for as long as it takes.
        call = ctypes.CDLL(None).dlopen
        call.argtypes, call.restype = (ctypes.c_char_p, ctypes.c_int), ctypes.c_void_p
        return bool(os.path.isfile(library) and call(os.fsencode(library), _NOW))
    return False


def prepare() -> None:
    """Let libraries be loaded so, once."""
    if sys.platform.startswith("linux") and "torch" not in sys.modules and not any(isinstance(one, _Ahead) for one in sys.meta_path):
        sys.meta_path.insert(0, _Ahead())


class Ending:
    """Ends the process with a code as soon as all that is to run at its end has run.

    Taking the modules of Python and torch apart one by one takes up to seven tenths of a second, and the system does it at once.
    """

    def __init__(self) -> None:
        self.code: int | None = None  # None lets Python end as it does
        atexit.register(self._end)  # the first that is registered runs last, when threads have ended

    def _end(self) -> None:
        if self.code is None:
            return
        try:
            for stream in (sys.stdout, sys.stderr):
                if stream is not None:
                    stream.flush()
        except (OSError, ValueError):
            return  # Python says what was not written, and has a code of its own for it
        os._exit(self.code)
