"""Saves seen as they happen: by the system's notices, and by a look once a second for what those miss.

Notices only say when to look; what changed is found by looking. So it does not matter whether a program saves in place, by
a rename, or whether a command puts a whole new folder in the old one's place.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterable
from pathlib import Path
from typing import Any

from torchmat.swap import Signature, signature_of

_LOOK = 1.0  # seconds between two looks without a notice
_STEP_MS, _GATHER_MS = 1, 20  # of quiet, and at most, that notices are gathered for
QUIET = 0.1  # seconds without a save after which a damaged file counts as damaged, and not as half written
TRIES = 4  # looks at it, QUIET apart, until then


class Watch:
    """The files of a folder: `names` returns those that matter. `changes` yields the names of those that were saved."""

    def __init__(self, folder: Path, names: Callable[[], Iterable[str]]) -> None:
        self._folder, self._names = folder, names
        self.seen: dict[str, Signature | None] = {}
        self._stop = asyncio.Event()
        self.look()

    def look(self) -> list[str]:
        """Return the names of the files that are others than when they were last looked at."""
        now = {name: signature_of(self._folder / name) for name in self._names()}
        changed = [name for name, signature in now.items() if signature != self.seen.get(name)]
        self.seen = now
        return changed

    def forget(self, name: str) -> None:
        """Let the next look find a file changed, whatever it is: to try it again."""
        self.seen[name] = (0, 0, 0)

    def stop(self) -> None:
        """End `changes`."""
        self._stop.set()

    async def changes(self) -> AsyncIterator[list[str]]:
        """Yield the names of the files that were saved, as soon as they were, until `stop`."""
        wake = asyncio.Event()
        notices = asyncio.create_task(self._notices(wake))
        try:
            while not self._stop.is_set():
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(wake.wait(), _LOOK)
                wake.clear()
                changed = self.look()
                if changed:
                    yield changed
        finally:
            self._stop.set()
            notices.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await notices

    async def _notices(self, wake: asyncio.Event) -> None:
        """Set `wake` at each notice about the folder; a folder that took its place is watched in its stead."""
        while not self._stop.is_set():
            place = _inode(self._folder)
            try:
                async for _ in _events(self._folder, self._stop):
                    wake.set()
                    if _inode(self._folder) != place:
                        break  # a notice is about the folder that was there when the watch began
            except (OSError, RuntimeError):  # gone, or no more notices to be had: the looks remain
                await asyncio.sleep(_LOOK)
            wake.set()


def _events(folder: Path, stop: asyncio.Event) -> Any:
    from watchfiles import awatch

    # Of the folder around it too, for a folder that is replaced by another says nothing itself.
    return awatch(
        folder, folder.parent, watch_filter=None, recursive=False, step=_STEP_MS, debounce=_GATHER_MS, stop_event=stop,
        rust_timeout=1000, yield_on_timeout=True,
    )


def _inode(folder: Path) -> int:
    try:
        return folder.stat().st_ino
    except OSError:
        return 0
