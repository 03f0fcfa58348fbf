"""What a page may ask for, by name: each wish is a method, whose keywords are the keys of the message."""

from __future__ import annotations

import base64
import inspect
from collections.abc import Mapping
from typing import Any

from torchmat.errors import RangeError, check_known_keys, check_option, message
from torchmat.studio.jobs import Refit
from torchmat.studio.live import Live
from torchmat.studio.place import pictures_in
from torchmat.studio.textures import manifest_in, textures_of


class Wishes:
    """The wishes that pages of a studio have."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self._refit = Refit(live)

    async def fulfil(self, wish: Mapping[str, Any]) -> Any:
        """Do what a message asks for and return the answer; raises RangeError for what there is not."""
        name, keywords = wish.get("type"), {key: value for key, value in wish.items() if key not in ("type", "id")}
        check_option("studio", "the wish", name, WISHES)
        method = getattr(self, str(name))
        parameters = inspect.signature(method).parameters
        check_known_keys(f"studio {name}", keywords, parameters)
        missing = [key for key, one in parameters.items() if one.default is one.empty and key not in keywords]
        if missing:
            raise RangeError(message(f"studio {name}", "the message", f"have {', '.join(parameters)}", f"it lacks {missing[0]}"))
        return await method(**keywords)

    async def drawn(self) -> None:
        """Hear that the first picture is seen."""
        self._live.drawn.set()

    async def preview(self, edits: Any, drop: Any = ()) -> None:
        """Show edits without writing them."""
        _check_edits(edits, drop)
        self._live.put(self._live.noted(await self._live.worker.call("preview", edits=edits, drop=list(drop))))

    async def apply(self, edits: Any, drop: Any = ()) -> dict[str, Any]:
        """Write edits into the folder."""
        _check_edits(edits, drop)
        return await self._written("apply", ", ".join((*edits, *(f"without {name}" for name in drop))), edits=edits, drop=list(drop))

    async def discard(self) -> None:
        """Show the folder as it is, without edits that were only looked at."""
        self._live.put(self._live.noted(await self._live.worker.call("now")))

    async def blend(self, other: Any, weight: Any) -> None:
        """Show the blend with another material, without writing it."""
        _check_number("weight", weight, 0, 1)
        self._live.put(self._live.noted(await self._live.worker.call("blended", other=other, weight=float(weight))))

    async def apply_blend(self, other: Any, weight: Any) -> dict[str, Any]:
        """Write the blend into the folder."""
        _check_number("weight", weight, 0, 1)
        return await self._written("apply_blend", f"blend {weight:g}", other=other, weight=float(weight))

    async def choose(self, texture: Any, file: Any) -> dict[str, Any]:
        """Let another file of the folder be a texture."""
        folder = self._live.place.folder
        check_option("studio", "the texture", texture, textures_of(manifest_in(folder)))
        check_option("studio", "the file", file, pictures_in(folder))
        return await self._written("choose", f"{texture} is {file}", texture=texture, file=file)

    async def follow(self, texture: Any, on: Any) -> None:
        """Show saves of a texture at once, or not."""
        textures = textures_of(manifest_in(self._live.place.folder))
        self._live.settings.follow(texture, on is True, textures)
        self._live.settings.save(self._live.place.own)
        self._live.tell("still", still=self._live.settings.still)
        if on is True:
            await self._live.reload()

    async def remember(self, look: Any) -> None:
        """Keep what the page wants to know after a restart."""
        self._live.settings.remember(look)
        self._live.settings.save(self._live.place.own)

    async def picture(
        self, mesh: Any, view: Any, zoom: Any, perspective: Any, lights: Any, repeat: Any, exposure: Any, size: Any
    ) -> str:
        """Make a picture of a material that pages cannot draw (`Pictured.picture`): a PNG, in base64."""
        look = {"mesh": mesh, "view": view, "zoom": zoom, "perspective": perspective, "lights": lights}
        look |= {"repeat": repeat, "exposure": exposure, "size": size}
        return base64.b64encode((await self._live.worker.call("picture", **look)).value).decode("ascii")

    async def compare(self, light: Any, view: Any) -> dict[str, Any]:
        """Make the pictures of the measured pair that lies nearest to two directions, and return their figures."""
        found = self._live.noted(await self._measuring("beside", light=light, view=view))
        self._live.pictures = found.pop("pictures")
        return found

    async def measure(self) -> dict[str, Any]:
        """Return the figures of the material on the pairs that its fit held out."""
        return self._live.noted(await self._measuring("held_out"))

    async def _measuring(self, name: str, **keywords: Any) -> Any:
        if self._live.measuring is None:
            step = "Start the studio with --btf PATH."
            raise RangeError(message("studio", "the images", "be there", "none were named", step))
        return await self._live.measuring.call(name, **keywords)

    async def refit(self, maps: Any, effort: Any = 1.0) -> None:
        """Start to fit some maps anew."""
        if not isinstance(maps, list) or not all(isinstance(one, str) and not one.startswith("-") for one in maps):
            raise RangeError(message("studio refit", "the maps", "be a list of names", f"it is {maps!r}"))
        _check_number("effort", effort, 1e-3, 100)
        self._refit.start(maps, float(effort))

    async def cancel(self) -> None:
        """End the refit that is running."""
        self._refit.cancel()

    async def undo(self) -> None:
        """Bring the folder into the state before."""
        await self._step(-1)

    async def redo(self) -> None:
        """Bring the folder into the state after, if it was undone."""
        await self._step(1)

    async def back(self, state: Any) -> None:
        """Bring the folder into one of its states."""
        states = self._live.history.states if self._live.history else []
        if not isinstance(state, int) or isinstance(state, bool) or not 0 <= state < len(states):
            raise RangeError(message("studio", "the state", f"be one of the {len(states)} there are", f"it is {state!r}"))
        await self._back_to(states[state])

    async def _step(self, by: int) -> None:
        self._live.check_writable()
        history = self._live.history
        assert history is not None
        await self._live.remember("unseen changes")  # a save that was not looked at yet is what is undone
        place = history.at + by
        if not 0 <= place < len(history.states):
            fact = f"this is the {'first' if by < 0 else 'last'} of {len(history.states)} states"
            raise RangeError(message("studio", "the history", "go on", fact))
        await self._back_to(history.states[place])

    async def _back_to(self, state: Any) -> None:
        await self._live.back_to(state)

    async def _written(self, call: str, what: str, **keywords: Any) -> dict[str, Any]:
        """Let the worker write, and show what came of it."""
        async def change() -> Any:
            return self._live.noted(await self._live.worker.call(call, **keywords))

        answer = await self._live.changing(change, what)
        self._live.put(answer)
        return {"changed": answer["changed"], "backup": answer["backup"]}


WISHES = tuple(name for name, one in vars(Wishes).items() if not name.startswith("_") and name != "fulfil" and callable(one))


def _check_edits(edits: Any, drop: Any) -> None:
    if not isinstance(edits, dict) or not all(isinstance(one, dict) for one in edits.values()):
        raise RangeError(message("studio", "the edits", "be a table of tables", f"it is {type(edits).__name__}"))
    if not isinstance(drop, list | tuple) or not all(isinstance(one, str) for one in drop):
        raise RangeError(message("studio", "what is left out", "be a list of names", f"it is {type(drop).__name__}"))


def _check_number(name: str, value: Any, low: float, high: float) -> None:
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise RangeError(message("studio", name, f"lie in [{low}, {high}]", f"it is {value!r}"))
