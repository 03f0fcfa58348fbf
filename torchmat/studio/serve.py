"""A studio from its start to its end: one address on this machine, printed as soon as it can be opened."""

from __future__ import annotations

import errno
import logging
import os
import signal
import socket
import sys
from collections.abc import Sequence
from pathlib import Path

from torchmat.errors import DataError, RangeError, TorchmatError, message

_LOOPBACK = "127.0.0.1"
_USUAL_PORT, _PORTS = 8473, 20


def open_studio(
    material: str | Path, btf: str | Path | None = None, others: Sequence[str | Path] = (), port: int | None = None,
    browser: bool = True,
) -> None:
    """Serve a page on which a material is seen and changed while any program saves into its folder; returns when stopped.

    It answers on this machine alone, to whoever has the address that is printed. Ctrl-C (KeyboardInterrupt) ends it.

    Args:
        material: a material folder; or a picture, of which one is made beside it, as ``NAME_material`` (`create` says how).
        btf: the images that it was made of, to compare it with, and to fit maps anew; None is none.
        others: folders of materials that it may be blended with.
        port: 1 to 65535; None is 8473, or the next that is free.
        browser: whether the page is opened in the browser.

    Raises DataError when the folder is no material, when another studio has it open that does not answer, when the port is
    in use, or when a package of the extra `studio` is missing; what else is wrong with the folder stands on the page.
    """
    from torchmat.studio.lock import Held, Lock
    from torchmat.studio.place import place_of

    check_packages()
    place = place_of(material if os.path.isdir(material) else made_of_picture(Path(material)))
    try:
        lock = Lock(place.own, place.folder)
    except Held as held:
        if not held.address or not _answers(held.address):
            raise
        print(f"studio     {held.address}")
        print(f"joined     another studio has {place.folder} open, and this is its address")
        _show(held.address, browser)
        return
    try:
        with _bound(port) as listening:
            _run(place, lock, listening, None if btf is None else str(btf), [str(one) for one in others], browser)
    finally:
        lock.release()


def made_of_picture(picture: Path) -> Path:
    """Return the folder of the material that a picture makes, ``NAME_material`` beside it; one that is there already is kept."""
    folder = picture.with_name(f"{picture.stem}_material")
    if (folder / "manifest.json").is_file():
        print(f"material   {folder} was made before, and goes on")
        return folder
    from torchmat.btf.photographs import read_linear
    from torchmat.create import material_from_picture
    from torchmat.material_io import save_material
    from torchmat.progress import phase

    with phase(f"reading {picture.name}"):
        pixels = read_linear(picture)
    with phase("making the maps"):
        material = material_from_picture(pixels)
    save_material(material, folder, {"created_from": picture.name})
    print(f"material   {folder} made of {picture.name}")
    return folder


def check_packages() -> None:
    """Raise DataError, saying what to install, when a package of the extra `studio` is missing."""
    from importlib.util import find_spec

    missing = [name for name in ("starlette", "uvicorn", "websockets", "watchfiles") if find_spec(name) is None]
    if missing:
        fact = f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} not"
        step = "Run: pip install 'torchmat[studio]'"
        raise DataError(message("studio", "its packages", "be installed", fact, step))


def _bound(port: int | None) -> socket.socket:
    """Return a socket that listens on a port of this machine: connections wait from here on."""
    if port is not None and not 1 <= port <= 65535:
        raise RangeError(message("studio", "--port", "lie in [1, 65535]", f"it is {port}"))
    wanted = range(_USUAL_PORT, _USUAL_PORT + _PORTS) if port is None else (port,)
    for one in (*wanted, *((0,) if port is None else ())):
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if sys.platform != "win32":
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((_LOOPBACK, one))
            listening.listen(128)
            return listening
        except OSError as error:
            listening.close()
            if port is None and error.errno in (errno.EADDRINUSE, errno.EACCES):
                continue
            fact = "another program has it" if error.errno == errno.EADDRINUSE else str(error)
            step = "Give another one, or leave --port out: a free one is then found."
            raise DataError(message("studio", f"port {one}", "be free", fact, step)) from error
    raise DataError(message("studio", "a port", "be free", "none is"))


def _run(place, lock, listening: socket.socket, btf: str | None, others: list[str], browser: bool) -> None:
    from torchmat.studio.guard import new_token
    from torchmat.studio.worker import Worker

    port, token = listening.getsockname()[1], new_token()
    address = f"http://{_LOOPBACK}:{port}/?token={token}"
    lock.say(address)
    print(f"studio     {address}", flush=True)
    print("           Ctrl-C ends it", flush=True)
    worker = Worker(folder=str(place.folder), others=others)
    measuring = None if btf is None else Worker(folder=str(place.folder), btf=btf)
    try:
        _show(address, browser)
        failed = _serve(place, (worker, measuring), listening, port, token, btf, others)
    finally:
        for one in filter(None, (worker, measuring)):
            one.stop()
    if failed is not None:
        raise failed


def _serve(place, workers, listening: socket.socket, port: int, token: str, btf, others) -> TorchmatError | None:
    """Answer until Ctrl-C; return what was wrong with the material, if it could not be shown at all."""
    import uvicorn

    from torchmat.studio.app import application
    from torchmat.studio.live import Live

    _log_to_stderr()
    class Server(uvicorn.Server):
        interrupted = False

        def handle_exit(self, sig, frame) -> None:
            self.interrupted |= sig == signal.SIGINT
            super().handle_exit(sig, frame)

    live = Live(place, workers[0], others, btf, workers[1])
    server = Server(config_of(application(live, port, token)))
    live.failed = lambda: setattr(server, "should_exit", True)
    server.run(sockets=[listening])
    if server.interrupted:  # it raises this itself, at a moment at which others may take it for theirs
        raise KeyboardInterrupt
    return live.failure


def config_of(app):
    """Return how uvicorn serves a studio: bounded in all that comes in, and silent but for refusals."""
    import uvicorn

    from torchmat.studio.guard import MOST_MESSAGE

    return uvicorn.Config(
        app, log_config=None, access_log=False, server_header=False, date_header=False, proxy_headers=False, http="h11",
        ws="websockets-sansio", ws_max_size=MOST_MESSAGE, ws_max_queue=4, ws_per_message_deflate=False,
        h11_max_incomplete_event_size=16_384, timeout_keep_alive=600, timeout_graceful_shutdown=1, limit_concurrency=200,
        lifespan="on",
    )


class OneLine(logging.Formatter):
    """What is logged, in one line whatever it holds."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        return ascii(f"studio     {record.getMessage()}")[1:-1][:500]


def _log_to_stderr() -> None:
    """Let refusals and errors stand on standard error, one line each."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(OneLine())
    for name in ("torchmat.studio", "uvicorn.error"):
        logger = logging.getLogger(name)
        logger.handlers, logger.propagate = [handler], False
        logger.setLevel(logging.WARNING)


def _show(address: str, browser: bool) -> None:
    if browser:
        import webbrowser

        if not webbrowser.open(address):
            print("           no browser could be opened: open that address in one", flush=True)


def _answers(address: str) -> bool:
    """Return whether a studio answers at an address."""
    import urllib.request

    try:
        with urllib.request.urlopen(address, timeout=3) as answer:
            return answer.status == 200
    except (OSError, ValueError):
        return False
