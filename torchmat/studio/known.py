"""The first picture of a material that was never opened here, without torch: its files, in a form that was seen before.

What a page is told of a material beside its codes (shader, options, meanings) depends on the manifest's form alone: model,
options and maps. That much is kept, for all materials of the user, and a folder of the same form needs nothing else.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from torchmat.errors import DataError, TorchmatError
from torchmat.images import read_image
from torchmat.studio.place import cache_folder, check_links, write_own
from torchmat.studio.textures import manifest_in, textures_of
from torchmat.web.codes import TYPES, stacked_bytes

_FORMAT, _MOST = 1, 100  # forms that are kept
_LARGEST = 1 << 20  # texels of a material that is read again for its form
_VALUES = ("provenance", "digests", "edited", "edits", "written_by", "height", "width", "bytes_per_texel", "shared_bytes", "constants")
_OF_TEXTURES = ("map", "channels", "type", "transfer", "per_texel", "filter", "meaning")


def _form(manifest: Mapping[str, Any]) -> Path:
    """Return the file of a manifest's form: of all in it that is no value, and of the package that reads it."""
    rest = {key: value for key, value in manifest.items() if key not in (*_VALUES, "textures", "stored")}
    textures = [{key: one.get(key) for key in _OF_TEXTURES} for one in manifest["textures"]]
    stored = {name: one.get("size") for name, one in manifest.get("stored", {}).items()}
    sizes = {name: len(values) for name, values in manifest["constants"].items()}
    # To ask for the files of the package itself would import it, and torch.
    with os.scandir(str(files("torchmat").joinpath("models"))) as entries:
        code = sorted((entry.name, entry.stat().st_mtime_ns) for entry in entries if entry.name.endswith((".py", ".glsl")))
    text = json.dumps([_FORMAT, rest, textures, stored, sizes, code], sort_keys=True)
    return cache_folder() / "forms" / f"{hashlib.sha256(text.encode()).hexdigest()}.json"


def keep_form(folder: Path, description: Mapping[str, Any]) -> None:
    """Keep what a page is told of a material besides its values."""
    path = _form(manifest_in(folder))
    if description["glsl"] is None or path.exists():  # beside pictures stand figures, which are values
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    write_own(path, description)
    oldest = sorted((one.stat().st_mtime, one) for one in path.parent.iterdir())
    for _, one in oldest[:-_MOST]:
        one.unlink(missing_ok=True)


def remember(folder: Path) -> None:
    """Keep the form of a material that was just written, torch being at hand: a studio then need not wait for torch to show it.

    A large material is left alone, for its codes would be read again; so is a cache that cannot be written.
    """
    from torchmat.studio.session import Session

    try:
        manifest = manifest_in(folder)
        if manifest["height"] * manifest["width"] <= _LARGEST and not _form(manifest).exists():
            keep_form(folder, Session(str(folder)).load()["description"])
    except (OSError, TorchmatError):
        return


def first_of(folder: Path) -> tuple[dict[str, Any], dict[str, bytes]] | None:
    """Return the description and the codes of the material in a folder; None where its form or its files ask for more."""
    try:
        manifest = manifest_in(folder)
        small = [one for one in manifest.get("stored", {}).values() if one.get("size") is not None]
        if small or "cutout" in manifest:
            return None
        description = json.loads(_form(manifest).read_text(encoding="utf-8"))
        check_links(folder, list(textures_of(manifest).values()))
        description["size"] = description["whole_size"] = [manifest["height"], manifest["width"]]
        description["numbers"] = {name: manifest["constants"][name] for name in description["numbers"]}
        buffers = {}
        for entry in description["maps"]:
            textures = [one for one in manifest["textures"] if one["map"] == entry["name"]]
            buffers[entry["name"]] = _read(folder, textures, entry)
        return description, buffers
    except (DataError, OSError, ValueError, LookupError, TypeError, AttributeError):
        return None


def _read(folder: Path, textures: list[Mapping[str, Any]], entry: dict[str, Any]) -> bytes:
    """Return the codes of a map and bring its entry up to date; raises ValueError where they are not what a page takes."""
    parts = [read_image(folder / one["file"]) for one in textures]
    shapes = {(one["height"], one["width"], one["channels"]) for one in textures} | {part.shape for part in parts}
    kinds = {part.dtype.name for part in parts}
    if len(shapes) != 1 or len(kinds) != 1 or len(parts) != entry["layers"] or any(one["filter"] == "nearest" for one in textures):
        raise ValueError
    (entry["height"], entry["width"], channels), kind = shapes.pop(), kinds.pop()
    integer = kind.startswith("uint")
    if channels != entry["channels"] or any(integer != bool(one.get("low")) for one in textures):
        raise ValueError
    entry["type"], entry["transfer"] = TYPES[kind], textures[0]["transfer"]
    entry["low"] = [low for one in textures for low in one.get("low", ())]
    entry["high"] = [high for one in textures for high in one.get("high", ())]
    ends = [_values(part, one) for part, one in zip(parts, textures, strict=True)]
    if textures[0]["transfer"] != "hue":  # of those the last known range stands until torch is there
        entry["range"] = [float(min(one.min() for one in ends)), float(max(one.max() for one in ends))]
    return stacked_bytes(parts)


def _values(pixels: np.ndarray, texture: Mapping[str, Any]) -> np.ndarray:
    """Return the least and the greatest value [2, C] of a texture's channels."""
    ends = np.stack((pixels.min(axis=(0, 1)), pixels.max(axis=(0, 1))))
    if not np.isfinite(ends).all():
        raise ValueError
    if not texture.get("low"):
        return ends.astype(np.float32)
    share = ends / np.iinfo(pixels.dtype).max
    if texture["transfer"] == "srgb":
        share = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    low, high = np.array(texture["low"]), np.array(texture["high"])
    return (low + share * (high - low)).astype(np.float32)
