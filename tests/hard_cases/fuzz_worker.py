"""One process that reads changed files and says what came of each; whatever kills it, kills nothing else."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
import traceback
import warnings
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random

from tests.hard_cases.fuzz_inputs import MADE
from tests.hard_cases.fuzz_readers import BY_NAME, Reader, digest
from tests.hard_cases.mutate import NAMES, Change, cut, flip, in_bytes, in_table
from tests.hard_cases.mutate_formats import (
    dfmf_fields, glb_fields, hdf5_fields, image_fields, in_glb, in_json, in_png, in_zip, lying_zip, merl_fields, stl_fields, tensor_fields,
    zip_fields,
)

from torchmat import TorchmatError

SECONDS = 3.0  # of processor time; the slowest good input takes a tenth of one
MEGABYTES = 48.0  # beside twice what the good input takes: of an allocator that keeps what it once had
REFUSED, ACCEPTED = "refused", "accepted"
Tree = dict[str, "bytes | Path | None"]  # content, target of a link, or None for a folder

_FIELDS = {
    ".zip": zip_fields, ".npz": zip_fields, ".glb": glb_fields, ".bsdf": tensor_fields, ".binary": merl_fields,
    ".stl": stl_fields, ".btf": dfmf_fields, ".h5": hdf5_fields,
    **dict.fromkeys((".jpg", ".exr", ".tif", ".hdr", ".bmp", ".tga", ".ppm"), image_fields),
}
_CHANGES: dict[str, tuple[Change, ...]] = {
    ".csv": (in_table, in_table), ".lp": (in_table, in_table), ".txt": (in_table,), ".obj": (in_table,),
    ".off": (in_table,),
    ".toml": (in_table,), ".json": (in_json, in_json, in_json), ".gltf": (in_json, in_json), ".glb": (in_glb, in_glb),
    ".zip": (in_zip, lying_zip), ".npz": (in_zip, lying_zip), ".png": (in_png, in_png),
}


def tree_of(folder: Path) -> Tree:
    """Return everything below a folder by relative name."""
    found: Tree = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        found[name] = Path(os.readlink(path)) if path.is_symlink() else None if path.is_dir() else path.read_bytes()
    return found


def put_tree(folder: Path, tree: Tree) -> None:
    """Write what `tree_of` returned, and what mistakes made of it."""
    for name, content in tree.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content is None:
            path.mkdir(exist_ok=True)
        elif isinstance(content, Path):
            path.symlink_to(content)
        else:
            path.write_bytes(content)
            os.utime(path, MADE)


def mutated(reader: Reader, good: Tree, chance: Random) -> tuple[Tree, str]:
    """Return a changed input and the way that it was changed in."""
    tree = dict(good)
    names = [name for name, content in good.items() if isinstance(content, bytes) and name.endswith(reader.mutable)]
    name = chance.choice(names)
    data, kind, way = tree[name], Path(name).suffix.lower(), chance.random()
    fields = _FIELDS[kind](data) if kind in _FIELDS else ()
    if reader.by_name and chance.random() < 0.5:
        tree[_renamed(name, chance)] = tree.pop(name)
        return tree, "name"
    if way < 0.1:
        return _in_folder(tree, name, names, chance), "folder"
    if way < 0.22:
        tree[name] = cut(data, chance, fields)
        return tree, "cut"
    if way < 0.3:
        tree[name] = flip(data, chance)
        return tree, "flip"
    change = chance.choice((*_CHANGES.get(kind, ()), in_bytes))
    tree[name] = in_bytes(data, chance, fields) if change is in_bytes else change(data, chance)
    return tree, change.__name__


def _renamed(name: str, chance: Random) -> str:
    """Change one or two letters of a name."""
    letters = list(name)
    for _ in range(chance.choice((1, 1, 2))):
        place = chance.randrange(len(letters))
        put = chance.choice(("", *"0123456789 _tplv-.TL", "\u0663", "00"))
        letters[place : place + chance.choice((0, 1, 1, 1))] = put
    return "".join(letters) or "0"


def _in_folder(tree: Tree, name: str, names: list[str], chance: Random) -> Tree:
    """Change what files there are: empty, missing, another's content, another name, a folder or a link in its place."""
    way = chance.randrange(8)
    other = chance.choice(names)
    if way == 0:
        tree[name] = b""
    elif way == 1:
        del tree[name]
    elif way == 2:
        tree[name] = tree[other]
    elif way == 3:
        tree[name], tree[other] = tree[other], tree[name]
    elif way == 4:
        tree[name] = None
    elif way == 5:
        targets = ("nowhere", ".", "..", "/dev/zero", "/dev/null", Path(name).name, "/etc/hostname")
        tree[name] = Path(chance.choice(targets))
    elif way == 6:
        kinds = (b"solid text", b"\0" * 1000, b"{}", b"[]", b"null", b"\xef\xbb\xbf", b"GIF89a", b"%PDF-1.4\n")
        tree[name] = chance.choice(kinds)
    else:
        possible = [new for new in NAMES if new.strip(".") and not set(new) & set("/\0") and len(new) < 200]
        new = chance.choice(possible)
        content = tree.pop(name)
        tree[str(Path(name).with_name(new))] = content
    return tree


def _peak_megabytes() -> float:
    """Return the largest memory the process had since `_reset_peak`."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    return 0.0


def _reset_peak() -> float:
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return float("inf")
    return _peak_megabytes()


def _names_of(root: Path) -> set[str]:
    return {str(path) for path in root.rglob("*") if "torchmat-cache" not in path.parts and "cache" not in path.parts}


class Judge:
    """Reads one changed input after the other in a folder of its own and says what came of each."""

    def __init__(self, room: Path) -> None:
        self.room = room
        for name in ("tmp", "home", "work"):
            (room / name).mkdir(parents=True, exist_ok=True)
        tempfile.tempdir = str(room / "tmp")
        os.environ.update(HOME=str(room / "home"), TORCHMAT_CACHE=str(room / "torchmat-cache"))
        os.chdir(room / "work")
        self.good: dict[str, tuple[Tree, str, str, float]] = {}

    def prepare(self, reader: Reader) -> tuple[Tree, str, str, float]:
        """Return the good input, what to read in it, its digest and the megabytes that reading it takes."""
        if reader.name not in self.good:
            folder = self.room / "good"
            folder.mkdir()
            target = reader.put(folder).relative_to(folder).as_posix()
            tree = tree_of(folder)
            reader.read(folder / target)  # imports, and what is made once
            before = _reset_peak()
            found = digest(reader.read(folder / target))
            self.good[reader.name] = tree, target, found, _peak_megabytes() - before
            shutil.rmtree(folder)
        return self.good[reader.name]

    def __call__(self, name: str, number: int, seed: int) -> tuple[str, str]:
        """Return REFUSED, ACCEPTED or what is wrong, and the words of the error."""
        reader = BY_NAME[name]
        good, target, wanted, megabytes = self.prepare(reader)
        tree, way = mutated(reader, good, Random(f"{seed}/{name}/{number}"))
        folder = self.room / "good"  # the same path, so that a store in the cache is of the same source
        folder.mkdir()
        try:
            put_tree(folder, tree)
            return self._read(reader, folder, target, wanted if reader.heals or way in reader.exact else "", megabytes)
        finally:
            shutil.rmtree(folder)

    def _read(self, reader: Reader, folder: Path, target: str, wanted: str, megabytes: float) -> tuple[str, str]:
        names, before, start = _names_of(self.room), _reset_peak(), time.process_time()
        outcome, words = _outcome(reader, folder / target if target != "." else folder, folder, wanted)
        seconds, grown = time.process_time() - start, _peak_megabytes() - before
        if outcome in (REFUSED, ACCEPTED):
            if seconds > SECONDS:
                return "slow", f"{seconds:.1f} s; {words}"
            if grown > 2 * megabytes + MEGABYTES:
                return "memory", f"{grown:.0f} MB for {megabytes:.0f}; {words}"
            if _names_of(self.room) != names:
                return "files left", f"{sorted(_names_of(self.room) ^ names)[:3]}; {words}"
        return outcome, words


def _outcome(reader: Reader, target: Path, folder: Path, wanted: str) -> tuple[str, str]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = digest(reader.read(target))
    except TorchmatError as error:
        if str(folder) in str(error) or reader.names_key:
            return ("refuses what it could heal", str(error)) if reader.heals else (REFUSED, str(error))
        return "names no file", str(error)
    except AssertionError as error:
        return "unsound", f"{error} {_place(error)}"
    except BaseException as error:
        return type(error).__name__, f"{str(error)[:300]} {_place(error)}"
    return ("another result", "") if wanted and found != wanted else (ACCEPTED, "")


def _place(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "torchmat" in frame.filename and "tests" not in frame.filename] or frames
    return f"at {Path(own[-1].filename).name}:{own[-1].lineno} in {own[-1].name}"


def serve(connection: Connection, room: str) -> None:
    """Answer (reader, number, seed) with (outcome, words) until None comes."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # libpng and libjpeg say there what the errors say better
    judge = Judge(Path(room))
    connection.send("ready")
    while (task := connection.recv()) is not None:
        connection.send(judge(*task))
