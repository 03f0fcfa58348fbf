"""The codes of a map straight from its files: what a page is sent of a save, without a turn through linear values.

A texture that has the size, channels and depth that its manifest says holds the very codes that the page wants. What a paint
program made otherwise goes the long way (`material_io.reread`), which converts it and says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchmat.errors import DataError, message
from torchmat.images import read_image
from torchmat.material_io.painted import check_hues
from torchmat.models.storage import Codes
from torchmat.web.codes import TYPES, stacked_bytes
from torchmat.web.payload import range_of


def quick_map(
    folder: Path, textures: Sequence[Mapping[str, Any]], before: Mapping[str, Any]
) -> tuple[dict[str, Any], bytes] | None:
    """Return the entry and the codes of a map for a page, as `web.payload.map_of` has them; None where that takes more.

    Args:
        folder: of the material.
        textures: what the manifest says of the map's textures.
        before: the map's last entry.

    Raises DataError, naming the file, when it cannot be read to its end, or holds what is no value.
    """
    if any(one["filter"] == "nearest" for one in textures) or len(textures) != before["layers"]:
        return None  # numbers of other things are to be checked against those
    parts = []
    for one in textures:
        path = folder / one["file"]
        if not path.is_file():
            return None
        pixels = read_image(path)
        shape = (one["height"], one["width"], one["channels"])
        if pixels.shape != shape or TYPES[pixels.dtype.name] != before["type"] or not _is_coded(one, pixels):
            return None
        _check(path, one, pixels)
        parts.append(Codes(pixels, tuple(one.get("low", ())), tuple(one.get("high", ())), one["transfer"]))
    if any((before["height"], before["width"], before["channels"]) != one.pixels.shape for one in parts):
        return None
    entry = {
        **before, "transfer": parts[0].transfer, "low": [low for one in parts for low in one.low],
        "high": [high for one in parts for high in one.high], "range": range_of(parts),
    }
    return entry, stacked_bytes([one.pixels for one in parts])


def _is_coded(texture: Mapping[str, Any], pixels: np.ndarray) -> bool:
    """Return whether a file holds codes where the manifest says that it does, and values where it does not."""
    return np.issubdtype(pixels.dtype, np.integer) == bool(texture.get("low"))


def _check(path: Path, texture: Mapping[str, Any], pixels: np.ndarray) -> None:
    if texture["transfer"] == "hue":
        check_hues(path, pixels)
    if not np.issubdtype(pixels.dtype, np.integer) and not bool(np.isfinite(pixels).all()):
        fact = f"{int((~np.isfinite(pixels)).sum())} of {pixels.size} values are NaN or Inf"
        raise DataError(message(str(path), "the texture", "be finite", fact, "Correct those texels, or export the material again."))
