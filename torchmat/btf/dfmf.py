"""The file of a decorrelated full matrix factorisation (DFMF), Bonn's UBO2014 ``.btf``: its head, and where its factors lie.

Little-endian: signature; header (its size, version, three texts of 80 bytes, pixels a millimetre, three scales of RGB; by
version a cosine flag, an XML text, channel names); views, each with its lights; width, height; rotations; components, colour
model, mean, matrix; then for each channel the size of its numbers, K, rows, columns, S [K], U [rows, K] and S V [columns, K].
The matrix of a channel is U (S V)^T: a row is light + lights * view, a column x + width * y, or the other way round.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from torchmat.errors import DataError, message

SIGNATURE = b"!DFMF08FCR"
# Other files of the same makers: what their data is compressed with is another thing in each.
OTHERS = {
    b"!FMF06FC": "a full matrix factorisation (FMF)", b"!FMF12FCER": "a full matrix factorisation (FMF)",
    b"!PVF06FC": "a factorisation by view (PVF)",
}
_CUT, _DAMAGED = "Check that the download or copy is complete.", "Check that the file is undamaged."
PLAIN, LOG_YUV, LOG_RGB = 0, 11, 12
_CHANNELS = 3
_EPSILON = np.float32(1e-5)  # of the logarithms; no file says it
_SCALARS = {2: np.float16, 4: np.float32, 8: np.float64}
# No capture has more; what a damaged head says beyond is not looked at.
_MOST_TEXT, _MOST_CHANNELS, _MOST_SAMPLES, _MOST_TEXELS = 1 << 26, 64, 1 << 24, 1 << 30


@dataclass(frozen=True)
class Factors:
    """Where the two factors of one channel lie: `samples` [n, K] and `texels` [H * W, K], mapped and not read."""

    samples: np.ndarray
    texels: np.ndarray


@dataclass(frozen=True)
class Dfmf:
    """What the file says: angles (polar, azimuth) in radians of view and light of each sample [n, 2], and three channels."""

    light: np.ndarray
    view: np.ndarray
    height: int
    width: int
    cosine: bool
    model: int
    channels: tuple[Factors, ...]
    rgb_scale: tuple[float, ...]
    channel_names: tuple[str, ...]
    rotations: int


class _Head:
    """Reads numbers one after the other; what would lie beyond the end of the file is a DataError that says what it was."""

    def __init__(self, stream: BinaryIO, path: Path) -> None:
        self.stream, self.path, self.size = stream, path, path.stat().st_size

    def wrong(self, name: str, requirement: str, fact: str, step: str = _CUT) -> DataError:
        return DataError(message(f"{self.path}: UBO2014 (DFMF)", name, requirement, fact, step))

    def place(self, count: int, what: str) -> int:
        """Return where the next `count` bytes begin, and go on behind them."""
        start = self.stream.tell()
        if count > self.size - start:
            fact = f"{count} bytes are wanted at {start} and the file has {self.size}"
            raise self.wrong(what, "lie within the file", fact)
        self.stream.seek(count, 1)
        return start

    def numbers(self, kind: str, what: str) -> tuple:
        start = self.place(struct.calcsize(f"<{kind}"), what)
        self.stream.seek(start)
        return struct.unpack(f"<{kind}", self.stream.read(struct.calcsize(f"<{kind}")))

    def count(self, what: str, most: int, least: int = 1) -> int:
        (found,) = self.numbers("I", what)
        if not least <= found <= most:
            raise self.wrong(what, f"be a number from {least} to {most}", f"it is {found}", _DAMAGED)
        return int(found)

    def text(self, what: str, most: int) -> str:
        length = self.count(f"the length of {what}", most, 0)
        start = self.place(length, what)
        self.stream.seek(start)
        return self.stream.read(length).decode("latin-1").rstrip("\0")


def read_dfmf(path: Path) -> Dfmf:
    """Read the head of a file and map its factors; raises DataError, which names the file and what in it is wrong."""
    with open(path, "rb") as stream:
        head = _Head(stream, path)
        start = head.place(len(SIGNATURE), "the signature") + len(SIGNATURE)
        stated, version = head.numbers("II", "the header's size and version")
        head.place(3 * 80, "the texts of the header")
        scale = head.numbers("4f", "the scales of the header")[1:]
        cosine = version > 1 and head.numbers("I", "the cosine flag")[0] != 0
        if version > 2:
            head.place(head.count("the length of the XML text", _MOST_TEXT, 0), "the XML text")
        count = head.count("the number of channels", _MOST_CHANNELS) if version > 3 else _CHANNELS
        names = [head.text("a channel's name", 4096) for _ in range(count)] if version > 3 else ["R", "G", "B"]
        if start + stated != stream.tell():
            fact = f"it says {stated} bytes and {stream.tell() - start} were read, by version {version}"
            step = "It is damaged, or of a version that is not known."
            raise head.wrong("the header's size", "be what it holds", fact, step)
        if count != _CHANNELS:
            step = "Export it as RGB first."
            raise head.wrong("the channels", "be three", f"they are {count}: {', '.join(names[:8])}", step)
        light, view = _angles(head)
        width, height = head.count("the width", _MOST_TEXELS), head.count("the height", _MOST_TEXELS)
        rotations = head.count("the number of rotations", _MOST_TEXELS, 0)
        head.place(36 * rotations, "the rotations")
        _, model, *_ = head.numbers("Ii3f9f", "the colour model")
        if model not in (PLAIN, LOG_YUV, LOG_RGB):
            step = "Known are 0 (as it is), 11 (logarithms of YUV) and 12 (logarithms of RGB); export it in one of these."
            raise head.wrong("the colour model", "be 0, 11 or 12", f"it is {model}", step)
        channels = tuple(_factors(head, name, len(light), height * width) for name in names)
    found = tuple(map(float, scale))
    return Dfmf(light, view, height, width, cosine, model, channels, found, tuple(names), rotations)


def _angles(head: _Head) -> tuple[np.ndarray, np.ndarray]:
    """Return polar angle and azimuth of light and view of all samples [n, 2], lights running fastest."""
    views = head.count("the number of views", _MOST_SAMPLES)
    light, view, first = [], [], 0
    for number in range(views):
        polar, azimuth, count = head.numbers("2fI", f"view {number}")
        first = first or count
        if count != first or not 0 < count <= _MOST_SAMPLES // views:
            fact = f"view {number} has {count} and the first {first}, of {views} views"
            raise head.wrong("the lights of a view", "be as many as those of every other", fact, _DAMAGED)
        start = head.place(8 * count, f"the lights of view {number}")
        head.stream.seek(start)
        light.append(np.frombuffer(head.stream.read(8 * count), "<f4").reshape(count, 2))
        view.append(np.broadcast_to(np.array([polar, azimuth]), (count, 2)))
    return np.concatenate(light).astype(np.float64), np.concatenate(view)


def _factors(head: _Head, name: str, samples: int, texels: int) -> Factors:
    what = f"channel {name}"
    (size,) = head.numbers("B", what)
    if size not in _SCALARS:
        raise head.wrong(what, "hold numbers of 2, 4 or 8 bytes", f"it says {size}", _DAMAGED)
    parts = ("the components", "the rows", "the columns")
    kept, rows, columns = (head.count(f"{part} of {what}", _MOST_TEXELS) for part in parts)
    if (rows, columns) not in ((samples, texels), (texels, samples)):
        wanted, fact = f"be {samples} samples and {texels} texels", f"they are {rows} and {columns}"
        raise head.wrong(f"rows and columns of {what}", wanted, fact, _DAMAGED)
    head.place(kept * size, f"the singular values of {what}")
    dtype = np.dtype(_SCALARS[size]).newbyteorder("<")
    maps = []
    for count in (rows, columns):
        start = head.place(count * kept * size, f"the factors of {what}")
        maps.append(np.memmap(head.path, dtype, "r", start, (count, kept)))
    # A square matrix is taken for the usual way round.
    return Factors(*(maps if rows == samples else maps[::-1]))


def named_other(start: bytes) -> str | None:
    """Return what a file of the same makers is that is no DFMF, by how it starts; None for any other."""
    return next((what for signature, what in OTHERS.items() if start.startswith(signature)), None)


def decoded(model: int, channels: Iterable[np.ndarray]) -> list[np.ndarray]:
    """Return red, green and blue of the three decorrelated channels, float32, in place where that can be."""
    first, second, third = channels
    if model == PLAIN:
        return [first, second, third]
    if model == LOG_RGB:
        return [np.exp(channel, out=channel) - _EPSILON for channel in (first, second, third)]
    luminance = np.exp(first, out=first)
    u, v = second * luminance, third * luminance  # they are stored relative to Y + epsilon
    luminance -= _EPSILON
    return [luminance + 1.13983 * v, luminance - 0.39465 * u - 0.5806 * v, luminance + 2.03211 * u]
