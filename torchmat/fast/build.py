"""A compiled part: C of this package, made by the machine's own compiler, kept in the cache folder; one for each precision.

Its name there holds what it depends on: the source, the compiler, the processor. So parts of other versions and of other
machines that share the folder are never met, and two processes that compile at once end with the same file.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from torchmat.cache_place import cache_place
from torchmat.errors import DataError

FOLDER = Path(__file__).parent
SOURCE, VERSION = "kernels.c", 2
_COMPILERS = ("cc", "gcc", "clang")
_SECONDS = 120  # that a compiler may take; it takes two
_ENDING = ".so"
# No flag may let sums be taken in another order: bits would hang on the compiler's mood.
_ALWAYS = ("-O3", "-fPIC", "-std=gnu11", "-fno-math-errno", "-fno-trapping-math", "-w")


class NotBuilt(Exception):
    """There is no compiled part, and why."""


def build(double: bool = False) -> ctypes.CDLL:
    """Return the compiled part of this machine and precision, which is made first where it is not kept. Raises NotBuilt, with why.

    What cannot be kept is not made: each process would wait for the compiler anew.
    """
    compiler = [*find_compiler(), *(["-DDOUBLE"] if double else [])]
    step = "TORCHMAT_CACHE names another one"
    try:
        kept = cache_place() / "compiled"
    except DataError as error:
        raise NotBuilt(f"there is no cache folder to keep a compiled part in; {step}") from error
    name = key(compiler)
    found = _kept(kept, name)
    if found is not None:
        return found
    try:
        kept.mkdir(parents=True, exist_ok=True)
        return _made(compiler, kept, name)
    except OSError as error:
        raise NotBuilt(f"the cache folder cannot be written ({error.strerror or error}); {step}") from error


def find_compiler() -> list[str]:
    """Return the command of the C compiler: that of the variable CC, else the first of cc, gcc and clang."""
    asked = shlex.split(os.environ.get("CC", ""))
    for command in [asked] if asked else [[name] for name in _COMPILERS]:
        found = shutil.which(command[0])
        if found:
            return [found, *command[1:]]
    raise NotBuilt("no compiler found" if not asked else f"no compiler found: CC is {asked[0]!r}")


def key(compiler: Sequence[str]) -> str:
    """Return what the name of the compiled part begins with: a digest of source, compiler, flags and processor."""
    parts = [path.read_bytes() for path in sorted(FOLDER.iterdir()) if path.suffix in (".c", ".h")]
    program = Path(compiler[0]).resolve()
    with suppress(OSError):
        about = program.stat()
        parts.append(f"{program} {about.st_size} {about.st_mtime_ns}".encode())
    return hashlib.sha256(b"\0".join([*parts, " ".join([*compiler, *_ALWAYS]).encode(), processor().encode()])).hexdigest()[:24]


def processor() -> str:
    """Return what the processor is and can do, as far as the system says."""
    found = f"{platform.system()} {platform.machine()} {platform.processor()}"
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        named = {line.split(":")[0].strip(): line for line in reversed(lines) if ":" in line}
        found += "".join(named.get(name, "") for name in ("model name", "flags", "Features", "CPU part"))
    return found


def _kept(folder: Path, name: str) -> ctypes.CDLL | None:
    """Return the part of this name that is kept, None where there is none that is whole: loading half a one ends the process."""
    with suppress(OSError):
        for path in sorted(folder.glob(f"{name}-*{_ENDING}")):
            if path.name == _name_of(name, path):
                with suppress(OSError, AttributeError, NotBuilt):
                    return load(path)
    return None


def _name_of(name: str, path: Path) -> str:
    """Return what a part is kept as, which says what is in it."""
    return f"{name}-{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}{_ENDING}"


def load(path: Path) -> ctypes.CDLL:
    """Load a compiled part. Raises OSError where it is none, NotBuilt where it is another version's."""
    library = ctypes.CDLL(str(path))
    if library.torchmat_version() != VERSION:
        raise NotBuilt("the compiled part is another version's")
    return library


def _ways(compiler: Sequence[str], folder: Path, result: Path) -> list[list[list[str]]]:
    """Return the ways to compile, the best first, each a list of commands.

    The first takes the threads of the OpenMP that torch has loaded: two of them in one process would wait for each other.
    """
    source, middle = str(FOLDER / SOURCE), str(folder / "kernels.o")
    own = [*compiler, *_ALWAYS, "-march=native"]
    return [
        [[*own, "-fopenmp", "-c", source, "-o", middle], [*compiler, "-shared", middle, "-o", str(result), "-lm"]],
        [[*own, "-fopenmp", "-shared", source, "-o", str(result), "-lm"]],
        [[*own, "-shared", source, "-o", str(result), "-lm"]],
        [[*compiler, *_ALWAYS, "-shared", source, "-o", str(result), "-lm"]],
    ]


def _made(compiler: Sequence[str], folder: Path, name: str) -> ctypes.CDLL:
    """Compile in a folder of its own within `folder`, load, and keep the result there under a name that begins so."""
    place = Path(tempfile.mkdtemp(prefix=".compiling-", dir=folder))
    try:
        failed = ""
        for commands in _ways(compiler, place, place / "kernels.so"):
            failed = _run(commands)
            if failed:
                continue
            try:
                library = load(place / "kernels.so")
            except (OSError, AttributeError) as error:
                failed = f"what the compiler made cannot be loaded: {_line(str(error))}"
                continue
            os.replace(place / "kernels.so", folder / _name_of(name, place / "kernels.so"))
            return library
        raise NotBuilt(failed)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _run(commands: Sequence[Sequence[str]]) -> str:
    """Run commands one after the other; return why they failed, an empty text where they did not."""
    for command in commands:
        try:
            done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=_SECONDS, stdin=subprocess.DEVNULL)
        except subprocess.TimeoutExpired:
            return f"the compiler took more than {_SECONDS} s"
        except OSError as error:
            return f"the compiler {command[0]} does not run: {_line(str(error))}"
        if done.returncode:
            return f"the compiler {command[0]} failed: {_line(done.stderr) or f'exit code {done.returncode}'}"
    return ""


def _line(text: str) -> str:
    """Return the first line that speaks of an error, else the first that says something, shortened."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    told = [line for line in lines if "error" in line.lower()] or lines
    return told[0][:200] if told else ""
