"""What the page shows at the moment: description and maps with their versions, the last of them kept for the next start."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchmat.studio.textures import manifest_in, textures_of
from torchmat.studio.place import MANIFEST
from torchmat.written import digest_of

_KEPT = "first_picture"
_FORMAT = 1


class Shown:
    """A `description` and the `buffers` of its maps; each map has a version, which grows when its bytes are others."""

    def __init__(self) -> None:
        self.description: dict[str, Any] = {}
        self.buffers: dict[str, bytes] = {}
        self.versions: dict[str, int] = {}
        self._last = 0

    def put(self, description: dict[str, Any], buffers: Mapping[str, bytes]) -> tuple[bool, list[str]]:
        """Take a whole material; return whether anything but entries and bytes of maps is another, and the maps that are."""
        before = self.description
        old = {entry["name"]: entry for entry in before.get("maps", ())}
        changed = [
            entry["name"] for entry in description["maps"]
            if old.get(entry["name"]) != entry or self.buffers.get(entry["name"]) != buffers[entry["name"]]
        ]
        names = [entry["name"] for entry in description["maps"]]
        structure = _structure(before) != _structure(description)
        self.description = description
        self.buffers = {name: bytes(buffers[name]) for name in names}
        for name in changed:
            self._new_version(name)
        self.versions = {name: self.versions[name] for name in names}
        return structure, changed

    def put_map(self, name: str, entry: dict[str, Any], data: bytes) -> bool:
        """Take one map; return whether it is another than before."""
        maps = self.description.get("maps", [])
        place = next((number for number, one in enumerate(maps) if one["name"] == name), None)
        if place is None or (maps[place] == entry and self.buffers[name] == data):
            return False
        maps[place] = entry
        self.buffers[name] = data
        self._new_version(name)
        return True

    def entry(self, name: str) -> dict[str, Any]:
        """Return the entry of a map in the description."""
        return next(one for one in self.description["maps"] if one["name"] == name)

    def _new_version(self, name: str) -> None:
        self._last += 1
        self.versions[name] = self._last


def _structure(description: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a page builds its shader from: everything but the maps' sizes and ranges."""
    rest = {key: value for key, value in description.items() if key != "maps"}
    kinds = [(one["name"], one.get("kind"), one.get("layers"), one.get("channels")) for one in description.get("maps", ())]
    return {**rest, "maps": kinds}


def digests_in(folder: Path) -> dict[str, str]:
    """Return the digests of the manifest and of the textures in a folder; of a file that is gone "" stands there."""
    names = [MANIFEST, *textures_of(manifest_in(folder)).values()]
    return {name: digest_of(folder / name) if (folder / name).is_file() else "" for name in names}


def keep(own: Path, digests: Mapping[str, str], shown: Shown) -> None:
    """Keep what is shown for files of these digests, so that the next start needs no torch for it."""
    head = {"format": _FORMAT, "digests": dict(digests), "description": shown.description, "sizes": {}}
    head["sizes"] = {name: len(data) for name, data in shown.buffers.items()}
    partial = own / f".{_KEPT}.partial-{os.getpid()}"
    with open(partial, "wb") as stream:
        stream.write(json.dumps(head).encode() + b"\n")
        for data in shown.buffers.values():
            stream.write(data)
    os.replace(partial, own / _KEPT)


def kept(own: Path, folder: Path) -> tuple[dict[str, Any], dict[str, bytes]] | None:
    """Return the description and buffers that were kept for the very files of a folder; None when there are none."""
    try:
        with open(own / _KEPT, "rb") as stream:
            head = json.loads(stream.readline())
            if head["format"] != _FORMAT or head["digests"] != digests_in(folder):
                return None
            buffers = {name: stream.read(size) for name, size in head["sizes"].items()}
            whole = all(len(buffers[name]) == size for name, size in head["sizes"].items())
            names = [one["name"] for one in head["description"]["maps"]]
            return (head["description"], buffers) if whole and set(names) == buffers.keys() else None
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None
