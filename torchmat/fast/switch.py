"""Which road is taken: the compiled part, or plain torch; decided once in a process, on first use."""

from __future__ import annotations

import ctypes
import logging
import os
import threading
from dataclasses import dataclass

from torchmat.errors import RangeError, message
from torchmat.fast.build import NotBuilt, build

COMPILED, PLAIN = "compiled", "plain"
_log = logging.getLogger("torchmat")
_lock = threading.Lock()


@dataclass(frozen=True)
class _Road:
    library: ctypes.CDLL | None
    said: str


_asked: bool | None = None
_found: _Road | None = None
_double: _Road | None = None  # that of double precision, which few ask for


def use(fast: bool | None) -> None:
    """Take the compiled part (True) or plain torch (False) from now on; None leaves it to the variable TORCHMAT_FAST.

    True where nothing can be compiled is plain torch all the same, and `road` says so.
    """
    global _asked
    _asked = fast


def wanted() -> bool:
    """Return whether the compiled part is to be used: as `use` said, else unless TORCHMAT_FAST is 0."""
    if _asked is not None:
        return _asked
    text = os.environ.get("TORCHMAT_FAST", "").strip()
    if text not in ("", "0", "1"):
        step = "0 is plain torch everywhere, 1 the compiled part where there is a compiler, as without the variable."
        raise RangeError(message("the environment", "TORCHMAT_FAST", "be 0 or 1", f"it is {text!r}", step))
    return text != "0"


def library() -> ctypes.CDLL | None:
    """Return the compiled part, made on first use; None for the plain road."""
    return _decided().library if wanted() else None


def double_library() -> ctypes.CDLL | None:
    """Return the compiled part of double precision, which is made when it is first asked for; None for the plain road."""
    global _double
    if library() is None:
        return None
    if _double is None:
        with _lock:
            if _double is None:
                _double = _decide_double()
    return _double.library


def road() -> str:
    """Return "compiled", or "plain: " and why; a compiled part that has a shortcoming says it, too."""
    return _decided().said if wanted() else f"{PLAIN}: switched off"


def road_taken() -> str:
    """Return the `road` that this process has taken so far: nothing is compiled to answer."""
    return f"{PLAIN}: nothing asked for the compiled part" if wanted() and _found is None else road()


def _decided() -> _Road:
    global _found
    if _found is None:
        with _lock:
            if _found is None:
                _found = _decide()
    return _found


def _decide() -> _Road:
    try:
        found = build()
    except NotBuilt as error:
        _log.info("torchmat computes with plain torch: %s.", error)
        return _Road(None, f"{PLAIN}: {error}")
    if found.torchmat_shares():
        return _Road(found, COMPILED)
    said = "one thread, for the compiler has no OpenMP"
    _log.info("torchmat's compiled part: %s.", said)
    return _Road(found, f"{COMPILED}: {said}")


def _decide_double() -> _Road:
    try:
        return _Road(build(double=True), COMPILED)
    except NotBuilt as error:
        _log.info("torchmat computes with plain torch in double precision: %s.", error)
        return _Road(None, f"{PLAIN}: {error}")


def forget() -> None:
    """Decide anew at the next use: for tests of what decides."""
    global _found, _double
    _found = _double = None
