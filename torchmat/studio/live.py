"""The state of a studio and its pages: saves come in from the folder, wishes from the pages, and what changed goes out."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterable
from typing import Any

from torchmat.errors import DataError, TorchmatError, message
from torchmat.studio.follow import Follower
from torchmat.studio.known import first_of, keep_form
from torchmat.studio.history import History, State
from torchmat.studio.place import MANIFEST, Place, pictures_in
from torchmat.studio.settings import load_settings
from torchmat.studio.shown import Shown, digests_in, keep, kept
from torchmat.studio.textures import manifest_in, textures_of
from torchmat.studio.watch import QUIET, TRIES, Watch
from torchmat.studio.worker import Worker

LOG = logging.getLogger("torchmat.studio")
_PATIENCE = 5.0  # seconds that are left to the first picture, at most
_MOST_WAITING = 500  # messages that wait for a page; one that takes none is let go


class Live:
    """One material in its `place`, read by `worker`; `btf` and `others` are what it can be compared and blended with."""

    def __init__(
        self, place: Place, worker: Worker, others: list[str], btf: str | None, measuring: Worker | None = None
    ) -> None:
        self.measuring = measuring  # what compares with the images, which takes longer than saves may wait
        self.place, self.worker, self.others, self.btf = place, worker, others, btf
        self.failure: TorchmatError | None = None  # of a material that could not be shown at all
        self.failed: Callable[[], None] = lambda: None  # called then
        self.shown = Shown()
        self.settings, wrong = load_settings(place.own)
        self.history = History(place.folder, place.own, self.files) if place.writable else None
        self.says: dict[str, dict[str, Any]] = {}  # what is wrong, by what it is about
        self.pictures: dict[str, bytes] = {}  # of the last comparison
        self.pages: set[asyncio.Queue[dict[str, Any] | None]] = set()
        self.ready = asyncio.Event()
        self.drawn = asyncio.Event()  # a page has drawn a picture
        self.writing = asyncio.Lock()  # one change of the folder at a time
        self.watch: Watch | None = None
        self._tasks: set[asyncio.Task[Any]] = set()
        self._kept: dict[str, str] | None = None
        if wrong:
            self.say("settings", "warning", wrong)
        if not place.writable:
            self.say("folder", "warning", f"{place.folder} cannot be written to: this studio looks, and saves nothing")

    def files(self) -> list[str]:
        """Return the names of the files that the material consists of."""
        found = [MANIFEST, *textures_of(manifest_in(self.place.folder)).values()]
        if len(found) > 1:
            self._names = found
        return getattr(self, "_names", found)  # while the manifest is being written, those of before

    def tell(self, kind: str, **values: Any) -> None:
        """Send a message to all pages; a page that takes none any more is let go."""
        for page in list(self.pages):
            if page.qsize() >= _MOST_WAITING:
                self.pages.discard(page)
                page.put_nowait(None)
                continue
            page.put_nowait({"type": kind, **values})

    def say(self, about: str, level: str, text: str) -> None:
        """Say something about a file or step, in the place of what was said about it before; "" takes that back."""
        if not text:
            if self.says.pop(about, None) is None:
                return
        elif self.says.get(about, {}).get("text") == text:
            return
        else:
            self.says[about] = {"about": about, "level": level, "text": text}
        self.tell("says", about=about, level=level, text=text)

    def start(self, what: Any) -> asyncio.Task[Any]:
        """Run a coroutine beside the others until it ends or the studio does."""
        task = asyncio.get_running_loop().create_task(what)
        self._tasks.add(task)
        task.add_done_callback(self._done)
        return task

    def _done(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and task.exception() is not None:
            LOG.error("studio: %s", task.exception(), exc_info=task.exception())

    async def open(self) -> None:
        """Show what was kept of the last session, if the files are still those, read the folder, and follow it."""
        self.watch = Watch(self.place.folder, self.files)
        found = await asyncio.to_thread(_first, self.place)
        if found is None:
            self.worker.start()
        else:
            self.shown.put(*found)
            self.ready.set()
        await self.remember("opened")
        if found is not None:  # the first picture has the processor for itself
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self.drawn.wait(), _PATIENCE)
        await self.reload()
        self.start(Follower(self, self.watch).run())

    async def close(self) -> None:
        """End everything that was started."""
        if self.watch is not None:
            self.watch.stop()
        for task in list(self._tasks):
            task.cancel()
        for task in list(self._tasks):
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await task
        for page in self.pages:
            page.put_nowait(None)

    def put_maps(self, maps: dict[str, tuple[dict[str, Any], bytes]]) -> None:
        """Show some maps and tell the pages which are others."""
        for name, (entry, data) in maps.items():
            self.say(name, "error", "")
            if self.shown.put_map(name, entry, data):
                self.tell("map", name=name, version=self.shown.versions[name])

    def noted(self, answer: Any, files: Iterable[str] = ()) -> Any:
        """Say what a call warned of, take back what was said of `files` that it read, and return its value."""
        notes = {f"note {text.partition(': ')[0].rpartition('/')[2]}": text for text in answer.notices}
        for about in {f"note {file}" for file in files} - notes.keys():
            self.say(about, "note", "")
        for about, text in notes.items():
            self.say(about, "note", text)
        return answer.value

    async def reload(self) -> None:
        """Read the whole material; what cannot be read leaves what is shown as it is, and is said."""
        for one in range(TRIES):
            try:
                answer = self.noted(await self.worker.call("load"))
            except TorchmatError as error:
                text = str(error)
                if one < TRIES - 1 and self.ready.is_set():
                    await asyncio.sleep(QUIET)
                    continue
                if not self.ready.is_set():
                    self.failure = error
                    self.failed()
                    return
                self.say("material", "error", f"{text} The last good state is shown.")
                return
            self.say("material", "error", "")
            self.put(answer)
            self.start(asyncio.to_thread(self._keep))
            return

    def put(self, answer: dict[str, Any]) -> None:
        """Show a whole material and tell the pages what of it is another."""
        structure, changed = self.shown.put(answer["description"], answer["buffers"])
        if structure or not self.ready.is_set():
            self.tell("material")
        else:
            for name in changed:
                self.tell("map", name=name, version=self.shown.versions[name])
        self.ready.set()

    def _keep(self) -> None:
        with contextlib.suppress(OSError):  # a full disk takes nothing but the quick start
            digests = digests_in(self.place.folder)
            if digests != self._kept:
                keep(self.place.own, digests, self.shown)
                keep_form(self.place.folder, self.shown.description)
                self._kept = digests

    async def remember(self, what: str) -> None:
        """Keep the state of the folder for undo."""
        if self.history is None:
            return
        try:
            async with self.writing:
                new = await asyncio.to_thread(self.history.take, what)
        except OSError as error:
            self.say("history", "error", f"the history cannot be kept: {error}. Free some space; undo knows nothing of later saves")
            return
        self.say("history", "error", "")
        if new:
            self.tell("history", **self.history_table())

    def history_table(self) -> dict[str, Any]:
        """Return the history as pages show it."""
        if self.history is None:
            return {"states": [], "at": -1}
        return {"states": [{"when": one.when, "what": one.what} for one in self.history.states], "at": self.history.at}

    def hello(self) -> dict[str, Any]:
        """Return all that a page needs to begin with, but the maps."""
        textures = textures_of(manifest_in(self.place.folder))
        return {
            "type": "hello", "name": self.place.folder.name, "folder": str(self.place.folder), "writable": self.place.writable,
            "ready": self.ready.is_set(), "versions": self.shown.versions, "textures": textures,
            "pictures": pictures_in(self.place.folder), "still": self.settings.still, "look": self.settings.look,
            "says": list(self.says.values()), "others": [other.rstrip("/").rpartition("/")[2] for other in self.others],
            "measured": self.btf is not None, "history": self.history_table(),
        }

    def check_writable(self) -> None:
        """Raise DataError when nothing can be saved here."""
        if not self.place.writable:
            step = "Copy the folder to where you may write."
            raise DataError(message(str(self.place.folder), "the folder", "be writable", "it is not", step))

    async def back_to(self, state: State) -> None:
        """Bring the folder into one of the states of its history, and show that."""
        self.check_writable()
        assert self.history is not None
        async with self.writing:
            await asyncio.to_thread(self.history.back_to, state)
            if self.watch is not None:
                self.watch.look()
        self._tell_files()
        await self.reload()

    def _tell_files(self) -> None:
        self.tell("history", **self.history_table())
        self.tell("files", textures=textures_of(manifest_in(self.place.folder)), pictures=pictures_in(self.place.folder))

    async def changing(self, change: Callable[[], Any], what: str) -> Any:
        """Take a state of the folder, let `change` (a coroutine function) change it, and take the new one."""
        self.check_writable()
        assert self.history is not None
        async with self.writing:
            await asyncio.to_thread(self.history.take, "unseen changes")
            found = await change()
            if self.watch is not None:
                self.watch.look()
            await asyncio.to_thread(self.history.take, what)
        self._tell_files()
        self.start(asyncio.to_thread(self._keep))
        return found


def _first(place: Place) -> tuple[dict[str, Any], dict[str, bytes]] | None:
    """Return what can be shown without torch: what was kept for these very files, or what they say themselves."""
    return kept(place.own, place.folder) or first_of(place.folder)
