"""Saves become what is shown: at once where a file is whole, and when it is, where it is not yet.

What was saved again before it was read is read once. A damaged file is looked at again while its program may still write.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import TYPE_CHECKING

from torchmat.errors import TorchmatError
from torchmat.studio.place import MANIFEST
from torchmat.studio.textures import files_of, manifest_in, maps_of, textures_of
from torchmat.studio.watch import QUIET, TRIES, Watch

if TYPE_CHECKING:
    from torchmat.studio.live import Live


class Follower:
    """Follows the saves that `watch` sees for a studio."""

    def __init__(self, live: Live, watch: Watch) -> None:
        self._live, self._watch = live, watch
        self._waiting: dict[str, int] = {}  # maps to read, and how often that was tried
        self._unsure: set[str] = set()  # maps that are looked at again soon
        self._all = False  # whether the manifest was saved
        self._saved: list[str] = []  # files that the history has not seen yet
        self._wake, self._kept = asyncio.Event(), asyncio.Event()

    async def run(self) -> None:
        """Follow them until the watch ends."""
        reading, keeping = self._live.start(self._read()), self._live.start(self._remember())
        try:
            async for names in self._watch.changes():
                self.saved(names)
        finally:
            reading.cancel()
            keeping.cancel()

    def saved(self, names: list[str]) -> None:
        """Take note of files that were saved."""
        manifest = manifest_in(self._live.place.folder)
        textures = textures_of(manifest)
        followed = [file for texture, file in textures.items() if file in names and texture not in self._live.settings.still]
        self._all |= MANIFEST in names
        self.wait_for(maps_of(manifest, followed))
        self._saved += names

    def wait_for(self, maps: Iterable[str], tries: int = 0) -> None:
        """Let maps be read."""
        self._waiting |= dict.fromkeys(maps, tries)
        self._wake.set()

    async def _read(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            if self._all:
                self._all = False
                await self._live.reload()
            tries, self._waiting = self._waiting, {}
            if tries:
                await self._read_maps(tries)
            if self._saved and not self._unsure:
                self._kept.set()

    async def _read_maps(self, tries: dict[str, int]) -> None:
        try:
            found = await self._live.worker.call("read", names=list(tries))
            answer = self._live.noted(found, files_of(manifest_in(self._live.place.folder), tries))
        except TorchmatError as error:
            self._live.say("material", "error", str(error))
            return
        self._live.put_maps(answer["maps"])
        self._unsure -= set(tries)
        self._mark(tries, answer["failed"])
        for name, text in answer["failed"].items():
            if tries[name] + 1 >= TRIES:
                self._live.say(name, "error", f"{text} The last good one is shown.")
                continue
            self._unsure.add(name)
            asyncio.get_running_loop().call_later(QUIET, self._again, name, tries[name] + 1)

    def _mark(self, read: Iterable[str], failed: Iterable[str]) -> None:
        """Let the history keep the last good file in the place of a damaged one: that is no state to go back to."""
        history, manifest = self._live.history, manifest_in(self._live.place.folder)
        if history is not None:
            history.damaged -= set(files_of(manifest, read))
            history.damaged |= set(files_of(manifest, failed))

    def _again(self, name: str, tries: int) -> None:
        if name not in self._waiting:  # else it was saved again meanwhile
            self.wait_for([name], tries)

    async def _remember(self) -> None:
        while True:
            await self._kept.wait()
            self._kept.clear()
            names, self._saved = list(dict.fromkeys(self._saved)), []
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            await self._live.remember(f"saved {', '.join(names[:3])}{more}")
