"""What a hostile page, or program, could send to a studio: malformed requests and messages of every kind, counted by what came back."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import random
import socket
import struct
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

from torchmat.studio.place import cache_folder

PATHS = (
    "/", "/js/studio.js", "/js/../../../etc/passwd", "/js/%2e%2e/%2e%2e/etc/passwd", "/js/..%2f..%2fetc%2fpasswd", "/map/diffuse",
    "/map/..%5c..%5csecret", "/map/%00", "/map/diffuse.png", "/map/link.png", "//etc/passwd", "/etc/passwd", "/%c0%ae%c0%ae/etc/passwd",
    "/picture/../../secret.txt", "/material.json", "/secret.txt", "/wool/manifest.json", "/js/" + "a" * 3000, "/js/‮", "/live", "*",
    "http://attacker.example/", "/js/%", "/js/%zz", "/..;/..;/etc/passwd", "/js/studio.py", "/../.wool.studio/lock", "/map/" + "../" * 50,
)
WORDS = (
    "preview", "apply", "discard", "blend", "apply_blend", "choose", "follow", "remember", "undo", "redo", "back", "compare", "measure",
    "refit", "cancel", "picture", "_written", "fulfil", "__class__", "drawn", "nothing", "",
)
VALUES: tuple[object, ...] = (
    None, True, -1, 10**30, 1e308, "", "../secret.png", "/etc/passwd", "x" * 5000, [], {}, [[]], {"mask": None}, {"mask": {"contrast": "a"}},
    {"without": {"part": "tilt"}}, {"index": {"lobes": 10**9}}, {"specular": {"maps": ["glossy:size=100000"]}}, {"a": {"b": {"c": []}}}, "💥\ud800",
    {"rotation": {"centres": [[0, 0]] * 5000}}, {"tilt": {"curve": "0:0," * 3000}}, ["--help"], float("nan"),
)
KEYS = ("edits", "drop", "other", "weight", "texture", "file", "on", "look", "state", "light", "view", "maps", "effort", "mesh", "zoom", "perspective", "lights", "repeat", "exposure", "size", "self", "wish", "id", "x")


def attack(address: str, folder: Path, count: int, seed: int = 0) -> dict[str, int | float | bool]:
    """Send `count` malformed requests and messages to a studio; return how many were refused, and whether it still answers.

    Raises AssertionError when an answer holds what stands outside the folder, or an outsider is let in.
    """
    parts = urlsplit(address)
    token = parts.query.partition("=")[2]
    secret = "what-nobody-may-read"
    (folder.parent / "secret.txt").write_text(secret)
    (folder.parent / "secret.png").write_text(secret)
    if not (folder / "link.png").is_symlink():
        (folder / "link.png").symlink_to(folder.parent / "secret.png")
    before, choose, found = _outside(folder), random.Random(seed), Counter[str]()
    began = time.monotonic()
    ways: list[Callable[[random.Random, int, str], tuple[bytes, str]]] = [_request, _request, _outsider, _outsider, _garbage, _upgrade]
    sent = 0
    while sent < count:
        if sent % 10 >= 6:
            sent += _messages(choose, parts.port or 0, token, found)
            continue
        data, kind = choose.choice(ways)(choose, parts.port or 0, token)
        answer = _exchange(parts.port or 0, data)
        sent += 1
        status = answer[9:12].decode("latin-1") if answer.startswith(b"HTTP/1.1 ") else "closed"
        found[f"{kind} {status}"] += 1
        assert secret.encode() not in answer, data[:300]
        assert kind != "outsider" or status in ("403", "400", "closed", "431"), (data[:300], answer[:100])
    (folder / "link.png").unlink()
    after = _outside(folder)
    changed = sorted(path for path in {*before, *after} if before.get(path) != after.get(path))
    assert not changed, f"written outside the folder: {changed}"
    alive = _exchange(parts.port or 0, _head("/", parts.port or 0, token)).startswith(b"HTTP/1.1 200")
    return {"sent": sent, "seconds": time.monotonic() - began, "answers": alive, **found}


def _outside(folder: Path) -> dict[str, str]:
    """Digests of the files beside a material's folder, without those that are a studio's own to write: its folder, backups, log and cache."""
    found = {}
    cache = cache_folder()
    for path in sorted(folder.parent.rglob("*")):
        inside = path == folder or folder in path.parents or ".studio" in str(path) or ".backup-" in str(path) or path.name == "log" or cache in path.parents
        if path.is_file() and not inside:
            found[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def _head(path: str, port: int, token: str, method: str = "GET", extra: str = "", host: str = "") -> bytes:
    text = f"{method} {path} HTTP/1.1\r\nHost: {host or f'127.0.0.1:{port}'}\r\nCookie: torchmat-{port}={token}\r\n{extra}Connection: close\r\n\r\n"
    return text.encode("utf-8", "surrogatepass")


def _request(choose: random.Random, port: int, token: str) -> tuple[bytes, str]:
    method = choose.choice(["GET", "GET", "GET", "POST", "PUT", "DELETE", "OPTIONS", "TRACE", "HEAD", "G\0T", "CONNECT"])
    extra = choose.choice(["", "", "Content-Length: 5\r\n", "Content-Length: -5\r\n", "Transfer-Encoding: chunked\r\n", "X: " + "y" * 20_000 + "\r\n", "Range: bytes=0-\r\n"])
    return _head(choose.choice(PATHS) + choose.choice(["", "?" + "&".join("a=1" for _ in range(300)), "?token=wrong"]), port, token, method, extra), "request"


def _outsider(choose: random.Random, port: int, token: str) -> tuple[bytes, str]:
    """A request of another site, under another name, or without the token."""
    way = choose.randrange(4)
    path = choose.choice(["/", "/material.json", "/map/diffuse", "/js/studio.js", "/live"])
    if way == 0:
        return _head(path, port, token, extra=f"Origin: {choose.choice(['http://attacker.example', 'null', 'http://127.0.0.1:1', 'file://'])}\r\n"), "outsider"
    if way == 1:
        return _head(path, port, token, host=choose.choice(["attacker.example", f"attacker.example:{port}", f"127.0.0.1.nip.io:{port}", "127.0.0.1", f"[::1]:{port}"])), "outsider"
    if way == 2:
        return _head(path, port, choose.choice(["", "wrong", token[:-1], token + "x", token.swapcase()])), "outsider"
    return _head(path, port, token, extra=f"Sec-Fetch-Site: {choose.choice(['cross-site', 'same-site'])}\r\n"), "outsider"


def _garbage(choose: random.Random, port: int, token: str) -> tuple[bytes, str]:
    return choose.choice([choose.randbytes(choose.randrange(1, 3000)), b"\x16\x03\x01\x02\x00" + choose.randbytes(200), b"GET / HTTP/9.9\r\n\r\n", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", _head("/", port, token)[: choose.randrange(5, 60)]]), "garbage"


def _upgrade(choose: random.Random, port: int, token: str) -> tuple[bytes, str]:
    """A websocket of another site, or one that is none."""
    key = base64.b64encode(choose.randbytes(choose.choice([16, 16, 3]))).decode()
    extra = f"Upgrade: {choose.choice(['websocket', 'h2c', ''])}\r\nSec-WebSocket-Version: {choose.choice([13, 99])}\r\nSec-WebSocket-Key: {key}\r\nOrigin: http://attacker.example\r\n"
    return _head("/live", port, token, extra=extra).replace(b"Connection: close", b"Connection: Upgrade"), "outsider"


def _exchange(port: int, data: bytes) -> bytes:
    """Send bytes and return what comes back, at most a little."""
    with socket.create_connection(("127.0.0.1", port), timeout=5) as line:
        try:
            line.sendall(data)
            line.shutdown(socket.SHUT_WR)
            found = b""
            while len(found) < 2_000_000:
                part = line.recv(65536)
                if not part:
                    break
                found += part
            return found
        except OSError:
            return b""


def _messages(choose: random.Random, port: int, token: str, found: Counter[str]) -> int:
    """Send a few messages over one websocket that was let in, until it is closed; return how many."""
    key = base64.b64encode(choose.randbytes(16)).decode()
    extra = f"Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\nOrigin: http://127.0.0.1:{port}\r\n"
    head = _head("/live", port, token, extra=extra).replace(b"Connection: close", b"Connection: Upgrade")
    with socket.create_connection(("127.0.0.1", port), timeout=5) as line:
        line.sendall(head)
        assert line.recv(4000).startswith(b"HTTP/1.1 101")
        sent = 0
        for _ in range(choose.randrange(1, 12)):
            try:
                line.sendall(_frame(choose))
                sent += 1
            except OSError:
                break
        found["message"] += sent
        line.settimeout(0.05)
        try:
            while line.recv(1_000_000):
                pass
        except OSError:
            pass
    return max(1, sent)


def _frame(choose: random.Random) -> bytes:
    """Return one frame of a websocket: wishes that make no sense, mostly, and now and then no frame at all."""
    kind = choose.randrange(12)
    if kind == 0:
        return choose.randbytes(choose.randrange(1, 200))
    if kind == 1:
        return b"\x81\xff" + struct.pack(">Q", 2**40) + choose.randbytes(100)  # a length that nobody sends
    wish = {"type": choose.choice(WORDS), "id": choose.choice([1, "a", None, [], 10**40])}
    wish |= {choose.choice(KEYS): choose.choice(VALUES) for _ in range(choose.randrange(4))}
    text = {2: "{" * 50_000, 3: "[1,2", 4: "null", 5: json.dumps(["type"]), 6: json.dumps({"type": 5})}.get(kind, json.dumps(wish))
    data = b"\xff\xfe" + os.urandom(20) if kind == 7 else text.encode("utf-8", "surrogatepass")
    head = bytes([0x82 if kind == 8 else 0x81])
    size = bytes([0x80 | len(data)]) if len(data) < 126 else b"\xfe" + struct.pack(">H", len(data)) if len(data) < 65536 else b"\xff" + struct.pack(">Q", len(data))
    mask = choose.randbytes(4)
    return head + size + mask + bytes(one ^ mask[place % 4] for place, one in enumerate(data))
