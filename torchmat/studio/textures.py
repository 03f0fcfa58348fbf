"""Which files a material's manifest names, and for which maps."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from torchmat.studio.place import MANIFEST


def manifest_in(folder: Path) -> dict[str, Any]:
    """Return the manifest of a folder; an empty one where it is damaged or being written."""
    return table_in(folder / MANIFEST)


def table_in(path: Path) -> dict[str, Any]:
    """Return the table in a JSON file; an empty one where there is none, or no whole one."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def textures_of(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return the file of each texture of a manifest, by the name of its map, with a number from 1 where that has several."""
    maps = [entry["map"] for entry in _entries(manifest)]
    found: dict[str, str] = {}
    for number, entry in enumerate(_entries(manifest)):
        name = entry["map"]
        found[f"{name}_{maps[: number + 1].count(name)}" if maps.count(name) > 1 else name] = entry["file"]
    return found


def maps_of(manifest: Mapping[str, Any], files: Iterable[str]) -> list[str]:
    """Return the maps that some files are textures of, each once."""
    files = set(files)
    return list(dict.fromkeys(entry["map"] for entry in _entries(manifest) if entry["file"] in files))


def files_of(manifest: Mapping[str, Any], maps: Iterable[str]) -> list[str]:
    """Return the files of some maps."""
    maps = set(maps)
    return [entry["file"] for entry in _entries(manifest) if entry["map"] in maps]


def _entries(manifest: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    entries = manifest.get("textures", ())
    good = isinstance(entries, list) and all(isinstance(one, dict) and {"map", "file"} <= one.keys() for one in entries)
    return entries if good else []
