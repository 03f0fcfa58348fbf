"""The pages of a studio: a few fixed addresses, of which none is a path on the disk, and one websocket."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import AsyncIterator
from importlib.resources import files
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from torchmat.errors import TorchmatError
from torchmat.studio.guard import MOST_MESSAGE, Guard
from torchmat.studio.live import Live
from torchmat.studio.wishes import Wishes
from torchmat.web.bundle import bundle

LOG = logging.getLogger("torchmat.studio")
_AT_ONCE = 8  # wishes of one page that are worked on; the next one waits
_PATIENCE = 60.0  # seconds until a page hears that there is no material yet
_SUFFIXES = {".js": "text/javascript", ".css": "text/css", ".json": "application/json", ".svg": "image/svg+xml"}


def application(live: Live, port: int, token: str) -> Guard:
    """Return the ASGI application of a studio on a port; whoever has the token may ask it."""
    pages = Pages(live)
    routes = [
        Route("/", pages.page), Route("/js/{name}", pages.asset), Route("/material.json", pages.material),
        Route("/map/{name}", pages.map), Route("/picture/{name}", pages.picture), Route("/favicon.ico", pages.no_icon),
        WebSocketRoute("/live", pages.live),
    ]

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        opening = live.start(live.open())
        yield
        opening.cancel()
        await live.close()

    return Guard(Starlette(routes=routes, lifespan=lifespan), port, token)


def shipped() -> dict[str, bytes]:
    """Return the files of the page by name: the only ones that are ever sent."""
    folder = files("torchmat.web")
    found = {one.name: one for place in (folder, folder / "js") for one in place.iterdir() if one.is_file()}
    whole = {name: one.read_bytes() for name, one in found.items() if name.endswith((*_SUFFIXES, ".html", ".glsl"))}
    # As one script: modules that load each other are found one after the other.
    return {**whole, "studio.js": bundle("studio").encode()}


class Pages:
    """The answers of a studio to a page."""

    def __init__(self, live: Live) -> None:
        self._live, self._wishes, self._assets = live, Wishes(live), shipped()

    async def page(self, request: Request) -> Response:
        """Return the page itself."""
        from torchmat.studio.page import page_text

        place = self._live.place
        return Response(page_text(place.folder.name, str(place.folder)), media_type="text/html; charset=utf-8")

    async def no_icon(self, request: Request) -> Response:
        """Return nothing to browsers that look for an icon."""
        return Response(status_code=204)

    async def asset(self, request: Request) -> Response:
        """Return one of the files that the page consists of."""
        name = request.path_params["name"]
        if name not in self._assets:
            return _missing(request)
        kind = _SUFFIXES.get(name[name.rfind("."):], "text/plain")
        return Response(self._assets[name], media_type=f"{kind}; charset=utf-8")

    async def material(self, request: Request) -> Response:
        """Return the description of what is shown, and the versions of its maps, as soon as there is one."""
        if not await self._ready():
            return Response("the material is not read yet\n", 503, media_type="text/plain")
        return JSONResponse({**self._live.shown.description, "versions": self._live.shown.versions})

    async def _ready(self) -> bool:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._live.ready.wait(), _PATIENCE)
        return self._live.ready.is_set()

    async def map(self, request: Request) -> Response:
        """Return the raw codes of one map."""
        await self._ready()
        name = request.path_params["name"]
        data = self._live.shown.buffers.get(name)
        if data is None:
            return _missing(request)
        # The entry goes with its bytes: a save in between must not part them.
        head = {"version": self._live.shown.versions[name], "entry": self._live.shown.entry(name)}
        return Response(data, media_type="application/octet-stream", headers={"x-map": json.dumps(head)})

    async def picture(self, request: Request) -> Response:
        """Return one picture of those that were last compared, as RGB bytes."""
        found = self._live.pictures.get(request.path_params["name"])
        return _missing(request) if found is None else Response(found, media_type="application/octet-stream")

    async def live(self, socket: WebSocket) -> None:
        """Tell a page what changes, and do what it wishes."""
        await socket.accept()
        page: asyncio.Queue[dict[str, Any] | None] = asyncio.Queue()
        page.put_nowait(self._live.hello())
        self._live.pages.add(page)
        sending = asyncio.create_task(_send(socket, page))
        room = asyncio.Semaphore(_AT_ONCE)
        try:
            while True:
                wish = _wish(await socket.receive())
                await room.acquire()
                self._live.start(self._answer(wish, page)).add_done_callback(lambda _: room.release())
        except _Malformed as error:
            LOG.warning("refused a message: %s", error)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                await socket.close(1003, str(error))
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            self._live.pages.discard(page)
            sending.cancel()

    async def _answer(self, wish: dict[str, Any], page: asyncio.Queue[dict[str, Any] | None]) -> None:
        answer: dict[str, Any] = {"type": "answer", "id": wish.get("id")}
        try:
            answer["value"] = await self._wishes.fulfil(wish)
        except TorchmatError as error:
            LOG.warning("refused a wish: %s", ascii(str(error))[1:-1][:300])
            answer["error"] = str(error)
        except Exception as error:  # a full disk, say: the page hears of it, and the next wish is answered
            LOG.error("a wish failed: %s", ascii(f"{type(error).__name__}: {error}")[1:-1][:300])
            answer["error"] = f"studio: it could not be done; {type(error).__name__}: {error}. The material stays as it was."
        page.put_nowait(answer)


class _Malformed(Exception):
    """A message that no page of ours sends."""


def _wish(received: Any) -> dict[str, Any]:
    if received["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(received.get("code", 1000))
    text = received.get("text")
    if text is None:
        raise _Malformed("it is no text")
    if len(text) > MOST_MESSAGE:
        raise _Malformed("it is too long")
    try:
        wish = json.loads(text)
    except (ValueError, RecursionError):
        raise _Malformed("it is no JSON") from None
    if not isinstance(wish, dict) or not isinstance(wish.get("type"), str):
        raise _Malformed("it has no type")
    if not isinstance(wish.get("id"), int | str | None) or len(str(wish.get("id"))) > 100:
        raise _Malformed("its id is no short name or number")
    return wish


async def _send(socket: WebSocket, page: asyncio.Queue[dict[str, Any] | None]) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):
        while True:
            message = await page.get()
            if message is None:
                await socket.close(1001, "the studio ended, or the page was too slow")
                return
            await socket.send_text(json.dumps(message))


def _missing(request: Request) -> Response:
    LOG.warning("refused %s: there is no such thing", ascii(f"{request.method} {request.url.path}"[:120])[1:-1])
    return Response("refused: there is no such thing\n", 404, media_type="text/plain")
