"""Where the numbers of binary formats stand, and mistakes that keep a file's own checks happy."""

from __future__ import annotations

import json
import struct
import warnings
import zipfile
import zlib
from io import BytesIO
from random import Random

from tests.hard_cases.mutate import NAMES, WHOLE, Field, in_bytes, in_tree, set_number

_ZIP_LOCAL, _ZIP_CENTRAL, _ZIP_END = b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06"
# Where in a record stand: version, flags, method, CRC, packed and unpacked size, lengths of name and extra.
_LOCAL_FIELDS = ((4, "<H"), (6, "<H"), (8, "<H"), (14, "<I"), (18, "<I"), (22, "<I"), (26, "<H"), (28, "<H"))
_CENTRAL_FIELDS = (
    (4, "<H"), (6, "<H"), (8, "<H"), (10, "<H"), (16, "<I"), (20, "<I"), (24, "<I"), (28, "<H"), (30, "<H"), (32, "<H"),
    (34, "<H"), (38, "<I"), (42, "<I"),
)
_END_FIELDS = ((4, "<H"), (6, "<H"), (8, "<H"), (10, "<H"), (12, "<I"), (16, "<I"), (20, "<H"))


def _found(data: bytes, mark: bytes) -> list[int]:
    places, start = [], data.find(mark)
    while start >= 0:
        places.append(start)
        start = data.find(mark, start + 1)
    return places


def zip_fields(data: bytes) -> list[Field]:
    """Return the numbers in the records of an archive."""
    records = ((_ZIP_LOCAL, _LOCAL_FIELDS), (_ZIP_CENTRAL, _CENTRAL_FIELDS), (_ZIP_END, _END_FIELDS))
    return [(at + offset, kind) for mark, fields in records for at in _found(data, mark) for offset, kind in fields]


def png_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    """Return (type, data) of each chunk."""
    chunks, place = [], 8
    while place + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, place)
        chunks.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + length]))
        place += length + 12
    return chunks


def png_of(chunks: list[tuple[bytes, bytes]]) -> bytes:
    """Return a PNG of chunks with the checksums that they should have."""
    body = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + body


def in_png(data: bytes, chance: Random) -> bytes:
    """Change chunks of a PNG and correct the checksums: numbers of the head, chunks lost, doubled, moved or renamed."""
    chunks = png_chunks(data)
    number, way = chance.randrange(len(chunks)), chance.randrange(6)
    kind, body = chunks[number]
    if way < 2:
        head = bytearray(chunks[0][1])
        set_number(head, chance.choice(((0, ">I"), (4, ">I"), *_by_step(8, 13, 1, ">B"))), chance)
        chunks[0] = (b"IHDR", bytes(head))
    elif way == 2:
        del chunks[number]
    elif way == 3:
        chunks.insert(chance.randrange(len(chunks)), chunks[number])
    elif way == 4:
        names = (b"IDAT", b"tRNS", b"PLTE", b"iCCP", b"gAMA", b"acTL", b"eXIf", b"zTXt", b"IEND", b"\0\0\0\0", b"sBIT")
        chunks[number] = (chance.choice(names), body)
    elif body:
        chunks[number] = (kind, in_bytes(body, chance))
    return png_of(chunks)


def _by_step(start: int, end: int, step: int, layout: str) -> list[Field]:
    return [(offset, layout) for offset in range(start, end, step)]


def image_fields(data: bytes) -> list[Field]:
    """Return the numbers in the head of an image, whatever its format."""
    if data[:4] == b"\x76\x2f\x31\x01":  # EXR: lengths and values stand at any byte between the names
        return _by_step(4, min(len(data), 420), 1, "<I")
    if data[:2] in (b"II", b"MM"):
        order = "<" if data[:2] == b"II" else ">"
        start = struct.unpack_from(f"{order}I", data, 4)[0]
        count = struct.unpack_from(f"{order}H", data, start)[0]
        parts = ((0, "H"), (2, "H"), (4, "I"), (8, "I"))
        entries = [(start + 2 + 12 * k + at, order + kind) for k in range(count) for at, kind in parts]
        return [(4, f"{order}I"), (start, f"{order}H"), *entries]
    if data[:2] == b"\xff\xd8":
        return [(at + 2, ">H") for at in _found(data, b"\xff")[:40]] + _by_step(0, min(len(data), 400), 1, ">B")
    if data[:2] == b"BM":
        return _by_step(2, 54, 4, "<I") + _by_step(26, 30, 2, "<H")
    return _by_step(0, min(len(data), 64), 2, "<H") + _by_step(0, min(len(data), 64), 1, "<B")


def glb_fields(data: bytes) -> list[Field]:
    """Return the lengths and types of a GLB and of its first chunk."""
    return _by_step(0, 20, 4, "<I")


def tensor_fields(data: bytes) -> list[Field]:
    """Return the numbers of a tensor file's head and some of its arrays."""
    end = min(len(data), 500)
    head = [(12, "<B"), (13, "<B"), (14, "<I"), *_by_step(18, end, 1, "<H"), *_by_step(18, end, 1, "<Q")]
    return head + _by_step(end, len(data) - 3, 4, "<f")


def merl_fields(data: bytes) -> list[Field]:
    """Return the sizes of a MERL file and its entries."""
    return [*_by_step(0, 12, 4, "<i")] * 20 + _by_step(12, len(data), 8, "<d")


def stl_fields(data: bytes) -> list[Field]:
    """Return the count of a binary STL and its numbers."""
    return [(80, "<I")] * 5 + _by_step(84, len(data) - 3, 4, "<f")


def dfmf_fields(data: bytes) -> list[Field]:
    """Return the numbers in the head of a DFMF, wherever they begin, and some of its factors."""
    end = min(len(data), 700)
    return _by_step(10, end - 3, 1, "<I") + _by_step(250, end - 3, 4, "<f") + _by_step(end, len(data) - 7, 8, "<d")


def hdf5_fields(data: bytes) -> list[Field]:
    """Return the numbers of an HDF5's records, which lie at any byte of what is no data."""
    end = min(len(data), 4000)
    return _by_step(0, end, 1, "<B") + _by_step(0, end - 3, 2, "<I") + _by_step(0, end - 7, 4, "<Q")


def in_json(data: bytes, chance: Random) -> bytes:
    """Change the tree of a JSON file."""
    return in_tree(json.loads(data), chance).encode()


def in_glb(data: bytes, chance: Random) -> bytes:
    """Change the tree of a GLB and correct its lengths."""
    length = struct.unpack_from("<I", data, 12)[0]
    text = in_tree(json.loads(data[20 : 20 + length]), chance).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


def in_zip(data: bytes, chance: Random) -> bytes:
    """Write the members of an archive anew, with one of the things that archives do to those who trust them."""
    with zipfile.ZipFile(BytesIO(data)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    number, way = chance.randrange(len(members)), chance.randrange(8)
    name, body = members[number]
    if way == 0:
        members[number] = (chance.choice(NAMES) or "x", body)
    elif way == 1:
        members.append((name, chance.choice((b"", body, body[:-1], members[0][1]))))
    elif way == 2:
        members[number] = (name, b"\0" * chance.choice((4_000_000, 1000)))  # unpacks to a thousand times its size
    elif way == 3:
        members += [(f"{'d/' * chance.choice((1, 200))}{k}.txt", b"") for k in range(chance.choice((3, 3000)))]
    elif way == 4:
        members[number] = (name, data)
    elif way == 5:
        chance.shuffle(members)
    elif way == 6:
        del members[number]
    return _zip_of(members, number if way == 7 else -1, chance)


def _zip_of(members: list[tuple[str, bytes]], link: int, chance: Random) -> bytes:
    target = BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(target, "w") as archive:
        warnings.simplefilter("ignore")  # of names that stand twice, which is the point
        for place, (name, body) in enumerate(members):
            info = zipfile.ZipInfo(name.replace("\0", "?"))
            if place == link:
                info.external_attr = 0o120777 << 16
                body = chance.choice(NAMES).encode("utf-8", "replace")
            info.compress_type = chance.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED))
            archive.writestr(info, body)
    return target.getvalue()


def lying_zip(data: bytes, chance: Random) -> bytes:
    """Change a number in the records of an archive, in both of the records that hold it or in one."""
    found = bytearray(data)
    for _ in range(chance.choice((1, 1, 2))):
        offset, layout = chance.choice(zip_fields(data))
        size = struct.calcsize(layout)
        old, new = bytes(found[offset : offset + size]), (chance.choice(WHOLE) % 256**size).to_bytes(size, "little")
        if size == 4 and chance.random() < 0.5:  # a size or a CRC, in both records
            found = bytearray(bytes(found).replace(old, new)) if old.strip(b"\0") else found
        found[offset : offset + size] = new
    return bytes(found)
