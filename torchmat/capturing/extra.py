"""What the extra `capture` installs, loaded where it is first needed."""

from __future__ import annotations

import importlib
from types import ModuleType

from torchmat.errors import DataError, message


def opencv() -> ModuleType:
    """Return OpenCV; raises DataError, which names the extra, where it is not installed."""
    return _loaded("cv2", "OpenCV")


def rawpy() -> ModuleType:
    """Return rawpy; raises DataError, which names the extra, where it is not installed."""
    return _loaded("rawpy", "rawpy")


def _loaded(name: str, title: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        step = "Install it with: pip install torchmat[capture]"
        raise DataError(message("capture", title, "be installed", str(error), step)) from error
