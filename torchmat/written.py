"""Whose a file in an output folder is: torchmat's as long as it is as torchmat wrote it, and the user's once it was changed.

A record (a JSON file such as ``manifest.json``) keeps a digest of every file that was written beside it, and of itself.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

DIGESTS = "digests"
EDITED = "edited"  # names of files that an edit wrote: the user's work, though torchmat wrote it


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as hexadecimal digits."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def digest_of_tree(path: Path) -> str:
    """Return one SHA-256 of a file's bytes, or of the names and bytes of all files below a folder."""
    if not path.is_dir():
        return digest_of(path)
    found = hashlib.sha256()
    for name in files_below(path):
        found.update(f"{name}\0{digest_of(path / name)}\n".encode("utf-8", "surrogateescape"))
    return found.hexdigest()


def files_below(folder: Path) -> list[str]:
    """Return the names of the files in a folder and its subfolders, relative to it and with forward slashes."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def _of_table(table: Mapping[str, Any]) -> str:
    # Of the content, not of its layout: an editor may indent a file as it likes.
    content = {name: value for name, value in table.items() if name != DIGESTS}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def write_record(record: Path, table: Mapping[str, Any], names: Iterable[str] | None = None) -> None:
    """Write `table` as JSON with the digests of `names` beside it (all files in its folder) and of itself."""
    names = files_below(record.parent) if names is None else names
    digests = {name: digest_of(record.parent / name) for name in names if name != record.name}
    write_table(record, table, digests)


def write_table(record: Path, table: Mapping[str, Any], digests: Mapping[str, str]) -> None:
    """Write `table` as JSON with these digests of other files, and with one of itself."""
    table = json.loads(json.dumps({name: value for name, value in table.items() if name != DIGESTS}))
    whole = {**table, DIGESTS: {**digests, record.name: _of_table(table)}}
    record.write_text(json.dumps(whole, indent=1, ensure_ascii=False), encoding="utf-8")


def changed_files(record: Path, edits: bool = True) -> list[str] | None:
    """Return the files beside a record, itself among them, that are not as they were written; with `edits` those too that
    an edit wrote.

    None when the record says nothing of it, as those of earlier versions do. Files that are gone are not listed.
    """
    try:
        table = json.loads(record.read_text(encoding="utf-8"))
        digests = {str(name): str(digest) for name, digest in table[DIGESTS].items()}
        edited = [str(name) for name in table.get(EDITED, ())] if edits else []
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    found = set(edited)
    for name, digest in digests.items():
        path = record.parent / name
        if path.is_file() and (_of_table(table) if name == record.name else digest_of(path)) != digest:
            found.add(name)
    return sorted(found)
