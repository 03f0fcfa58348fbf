"""Who may ask a studio: the token, the host, the origin, the path; and nothing that is malformed ends it."""

from __future__ import annotations

import asyncio
import logging

import pytest

from torchmat.studio.guard import Guard, new_token

PORT, TOKEN = 8473, "right"
HOST = (b"host", b"127.0.0.1:8473")


async def _app(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"in"})


def ask(path="/", query=b"token=right", headers=(HOST,), method="GET", kind="http"):
    """Return what the guard sends for a request: the status, or the code that closes a websocket, and the headers."""
    sent = []

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": f"{kind}.connect"}

    scope = {"type": kind, "method": method, "path": path, "raw_path": path.encode(), "query_string": query, "headers": list(headers)}
    asyncio.run(Guard(_app, PORT, TOKEN)(scope, receive, send))
    return sent[0].get("status", sent[0].get("code")), dict(sent[0].get("headers", ()))


def test_the_page_itself_may_ask_and_gets_the_token_as_a_cookie_that_no_other_site_sends():
    status, headers = ask()
    assert status == 200
    assert headers[b"set-cookie"] == b"torchmat-8473=right; HttpOnly; SameSite=Strict; Path=/"
    assert headers[b"cache-control"] == b"no-store" and headers[b"referrer-policy"] == b"no-referrer"
    assert ask(query=b"", headers=(HOST, (b"cookie", b"a=b; torchmat-8473=right")))[0] == 200
    assert ask(headers=((b"host", b"localhost:8473"), (b"origin", b"http://localhost:8473")))[0] == 200


@pytest.mark.parametrize(("wrong", "status"), [
    ({"query": b""}, 403),
    ({"query": b"token=wrong"}, 403),
    ({"query": b"token=" + b"x" * 5000}, 403),
    ({"query": b"&".join(b"a=%d" % n for n in range(50))}, 403),
    ({"query": b"", "headers": (HOST, (b"cookie", b"torchmat-8474=right"))}, 403),
    ({"query": b"", "headers": (HOST, (b"cookie", b"=;;\xff\x00=\"right"))}, 403),
    ({"headers": ()}, 403),
    ({"headers": (HOST, HOST)}, 403),
    ({"headers": ((b"host", b"127.0.0.1"),)}, 403),
    ({"headers": ((b"host", b"127.0.0.1:8474"),)}, 403),
    ({"headers": ((b"host", b"attacker.example:8473"),)}, 403),
    ({"headers": ((b"host", b"127.0.0.1.attacker.example:8473"),)}, 403),
    ({"headers": (HOST, (b"origin", b"http://attacker.example"))}, 403),
    ({"headers": (HOST, (b"origin", b"null"))}, 403),
    ({"headers": (HOST, (b"origin", b"http://127.0.0.1:8474"))}, 403),
    ({"headers": (HOST, (b"origin", b"https://127.0.0.1:8473"))}, 403),
    ({"headers": (HOST, (b"origin", b"http://127.0.0.1:8473"), (b"origin", b"http://attacker.example"))}, 403),
    ({"headers": (HOST, (b"sec-fetch-site", b"cross-site"))}, 403),
    ({"headers": (HOST, (b"sec-fetch-site", b"same-site"))}, 403),
    ({"method": "POST"}, 405),
    ({"method": "DELETE"}, 405),
    ({"headers": (HOST, (b"content-length", b"1"))}, 413),
    ({"headers": (HOST, (b"content-length", b"-1"))}, 413),
    ({"headers": (HOST, (b"transfer-encoding", b"chunked"))}, 413),
    ({"headers": (HOST, (b"x", b"y" * 20_000))}, 431),
    ({"path": "/js/../manifest.json"}, 404),
    ({"path": "/map/..\\secret"}, 404),
    ({"path": "/map/%2e%2e/secret"}, 404),
    ({"path": "//etc/passwd"}, 404),
    ({"path": "/map/a\0b"}, 404),
])
def test_what_is_wrong_is_refused_in_one_line_that_does_not_hold_the_token(wrong, status, caplog):
    with caplog.at_level(logging.WARNING, "torchmat.studio"):
        assert ask(**wrong)[0] == status
        assert ask(kind="websocket", **{key: value for key, value in wrong.items() if key != "method"})[0] in (1008, 200)
    lines = [record.getMessage() for record in caplog.records]
    assert 1 <= len(lines) <= 2 and all(line.startswith("refused ") and "\n" not in line and TOKEN not in line for line in lines)
    assert all(len(line) < 250 for line in lines)


def test_tokens_are_long_and_new_each_time():
    assert len({new_token() for _ in range(10)}) == 10 and len(new_token()) >= 43
