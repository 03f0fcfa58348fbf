"""A folder of which some files are replaced, whole or not at all, while other programs go on saving into it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from torchmat import atomic
from torchmat.written import files_below

Signature = tuple[int, int, int]


def signature_of(path: Path) -> Signature | None:
    """Return what changes when a file is written: time, size and place on the disk; None where there is none."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino


@contextmanager
def swapping(source: Path, gone: Collection[str], target: Path | None = None, backup: bool = False) -> Iterator[Path]:
    """Yield a folder that takes the place of `target` (None: of `source` itself) when the block ends, as `atomic.building`.

    The files of `source` but those in `gone` stand in it already. What another program saves into `source` meanwhile is
    carried over, over what the block wrote too: a save of the user's is never lost. With `backup` the old folder stays.
    """
    target = source if target is None else target
    in_place = os.path.realpath(target) == os.path.realpath(source)
    before = {name: signature_of(source / name) for name in files_below(source)}

    def late(old: Path, new: Path) -> None:
        for name in files_below(old) if in_place else ():
            now = signature_of(old / name)
            if now is None or now == before.get(name):
                continue
            there = signature_of(new / name)
            if there is None or there[2] != now[2]:  # one file under two names has the save already
                _copy_whole(old / name, new / name)

    with atomic.building(target, backup=backup, late=late) as building:
        for name in before:
            if name not in gone:
                (building / name).parent.mkdir(parents=True, exist_ok=True)
                _carry(source / name, building / name, link=in_place and not backup)
        yield building


def replace_files(folder: Path, files: Mapping[str, Path | None]) -> None:
    """Put copies of other files in the place of some in a folder, None for none: all of them or not one.

    Raises Unwritable, which names the folder, when that cannot be done.
    """
    with swapping(folder, files) as building:
        for name, path in files.items():
            if path is not None:
                (building / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, building / name)


def _carry(old: Path, new: Path, link: bool) -> None:
    # The same file under both names: a program that is in the midst of saving into it saves into either folder.
    if link and not old.is_symlink():
        try:
            os.link(old, new)
            return
        except OSError:  # a disk without links
            pass
    shutil.copy2(old, new)


def _copy_whole(old: Path, new: Path) -> None:
    new.parent.mkdir(parents=True, exist_ok=True)
    partial = new.with_name(f".{new.name}.partial-{os.getpid()}")
    shutil.copy2(old, partial)
    os.replace(partial, new)
