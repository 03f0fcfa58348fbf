"""Folders and files that appear whole or not at all.

A folder is built beside its target under a hidden name and then swapped in with one rename, so that a crash, a kill
or a full disk leaves either what was there before or what should be there, never half of it.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from torchmat.errors import DataError, message

_EXCHANGE = 2  # RENAME_EXCHANGE of linux/fs.h
_AT_FDCWD = -100
_ASIDE = "-old"
Late = Callable[[Path, Path], None]
INSTALLED: list[Path] = []  # the folders and files that this process has put in their places, for whoever is stopped


class Unwritable(DataError):
    """A file or folder cannot be written: what is wrong is its place, not what was to be written."""


def _process_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _prefix(target: Path) -> str:
    return f".{target.name}.building-"


def _sweep(target: Path) -> None:
    """Remove what builders of the same target left behind when they were killed."""
    for stale in list(target.parent.iterdir()):  # no glob: a name may hold [ or *
        if not stale.name.startswith(_prefix(target)):
            continue
        owner = stale.name.removeprefix(_prefix(target)).split("-")[0]
        if not owner.isdigit() or _process_alive(int(owner)):
            continue
        if stale.name.endswith(_ASIDE) and not target.exists():
            os.rename(stale, target)  # killed between the two renames of `_install`
        else:
            shutil.rmtree(stale, ignore_errors=True)


def _exchange(first: Path, second: Path) -> bool:
    """Swap two folders in one step where the system can (Linux); return False where it cannot."""
    if not sys.platform.startswith("linux"):
        return False
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if call is None:
        return False
    return call(_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _EXCHANGE) == 0


def _sync(folder: Path) -> None:
    """Flush a folder's files, so that the rename never becomes durable before the content."""
    for path in folder.rglob("*"):
        if path.is_file():
            with open(path, "rb") as stream:
                os.fsync(stream.fileno())


def _install(built: Path, target: Path, backup: bool, late: Late) -> None:
    if not target.exists():
        os.rename(built, target)
        return
    if backup:
        # Whatever happens between the two, the old folder stands under the one name or the other.
        kept = backup_name(target)
        os.rename(target, kept)
        try:
            os.rename(built, target)
        except OSError:
            os.rename(kept, target)
            raise
        late(kept, target)
        return
    if _exchange(built, target):
        late(built, target)
        shutil.rmtree(built, ignore_errors=True)  # the new folder stands; a rest is swept next time
        return
    # Without an exchange there is a moment with neither; the old folder then stands under the hidden name.
    aside = built.with_name(built.name + _ASIDE)
    os.rename(target, aside)
    try:
        os.rename(built, target)
    except OSError:
        os.rename(aside, target)
        raise
    late(aside, target)
    shutil.rmtree(aside, ignore_errors=True)


def backup_name(target: Path) -> Path:
    """Return the first free name among ``NAME.backup-1``, ``NAME.backup-2`` ... beside a file or folder."""
    return free_name(target, "backup")


def free_name(target: Path, word: str) -> Path:
    """Return the first free name among ``NAME.word-1``, ``NAME.word-2`` ... beside a file or folder."""
    target = Path(os.path.realpath(target))
    names = (target.with_name(f"{target.name}.{word}-{number}") for number in itertools.count(1))
    return next(name for name in names if not os.path.lexists(name))


def refuse_foreign(
    target: Path, known: Callable[[str], bool], what: str, changed: Sequence[str] | None = (), force: bool = False
) -> bool:
    """Raise DataError unless `target` is absent, or a folder of which `known` recognises every file and none is `changed`.

    `known` is asked for names relative to the folder, with forward slashes; `what` names what may stand there. `changed`
    None says that nobody knows. With `force` a folder that holds something of the kind may be replaced whatever is in
    it: True is returned when something of it is the user's, so that a backup must be kept.
    """
    step = "Choose another folder, or move what is there."
    if os.path.exists(target) and not os.path.isdir(target):
        raise DataError(message(str(target), "the target", "be a folder", "it is a file", step))
    if not os.path.isdir(target):
        return False
    files = sorted(path.relative_to(target).as_posix() for path in target.rglob("*") if not path.is_dir())
    foreign = [name for name in files if not known(name)]
    if len(foreign) < len(files):
        step = f"{step} With --force (force=True) it is replaced, and kept as {backup_name(target).name}."
    if foreign and not (force and len(foreign) < len(files)):
        fact = f"{len(foreign)} of {len(files)} files there are something else, first {foreign[0]!r}"
        raise DataError(message(str(target), "the target", f"be empty or {what} and nothing else", fact, step))
    unsure = changed is None and bool(files)
    if (changed or unsure) and not force:
        fact = "it was written by an earlier torchmat, which kept no digests to tell"
        if changed:
            fact = f"{len(changed)} files were changed since, first {changed[0]!r}"
        raise DataError(message(str(target), "what stands there", "be as torchmat wrote it to be replaced", fact, step))
    return bool(foreign or changed or unsure)


@contextmanager
def building(
    target: str | Path, durable: bool = True, backup: bool = False, late: Late = lambda old, new: None
) -> Iterator[Path]:
    """Yield an empty folder beside `target`; swap it in as `target` when the block ends without an error.

    `durable` flushes the files first; what is not durable is no result either (`INSTALLED`). With `backup` what stood
    there stays, as `backup_name` calls it. `late` is called with the old folder and the new one once they are swapped,
    before the old one goes. Raises Unwritable, which names the folder, when it cannot be made; whatever the
    block raises passes through after the half-built folder is removed and the old one left as it was.
    """
    try:
        target = Path(os.path.realpath(target))  # a link to a folder stays a link, and what it points to is replaced
        target.parent.mkdir(parents=True, exist_ok=True)
        _sweep(target)
        built = Path(tempfile.mkdtemp(prefix=f"{_prefix(target)}{os.getpid()}-", dir=target.parent))
        built.chmod(0o755)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        step = "Choose a folder that can be written to."
        raise Unwritable(message(str(target), "the folder", "be writable", str(error), step)) from error
    try:
        yield built
        if durable:
            _sync(built)
        _install(built, target, backup, late)
        if durable:
            INSTALLED.append(target)
    except OSError as error:
        step = "Free some space or choose another folder; what was there before is untouched."
        raise Unwritable(message(str(target), "the folder", "be written whole", str(error), step)) from error
    finally:
        shutil.rmtree(built, ignore_errors=True)


@contextmanager
def building_file(target: str | Path, backup: bool = False) -> Iterator[Path]:
    """Yield a path of the same name in a hidden folder beside `target`; move the file there when the block ends.

    So the file appears whole or not at all, and one that was there before stays until then; a link stays a link. With
    `backup` the old one stays, as `backup_name` calls it. Raises
    Unwritable, which names the file, when it cannot be written; whatever else the block raises passes through.
    """
    try:
        target = Path(os.path.realpath(target))
        target.parent.mkdir(parents=True, exist_ok=True)
        _sweep(target)
        built = Path(tempfile.mkdtemp(prefix=f"{_prefix(target)}{os.getpid()}-", dir=target.parent))
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        step = "Choose a folder that can be written to."
        raise Unwritable(message(str(target), "the file", "be writable", str(error), step)) from error
    try:
        yield built / target.name
        _sync(built)
        if backup and target.exists():
            shutil.copy2(target, backup_name(target))
        os.replace(built / target.name, target)
        INSTALLED.append(target)
    except OSError as error:
        step = "Free some space or choose another path; what was there before is untouched."
        raise Unwritable(message(str(target), "the file", "be written whole", str(error), step)) from error
    finally:
        shutil.rmtree(built, ignore_errors=True)
