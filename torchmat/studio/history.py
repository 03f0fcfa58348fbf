"""Every state that a material's files have been in, whoever saved them: by content, bounded, and safe from a crash.

A state is a table of file names and digests; each content is kept once, under its digest. A state is whole on disk before
its line in the journal is written, and the studio takes one before it writes anything itself.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from torchmat.studio.place import write_own
from torchmat.swap import Signature, replace_files, signature_of
from torchmat.written import digest_of

MOST_STATES, MOST_BYTES = 100, 1_000_000_000
_JOURNAL, _CONTENT = "history.json", "content"


@dataclass(frozen=True)
class State:
    """One state: `files` by name with their digests, `when` (seconds since 1970) it was seen, and `what` led to it."""

    files: Mapping[str, str]
    when: float
    what: str


class History:
    """The states of a `folder`, kept in `own`: those that its files had, in the order in which they had them.

    `at` is the number of the state that the folder is in. Undoing goes back in the list. A new state after that stands at
    the end of it, behind the one that it came from: what was undone stays. `names` returns the files that belong to the
    material, by their names.
    """

    def __init__(
        self, folder: Path, own: Path, names: Callable[[], Iterable[str]], most_states: int = MOST_STATES,
        most_bytes: int = MOST_BYTES,
    ) -> None:
        self.folder, self._own, self._names = folder, own, names
        self._most = most_states, most_bytes
        self._known: dict[str, tuple[Signature, str]] = {}  # digests by signature: only what changed is read
        self._sizes: dict[str, int] = {}
        (own / _CONTENT).mkdir(exist_ok=True)
        self.damaged: set[str] = set()  # files of which a state keeps what they were before
        self.states, self.at = self._read()

    def _read(self) -> tuple[list[State], int]:
        try:
            table = json.loads((self._own / _JOURNAL).read_text(encoding="utf-8"))
            states = [State(dict(one["files"]), float(one["when"]), str(one["what"])) for one in table["states"]]
            at = int(table["at"])
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            return [], -1
        there = [all(self._content(digest).is_file() for digest in state.files.values()) for state in states]
        whole = [state for state, kept in zip(states, there, strict=True) if kept]
        return whole, min(sum(there[: at + 1]), len(whole)) - 1

    def _content(self, digest: str) -> Path:
        return self._own / _CONTENT / os.path.basename(digest)

    def take(self, what: str) -> bool:
        """Keep the state that the folder is in, if it is a new one, and say `what` led to it; return whether it was."""
        files = self._now()
        if self.states and dict(self.states[self.at].files) == files:
            return False
        if 0 <= self.at < len(self.states) - 1:
            self.states.append(replace(self.states[self.at], what="undone to here"))
        self.states.append(State(files, time.time(), what))
        self.at = len(self.states) - 1
        self._forget()
        self._write()
        return True

    def _now(self) -> dict[str, str]:
        before = self.states[self.at].files if self.states else {}
        kept = {name: before[name] if name in self.damaged & before.keys() else self._keep(name) for name in self._names()}
        return {name: digest for name, digest in kept.items() if digest}

    def _keep(self, name: str) -> str:
        """Keep the content of one file and return its digest; "" when there is no such file."""
        path = self.folder / name
        signature = signature_of(path)
        if signature is None:
            return ""
        known = self._known.get(name)
        if known and known[0] == signature and self._content(known[1]).is_file():
            return known[1]
        partial = self._own / _CONTENT / f".partial-{os.getpid()}"
        try:
            shutil.copyfile(path, partial)
        except FileNotFoundError:
            return ""
        digest = digest_of(partial)  # of the copy: the file itself may be written meanwhile
        with open(partial, "rb") as stream:
            os.fsync(stream.fileno())
        os.replace(partial, self._content(digest))
        self._known[name] = (signature, digest)
        return digest

    def back_to(self, state: State) -> list[str]:
        """Bring the folder into a state of the list, whole or not at all; return the names of the files that changed.

        What stands there and was not yet seen becomes a state first, so that nothing is lost.
        """
        self.take("unseen changes")
        now = dict(self.states[self.at].files)
        changed = sorted(name for name in {*now, *state.files} if now.get(name) != state.files.get(name))
        if changed:
            contents = {name: self._content(state.files[name]) if name in state.files else None for name in changed}
            replace_files(self.folder, contents)
        self.at = next((number for number, one in enumerate(self.states) if one is state), len(self.states) - 1)
        self._write()
        return changed

    def _write(self) -> None:
        states = [{"files": dict(one.files), "when": one.when, "what": one.what} for one in self.states]
        write_own(self._own / _JOURNAL, {"at": self.at, "states": states})

    def _forget(self) -> None:
        """Drop the oldest states beyond the bounds, and contents that no state names."""
        most, most_bytes = self._most
        kept = len(self.states)
        while len(self.states) > 2 and (len(self.states) > most or self._bytes() > most_bytes):
            del self.states[0]
        self.at -= kept - len(self.states)
        if kept == len(self.states):
            return
        named = self._named()
        for path in list((self._own / _CONTENT).iterdir()):
            if path.name not in named:
                path.unlink(missing_ok=True)
                self._sizes.pop(path.name, None)

    def _named(self) -> set[str]:
        return {digest for state in self.states for digest in state.files.values()}

    def _bytes(self) -> int:
        return sum(self._size(digest) for digest in self._named())

    def _size(self, digest: str) -> int:
        if digest not in self._sizes:
            try:
                self._sizes[digest] = self._content(digest).stat().st_size
            except OSError:
                return 0
        return self._sizes[digest]
