"""Long work beside the studio: one process at a time, whose progress the pages see and which they can end."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
import sys
from typing import Any

from torchmat.errors import DataError, RangeError, TorchmatError, check_positive, message
from torchmat.studio.live import Live


class Refit:
    """The refit of chosen maps of a studio's material."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self._process: asyncio.subprocess.Process | None = None
        self.running = False
        self._cancelled = False

    def start(self, maps: list[str], effort: float) -> None:
        """Start it; raises DataError or RangeError when there is nothing to fit to, or one is running."""
        self._live.check_writable()
        check_positive("refit", "effort", effort)
        if self._live.btf is None:
            step = "Start the studio with --btf PATH."
            raise DataError(message("refit", "the images", "be there", "none were named", step))
        if self.running:
            raise RangeError(message("refit", "the last one", "have ended", "it is running", "Cancel it, or wait."))
        if not maps:
            raise RangeError(message("refit", "the maps", "be one or more", "none was chosen"))
        self.running, self._cancelled = True, False
        self._live.start(self._run(maps, effort))

    def cancel(self) -> None:
        """End it; the material stays as it is."""
        self._cancelled = True
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()

    async def _run(self, maps: list[str], effort: float) -> None:
        out = self._live.place.own / "refit"
        self._tell("running", what="starting", share=None)
        try:
            report = await self._fitted(str(out), maps, effort)

            async def change() -> Any:
                keywords = {"folder": str(out), "maps": maps, "record": {"refit": {"maps": maps, "effort": effort}}}
                return self._live.noted(await self._live.worker.call("take_over", **keywords))

            self._live.put(await self._live.changing(change, f"refit {', '.join(maps)}"))
            self._tell("done", **report)
        except TorchmatError as error:
            self._tell("cancelled" if self._cancelled else "failed", text="" if self._cancelled else str(error))
        finally:
            self.running = False
            self.cancel()
            shutil.rmtree(out, ignore_errors=True)

    async def _fitted(self, out: str, maps: list[str], effort: float) -> dict[str, Any]:
        """Return the report of the process that fits, telling pages how far it is."""
        command = ["-m", "torchmat.studio.refitting", str(self._live.place.folder), str(self._live.btf), out, str(effort), *maps]
        self._process = await asyncio.create_subprocess_exec(sys.executable, *command, stdout=asyncio.subprocess.PIPE, start_new_session=True)
        if self._cancelled:
            self.cancel()
        assert self._process.stdout is not None
        last: dict[str, Any] = {}
        async for line in self._process.stdout:
            try:
                last = json.loads(line)
            except ValueError:
                continue  # what a library prints
            if "what" in last:
                self._tell("running", what=last["what"], share=last["share"])
        code = await self._process.wait()
        if "report" in last:
            return last["report"]
        raise DataError(last.get("error") or message("refit", "its process", "go on", f"it ended with {code}"))

    def _tell(self, state: str, **values: Any) -> None:
        self._live.tell("job", state=state, **values)
