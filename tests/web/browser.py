"""Chromium without a window, for tests of what runs in a page.

Playwright's plain interface keeps an event loop running in the thread that uses it, where others then could start none: so it
has a thread of its own here, and what tests hold are stand-ins that call there.
"""

from __future__ import annotations

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[2] / "torchmat"
SITE = "http://torchmat.test/"  # no such host: requests to it are answered here
_NAMES = ("chromium", "chromium-browser", "google-chrome")
_ARGUMENTS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage")
_PLAIN = (type(None), bool, int, float, str, bytes, list, tuple, dict)
_TYPES = {".js": "text/javascript", ".html": "text/html", ".css": "text/css", ".json": "application/json"}
_TIMEOUT = 120


def missing() -> str | None:
    """Return why there is no browser for tests, None where there is one."""
    try:
        import playwright.sync_api  # noqa: F401
    except ImportError:
        return "playwright is not installed: pip install -e .[test]"
    return None if _executable() else "no chromium: apt-get install --no-install-recommends chromium, or name one in TORCHMAT_CHROMIUM"


def _executable() -> str | None:
    return os.environ.get("TORCHMAT_CHROMIUM") or next(filter(None, map(shutil.which, _NAMES)), None)


class OnThread:
    """Stand-in for an object of Playwright: attributes, calls and `with` happen in its thread; plain values come as they are."""

    def __init__(self, thread: ThreadPoolExecutor, target: Any) -> None:
        self._thread, self._target = thread, target

    def _do(self, work) -> Any:
        found = self._thread.submit(work).result(_TIMEOUT)
        return found if isinstance(found, _PLAIN) else OnThread(self._thread, found)

    def __getattr__(self, name: str) -> Any:
        return self._do(lambda: getattr(self._target, name))

    def __call__(self, *arguments, **keywords) -> Any:
        plain = [one._target if isinstance(one, OnThread) else one for one in arguments]
        return self._do(lambda: self._target(*plain, **keywords))

    def __enter__(self) -> Any:
        return self._do(lambda: self._target.__enter__())

    def __exit__(self, *error) -> Any:
        return self._do(lambda: self._target.__exit__(*error))


class Page(OnThread):
    """A page, with the `problems` that it had: errors that nothing caught, and what its console calls an error."""

    problems: list[str]

    def __init__(self, thread: ThreadPoolExecutor, target: Any) -> None:
        super().__init__(thread, target)
        self.problems = []

        def listen() -> None:
            target.on("pageerror", lambda error: self.problems.append(str(error)))
            target.on("console", lambda said: self.problems.append(said.text) if said.type == "error" else None)

        self._do(listen)


class Chromium:
    """One browser. `open` makes a page, in a profile of its own; `close` ends everything."""

    def __init__(self) -> None:
        from playwright.sync_api import sync_playwright

        self._thread = ThreadPoolExecutor(1, "chromium")
        self._playwright = OnThread(self._thread, sync_playwright()).start()
        self._browser = self._playwright.chromium.launch(executable_path=_executable(), args=list(_ARGUMENTS))

    def open(self, width: int = 640, height: int = 480, **settings: Any) -> Page:
        """Return an empty page of that size; `settings` are those of Playwright's `new_page` (touch, scale, scheme ...)."""
        made = self._browser.new_page(viewport={"width": width, "height": height}, **settings)
        return Page(self._thread, made._target)

    def open_package(self, address: str = "", files: dict[str, str] | None = None, **settings: Any) -> Page:
        """Return a page at SITE + `address`, a site of the package's own files ("web/js/gl.js") and of `files`, text by address.

        Without an address it is an empty page, into which `evaluate` can import the modules: ``await import("/web/js/gl.js")``.
        """
        page, files = self.open(**settings), {"": "<!doctype html><title>test</title>", **(files or {})}

        def answer(route) -> None:
            name = route.request.url.removeprefix(SITE).partition("?")[0]
            path = PACKAGE / name
            if name not in files and not path.is_file():
                return route.fulfill(status=404, body="")
            kind = _TYPES.get(path.suffix, "text/html" if not path.suffix else "application/octet-stream")
            route.fulfill(body=files[name] if name in files else path.read_bytes(), content_type=kind)

        page.route(f"{SITE}**", answer)
        page.goto(SITE + address)
        return page

    def close(self) -> None:
        """End the browser and its thread."""
        self._browser.close()
        self._playwright.stop()
        self._thread.shutdown()
