"""A studio within the process of a test: real sockets, and torch where it is loaded already."""

from __future__ import annotations

import asyncio
import http.client
import json
import queue
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
import uvicorn
from websockets.sync.client import connect

import torchmat as tm
from torchmat.create import material_from_picture
from torchmat.studio import serve
from torchmat.studio.app import application
from torchmat.studio.live import Live
from torchmat.studio.place import place_of
from torchmat.studio.session import Session
from torchmat.studio.worker import Answer, answered

TOKEN = "token-of-the-test"


class Here:
    """A worker that works in this process."""

    def __init__(self, **session: Any) -> None:
        self._session = Session(**session)

    async def call(self, name: str, **keywords: Any) -> Answer:
        fine, value, notices = await asyncio.to_thread(answered, getattr(self._session, name), keywords)
        if not fine:
            raise value
        return Answer(value, notices)

    def start(self) -> None:
        """As of a process."""

    def stop(self) -> None:
        """As of a process."""


class Served:
    """A studio that answers at `port`; `live` is its state, to be looked at only."""

    def __init__(self, folder: Path, live: Live, port: int) -> None:
        self.folder, self.live, self.port = folder, live, port
        self.address = f"http://127.0.0.1:{port}/?token={TOKEN}"

    def get(self, path: str, **headers: str) -> tuple[int, bytes, dict[str, str]]:
        """Return the status, the body and the headers of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        connection.request("GET", path, headers={"Cookie": f"torchmat-{self.port}={TOKEN}", **headers})
        answer = connection.getresponse()
        found = answer.status, answer.read(), dict(answer.getheaders())
        connection.close()
        return found

    def json(self, path: str) -> Any:
        return json.loads(self.get(path)[1])

    @contextmanager
    def page(self):
        """A connection as a page has it."""
        self.get("/material.json")  # it is read: what is saved from now on is told
        address = f"ws://127.0.0.1:{self.port}/live?token={TOKEN}"
        with connect(address, origin=f"http://127.0.0.1:{self.port}", max_size=None) as socket:
            talk = Talk(socket)
            while self.live.history is not None and not self.live.history.states:
                talk.wait("history")  # the first state is kept: what is saved from now on is another
            yield talk


class Talk:
    """What a page hears and says."""

    def __init__(self, socket: Any) -> None:
        self.socket, self._count = socket, 0
        self.heard: list[dict[str, Any]] = []
        self.hello = self.wait("hello")

    def wait(self, kind: str, timeout: float = 20, **values: Any) -> dict[str, Any]:
        """Return the next message of a kind with some values; all that come before it are kept in `heard`."""
        end = time.monotonic() + timeout
        while True:
            message = json.loads(self.socket.recv(timeout=max(0.01, end - time.monotonic())))
            self.heard.append(message)
            if message["type"] == kind and all(message.get(key) == value for key, value in values.items()):
                return message

    def wait_states(self, count: int) -> None:
        """Wait until the history has so many states."""
        while len(self.wait("history")["states"]) != count:
            pass

    def wish(self, kind: str, **keywords: Any) -> Any:
        """Return the answer to a wish; raises what it says is wrong."""
        self._count += 1
        self.socket.send(json.dumps({"type": kind, "id": self._count, **keywords}))
        answer = self.wait("answer", id=self._count)
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer["value"]


@contextmanager
def served(folder: Path, others: tuple[str, ...] = (), btf: str | None = None):
    """Serve a folder on a free port as long as the block lasts."""
    place = place_of(folder)
    listening = serve._bound(None)
    port = listening.getsockname()[1]
    live = Live(place, Here(folder=str(place.folder), others=others), list(others), btf, Here(folder=str(place.folder), btf=btf) if btf else None)
    server = uvicorn.Server(serve.config_of(application(live, port, TOKEN)))
    live.failed = lambda: setattr(server, "should_exit", True)
    problems: queue.Queue[BaseException] = queue.Queue()

    def run() -> None:
        try:
            asyncio.run(server.serve(sockets=[listening]))
        except BaseException as error:
            problems.put(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield Served(place.folder, live, port)
    finally:
        server.should_exit = True
        thread.join(10)
        listening.close()
    if not problems.empty():
        raise problems.get()


def wool(path: Path, size: int = 16, **settings: Any) -> Path:
    """Write a small material that has all that the page can change, and return its folder."""
    torch.manual_seed(7)
    picture = 0.1 + 0.6 * torch.rand(3, size, size)
    keywords: dict[str, Any] = {"lobes": 2, "specular": ("glossy", "soft"), "rotation_centres": [(0.5, 0.5)], "tiles": True}
    tm.save_material(material_from_picture(picture, **{**keywords, **settings}), path)
    return path
