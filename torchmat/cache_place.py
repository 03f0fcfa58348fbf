"""Where what can be made again is kept: the user's cache folder."""

from __future__ import annotations

import os
from pathlib import Path

from torchmat.errors import DataError, message


def cache_place() -> Path:
    """Return the cache folder: $TORCHMAT_CACHE, else `torchmat` in the user's own. Raises DataError where there is none."""
    if os.environ.get("TORCHMAT_CACHE"):
        return Path(os.environ["TORCHMAT_CACHE"])
    if os.environ.get("XDG_CACHE_HOME"):
        return Path(os.environ["XDG_CACHE_HOME"], "torchmat")
    try:
        return Path.home() / ".cache" / "torchmat"
    except RuntimeError as error:
        step = "Set TORCHMAT_CACHE to a folder, or turn the cache off (cache=False)."
        raise DataError(message("load_btf", "the cache folder", "be known", str(error), step)) from error
