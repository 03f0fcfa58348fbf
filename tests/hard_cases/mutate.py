"""Mistakes made by chance: in bytes, in tables of text, and in trees of JSON.

Each mutator takes what a good file holds and a seeded `random.Random`, and returns the changed content.
"""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

Field = tuple[int, str]  # byte offset and struct layout of one number of a head
Change = Callable[[bytes, Random], bytes]

WHOLE = (
    0, 1, 2, 7, 127, 128, 255, 256, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1,
)
NUMBERS = (
    "nan", "inf", "-inf", "1e400", "-1e400", "1e308", "1e39", "1e-400", "-0", "", "0", "1", "-1", "90", "360",
    "2147483648", "9223372036854775808", "\u0663", "\u00b2", "\u00bd", "0x10", "1_0", "1,5", "--1", "+", "1e",
    "9" * 5000, "1" + "0" * 400,
)
NAMES = (
    "..", ".", "", "/", "../0.png", "../../0.png", "/etc/hostname", "/dev/zero", "C:\\0.png", "\\\\host\\0.png",
    "CON", "nul.png", "0.png.", "0.png ", " 0.png", "\u00e9.png", "e\u0301.png", "\u202egnp.0", "%s%n",
    "a\0.png", "a" * 300 + ".png", "~", "$HOME", "*.png", "[0].png", "0.png?width=9", "0.%04d.png", "-",
    "0.png/0.png", "0.PNG", ".hidden.png", "sub\\0.png",
)
TOKENS = (
    b"\0", b",", b";", b"\t", b"\n", b"\r", b"\r\n", b'"', b"'", b" ", b"#", b"/", b"\\", b"[", b"{", b"]", b"}",
    b"-", b"0", b"9", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc3", b"\xed\xa0\x80", b"\xe2\x80\xa8", b"\x0b", b"\x1a", b"nan",
    b"1e400", b"..",
)


def in_bytes(data: bytes, chance: Random, fields: Sequence[Field] = ()) -> bytes:
    """Change one to four places: a bit, a number of the head, a token, a stretch dropped, doubled, zeroed or moved."""
    found = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 4))):
        if fields and chance.random() < 0.5:
            set_number(found, chance.choice(fields), chance)
            continue
        # Heads are where a reader is led astray, and they are short beside the pixels.
        last = len(found) if chance.random() < 0.5 else min(len(found), 300)
        _disturb(found, chance.randrange(last + 1), chance)
    return bytes(found)


def _disturb(found: bytearray, start: int, chance: Random) -> None:
    end = min(len(found), start + chance.choice((1, 2, 4, 8, 30, 300)))
    way = chance.randrange(7)
    if way == 0 and start < len(found):
        found[start] ^= 1 << chance.randrange(8)
    elif way == 1:
        found[start:start] = chance.choice(TOKENS)
    elif way == 2:
        del found[start:end]
    elif way == 3:
        found[start:start] = found[start:end]
    elif way == 4:
        found[start:end] = bytes((chance.choice((0, 255)),)) * (end - start)
    elif way == 5:
        found[start:end] = chance.choice(TOKENS)
    else:
        stretch = found[start:end]
        del found[start:end]
        place = chance.randrange(len(found) + 1)
        found[place:place] = stretch


def set_number(found: bytearray, field: Field, chance: Random) -> None:
    """Put a number that is hard for a reader, or one beside the right one, into a field of a head."""
    offset, layout = field
    size = struct.calcsize(layout)
    if offset + size > len(found):
        return
    if layout[-1] in "efd":
        value = chance.choice((0.0, -0.0, 1.0, -1.0, 1e-30, 6e4, float("nan"), float("inf"), -float("inf")))
        found[offset : offset + size] = struct.pack(layout, value)
        return
    order = "little" if layout[0] == "<" else "big"
    old = int.from_bytes(found[offset : offset + size], order)
    value = chance.choice((*WHOLE, old + 1, old - 1, old * 2)) % 256**size
    found[offset : offset + size] = value.to_bytes(size, order)


def cut(data: bytes, chance: Random, fields: Sequence[Field] = ()) -> bytes:
    """Cut a file short: at a border of its structure, near its end, or anywhere; at least its last byte is lost."""
    ends = [offset for offset, _ in fields if offset < len(data)]
    way = chance.randrange(3)
    if way == 0 and ends:
        return data[: chance.choice(ends)]
    if way == 1:
        return data[: max(0, len(data) - chance.randint(1, 20))]
    return data[: chance.randrange(len(data))]


def flip(data: bytes, chance: Random) -> bytes:
    """Turn one bit round."""
    found = bytearray(data)
    found[chance.randrange(len(found))] ^= 1 << chance.randrange(8)
    return bytes(found)


def in_table(data: bytes, chance: Random) -> bytes:
    """Change a table: lines and columns lost, doubled or moved, cells replaced, another encoding or line end."""
    text = data.decode()
    mark = "," if "," in text else " "
    rows = [line.split(mark) for line in text.splitlines()]
    for _ in range(chance.choice((1, 1, 2))):
        _in_rows(rows, chance)
    text = "\n".join(mark.join(row) for row in rows) + "\n"
    return _written(text, mark, chance)


def _in_rows(rows: list[list[str]], chance: Random) -> None:
    if not rows:
        return
    row, way = chance.choice(rows), chance.randrange(9)
    column = chance.randrange(len(row)) if row else 0
    if way == 0:
        rows.remove(row)
    elif way == 1:
        rows.append(list(row))
    elif way == 2:
        rows.insert(0, rows.pop())
    elif way == 3:
        for each in rows:
            del each[column : column + 1]
    elif way == 4:
        for each in rows:
            each[column:column] = each[column : column + 1]
    elif way == 5:
        del row[column : column + 1]
    elif row:
        row[column] = chance.choice(NAMES if way == 8 else NUMBERS)


def _written(text: str, mark: str, chance: Random) -> bytes:
    way = chance.randrange(16)
    if way == 0:
        return b"\xef\xbb\xbf" + text.encode("utf-8", "replace")
    if way == 1:
        return text.encode("utf-16", "replace")
    if way == 2:
        return ("\u00e9" + text).encode("latin-1", "replace")
    if way in (3, 4, 5):
        text = text.replace("\n", ("\r\n", "\r", "\u2028")[way - 3])
    elif way == 6:
        text = text.replace(mark, chance.choice((";", "\t", ",", " ", "  ", '","')))
    elif way == 7:
        text = text.replace("\n", "x" * chance.choice((200_000, 10)) + "\n", 1)
    elif way == 8:
        text = text.upper()
    elif way == 9:
        text = text.replace("0", "\0", 1)
    return text.encode("utf-8", "surrogatepass")


def in_tree(tree: Any, chance: Random) -> str:
    """Change one to three nodes of a tree and return it as JSON: other types, hostile numbers and names, lost keys."""
    tree = copy.deepcopy(tree)
    for _ in range(chance.choice((1, 1, 2, 3))):
        places = _places(tree)
        if not places:
            break
        _in_node(*chance.choice(places), chance)
    text = json.dumps(tree)
    way = chance.randrange(40)
    if way == 0:
        return text[: chance.randrange(len(text))]
    if way == 1:
        return text.replace("{", '{"version": 1, "version": "2", ', 1)
    if way == 2:
        return text.replace(": ", ": " + "[" * 100_000, 1)
    return text


def _places(node: Any) -> list[tuple[Any, Any]]:
    found = []
    keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    for key in keys:
        found += [(node, key), *_places(node[key])]
    return found


def _in_node(parent: Any, key: Any, chance: Random) -> None:
    old, way = parent[key], chance.randrange(8)
    if way == 0:
        del parent[key]
    elif way == 1 and isinstance(parent, list):
        parent.insert(key, copy.deepcopy(old))
    elif way == 1:
        parent[f"{key}{chance.choice(('', ' ', 'x'))}".upper()] = parent.pop(key)
    elif way == 2 and isinstance(old, int | float) and not isinstance(old, bool):
        others = (old + 1, -old, old * 2, old + 0.5, 0, 1e308, 10**400, float(old), str(old), bool(old))
        parent[key] = chance.choice(others)
    elif way == 3:
        parent[key] = chance.choice(NAMES)
    elif way == 4:
        parent[key] = chance.choice((None, True, False, [], {}, "", [[]], [None], {"a": 1}, 0, -1, 1.5, "0"))
    elif way == 5:
        parent[key] = chance.choice((float("nan"), float("inf"), 2**31, 2**63, -(2**63), 1e400, 1e39, 10**30))
    elif way == 6:
        parent[key] = [old] if chance.random() < 0.5 else {"0": old}
    else:
        other, place = chance.choice(_places(parent))
        parent[key] = copy.deepcopy(other[place])
