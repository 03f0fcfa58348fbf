"""Who may ask a studio anything: the page that it served itself, with the token, under its own name.

Any page that a browser has open can send requests to a port of this machine. So each request and each websocket must have
the token (in the address, or the cookie that comes of it), a `Host` that is the loopback address (a name that was made to
point here has another), and no `Origin` but the studio's own. What is refused leaves one line in the log.
"""

from __future__ import annotations

import hmac
import logging
import secrets
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, unquote

LOG = logging.getLogger("torchmat.studio")
MOST_BODY = 0  # bytes: the page sends what it has to say over its websocket
MOST_MESSAGE = 256_000  # bytes of one message
_MOST_HEAD = 16_000  # bytes of a request's path and headers
_SAME = ("same-origin", "none")  # "none" is an address that the user opened
Scope = dict[str, Any]


def new_token() -> str:
    """Return a token that nobody guesses, of 256 bits."""
    return secrets.token_urlsafe(32)


class Guard:
    """ASGI middleware that lets `app` see nothing but what may ask it, on `port` and with `token`."""

    def __init__(self, app: Any, port: int, token: str) -> None:
        self._app, self._token = app, token
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost")}
        self._cookie = f"torchmat-{port}"  # cookies of one host are shared by all of its ports

    async def __call__(self, scope: Scope, receive: Any, send: Any) -> None:
        """Refuse a request or a websocket, or pass it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        status, why = self._wrong(scope)
        if why:
            LOG.warning("refused %s: %s", _shown(scope), why)
            await _refuse(scope, receive, send, status, why)
            return
        await self._app(scope, receive, self._with_headers(scope, send))

    def _wrong(self, scope: Scope) -> tuple[int, str]:
        """Return the status and the reason of a refusal; 0 and "" for what may pass."""
        headers: dict[str, list[str]] = {}
        for name, value in scope["headers"]:
            headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
        if sum(len(name) + len(value) for name, value in scope["headers"]) + len(scope.get("raw_path") or b"") > _MOST_HEAD:
            return 431, "its head is too large"
        if headers.get("host", []) not in [[host] for host in self._hosts]:
            return 403, "another host"
        own = [f"http://{host}" for host in self._hosts]
        if any(origin not in own for origin in headers.get("origin", ())) or len(headers.get("origin", ())) > 1:
            return 403, "another origin"
        if any(site not in _SAME for site in headers.get("sec-fetch-site", ())):
            return 403, "another site"
        if not self._has_token(scope, headers):
            return 403, "no token"
        path = scope["path"]
        if ".." in path or "\\" in path or "\0" in path or "%" in path or "//" in path:
            return 404, "a path that leads elsewhere"
        if scope["type"] == "http" and scope["method"] not in ("GET", "HEAD"):
            return 405, "not a request to read"
        if any(_size(length) > MOST_BODY for length in headers.get("content-length", ())) or "transfer-encoding" in headers:
            return 413, "it has a body"
        return 0, ""

    def _has_token(self, scope: Scope, headers: dict[str, list[str]]) -> bool:
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"), max_num_fields=20) if _few(scope) else {}
        given = list(query.get("token", ()))
        for text in headers.get("cookie", ()):
            given += _cookies(text, self._cookie)
        return any(hmac.compare_digest(one.encode(), self._token.encode()) for one in given)

    def _with_headers(self, scope: Scope, send: Any) -> Any:
        """Return a `send` that adds what keeps the page to itself, and gives the token as a cookie."""
        extra = [
            (b"cache-control", b"no-store"), (b"referrer-policy", b"no-referrer"), (b"x-content-type-options", b"nosniff"),
            (b"cross-origin-resource-policy", b"same-origin"), (b"x-frame-options", b"DENY"),
            (b"set-cookie", f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/".encode()),
        ]

        async def wrapped(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", ()), *extra]}
            await send(message)

        return wrapped


def _few(scope: Scope) -> bool:
    return scope.get("query_string", b"").count(b"&") < 20 and len(scope.get("query_string", b"")) < 4000


def _cookies(text: str, name: str) -> list[str]:
    try:
        jar = SimpleCookie(text)
    except CookieError:
        return []
    return [jar[name].value] if name in jar else []


def _size(length: str) -> int:
    return int(length) if length.isdecimal() and len(length) < 20 else MOST_BODY + 1


def _shown(scope: Scope) -> str:
    """Return what was asked for, in one line, without the token and not at any length."""
    text = f"{scope.get('method', 'websocket')} {unquote(scope['path'])}"
    return ascii(text[:120])[1:-1]


async def _refuse(scope: Scope, receive: Any, send: Any, status: int, why: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": why})
        return
    body = f"refused: {why}\n".encode()
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": status, "headers": [*headers, (b"connection", b"close")]})
    await send({"type": "http.response.body", "body": body})
