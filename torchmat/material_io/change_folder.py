"""A material folder changed in place: the files of the maps that change are written anew, all others keep their bytes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch

from torchmat import atomic
from torchmat.errors import RangeError, message
from torchmat.material_io.folder import MANIFEST, check_target, manifest_of, write_texture
from torchmat.material_io.read_folder import load_material, read_manifest
from torchmat.material_io.uncertainty_textures import KEY as UNCERTAINTY
from torchmat.material_io.uncertainty_textures import without
from torchmat.models import Material
from torchmat.swap import swapping
from torchmat.written import DIGESTS, EDITED, changed_files, digest_of, write_table

EDITS = "edits"


class Changed(NamedTuple):
    """What a change did: the `folder`, its `maps` that are others now, the `files` that were written, and the `backup`."""

    folder: Path
    maps: tuple[str, ...]
    files: tuple[str, ...]
    backup: Path | None


def change_material(
    folder: str | Path, change: Callable[[Material], Material], record: Mapping[str, Any] | None = None,
    out: str | Path | None = None, force: bool = False,
) -> Changed:
    """Change the material in a folder, whole or not at all: only the files of the maps that change are written.

    Args:
        folder: a material folder.
        change: function from the material to the changed one, of the same model and size.
        record: what the manifest says of the change, in its list of edits; None is nothing.
        out: another folder for the result, with copies of all other files; None changes `folder` itself. A file that was
            painted and is now written anew stays in a backup of the folder, ``NAME.backup-1``.
        force: of another folder: replace it whatever was painted there, and keep a backup.

    Raises DataError when the folder is no material or cannot be written, RangeError for another model or size, and what
    `change` raises.
    """
    source, target = Path(folder), Path(out if out is not None else folder)
    aside = check_target(target, force) if out is not None else False
    manifest, before = read_manifest(source), load_material(source)
    after = change(before)
    if (after.name, after.size) != (before.name, before.size):
        fact = f"{before.name} of {before.size} becomes {after.name} of {after.size}"
        step = "Save it as another."
        raise RangeError(message(str(source), "the changed material", "keep its model and size", fact, step))
    kept = unchanged(before, after)
    old = [entry for entry in manifest["textures"] if entry["map"] in before.maps]
    ours = manifest.get(DIGESTS, {})
    gone = {entry["file"] for entry in old if entry["map"] not in kept}
    fresh = {texture.file for texture in after.textures() if texture.spec.name not in kept}
    errors, stale = without(manifest[UNCERTAINTY], {*before.maps, *after.maps} - kept) if UNCERTAINTY in manifest else ({}, [])
    gone = {name for name in (*gone, *stale) if name in ours} | {name for name in fresh if (source / name).exists()}
    if out is None:
        painted = changed_files(source / MANIFEST, edits=False)
        aside = bool(gone) and (painted is None or not gone.isdisjoint(painted) or not gone <= ours.keys())
    backup = atomic.backup_name(target) if aside else None
    with swapping(source, gone, target, backup=aside) as building:
        new = [write_texture(building, texture) for texture in after.textures() if texture.spec.name not in kept]
        entries = [entry for entry in old if entry["map"] in kept] + new
        order = [spec.name for spec in after.specs()]
        entries.sort(key=lambda entry: order.index(entry["map"]))
        written = [entry["file"] for entry in new]
        table = _manifest(manifest, after, entries, kept, record, [*written, *gone])
        table.pop(UNCERTAINTY, None)
        table |= {UNCERTAINTY: errors} if errors else {}  # of a map that is another now they say nothing
        digests = {**ours, **{name: digest_of(building / name) for name in written}}
        digests = {name: digest for name, digest in digests.items() if (building / name).is_file()}
        write_table(building / MANIFEST, table, digests)
    others = {name for name in (*before.maps, *after.maps) if name not in kept}
    return Changed(target, tuple(sorted(others)), tuple(sorted(written)), backup)


def unchanged(before: Material, after: Material) -> set[str]:
    """Return the maps that are the same to the bit, and stored alike."""
    ways = [{spec.name: spec for spec in material.specs()} for material in (before, after)]
    return {
        name for name, spec in ways[1].items()
        if ways[0].get(name) == spec and before.stored.get(name) == after.stored.get(name)
        and before.storage == after.storage and torch.equal(before.maps[name], after.maps[name])
    }


def _manifest(
    old: dict[str, Any], after: Material, entries: list[dict[str, Any]], kept: set[str], record: Mapping[str, Any] | None,
    touched: list[str],
) -> dict[str, Any]:
    """Return the manifest of the changed folder: what `old` says of files that stay, stays."""
    table = {**old, **manifest_of(after, entries, old.get("provenance"))}
    small = {name: one for name, one in old.get("stored", {}).items() if name in kept}
    stored = {**table.get("stored", {}), **small} if after.stored else small
    table.pop("stored", None)
    if stored:
        table["stored"] = stored
    table["version"] = max(old["version"], table["version"])
    table[EDITED] = sorted({*old.get(EDITED, ()), *touched, *([] if touched else [MANIFEST])})
    table[EDITS] = [*old.get(EDITS, ()), *([] if record is None else [dict(record)])]
    return table
