"""Hemispherical harmonics in one file, ``.rti`` (RTIBuilder's ``#HSH1.2``).

A head in ASCII: lines that begin with ``#``, then ``3``, ``width height 3``, ``terms 2 1``; float32 scale[terms] and offset[terms];
then bytes, rows from the top, of each texel all terms of red, of green, of blue. A coefficient is ``code / 255 * scale + offset``,
for values of 0 to 1.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchmat.errors import DataError, RangeError, message
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.rti.coefficients import arranged, coefficients_of, harmonics_in_files
from torchmat.material_io.rti.losses import losses_of
from torchmat.material_io.rti.sampled import as_rti, is_rti
from torchmat.models import Material
from torchmat.models.linear import HSH_TERMS

SUFFIX = ".rti"
MAGIC = b"#HSH1."
_LONGEST = 4096  # bytes of a head
_HEAD = re.compile(
    rb"(?:#[^\n]*\n)+\s*(\d{1,4})\s+(\d{1,9})\s+(\d{1,9})\s+(\d{1,4})\s+(\d{1,4})\s+(\d{1,4})\s+(\d{1,4})[ \t]*\r?\n"
)
_HARMONICS, _BYTE = 3, 1  # what the head calls them


class _Head(NamedTuple):
    width: int
    height: int
    terms: int
    bytes: int

    @property
    def body(self) -> int:
        """Bytes that follow the text."""
        return 8 * self.terms + 3 * self.terms * self.width * self.height


def read_rti(path: str | Path) -> Material:
    """Return the material of an ``.rti`` file of harmonics: an `hsh` in codes of a screen.

    Raises DataError, which names the file, for other kinds of RTI, a damaged head, and one that promises another size than the
    file has; nothing is read before that is checked.
    """
    path = Path(path)
    try:
        with open(path, "rb") as stream:
            head = _read_head(path, stream.read(_LONGEST), os.fstat(stream.fileno()).st_size)
            stream.seek(head.bytes)
            with np.errstate(invalid="ignore"):  # of a NaN that signals, which is refused below
                ranges = np.frombuffer(stream.read(8 * head.terms), "<f4").astype(np.float64)
            data = np.frombuffer(stream.read(head.body - 8 * head.terms), np.uint8)
    except OSError as error:
        raise DataError(message(str(path), "the RTI", "be readable", str(error), "Check the path.")) from error
    if 4 * len(ranges) + len(data) != head.body:
        raise DataError(message(str(path), "the RTI", "be readable to its end", f"{len(data)} bytes came", "Read it again."))
    scale, offset = ranges[: head.terms], ranges[head.terms :]
    if not np.isfinite(ranges).all() or abs(ranges).max() > 1e6 or (scale == 0).any():
        step = "Restore the file from the original."
        fact = f"they are {scale.tolist()} and {offset.tolist()}"
        raise DataError(message(str(path), "scales and offsets", "be finite, and scales not 0", fact, step))
    planes = data.reshape(head.height, head.width, 3, head.terms).transpose(3, 2, 0, 1).reshape(3 * head.terms, head.height, head.width)
    ends = offset.repeat(3), (scale + offset).repeat(3)
    return arranged("hsh", planes, *ends, *harmonics_in_files(head.terms)).material()


def _read_head(path: Path, data: bytes, size: int) -> _Head:
    found = _HEAD.match(data)
    if not data.startswith(MAGIC) or found is None:
        begun = data[:24].split(b"\n")[0]
        step = "Save it from RTIBuilder as hemispherical harmonics (HSH)." if data[:1] == b"#" else "Check that it is an RTI, and complete."
        requirement = "begin with #HSH1.2, a 3, width height 3 and terms 2 1"
        raise DataError(message(str(path), "the head", requirement, f"it begins {begun!r}", step))
    kind, width, height, colours, terms, _, size_of_one = (int(word) for word in found.groups())
    if (kind, colours, size_of_one) != (_HARMONICS, 3, _BYTE) or terms not in HSH_TERMS:
        fact = f"the head says kind {kind}, {colours} colours, {terms} terms of {size_of_one} bytes"
        requirement = f"be of kind 3 (harmonics), with 3 colours, {', '.join(map(str, HSH_TERMS))} terms of 1 byte"
        step = "Save it from RTIBuilder as hemispherical harmonics (HSH)."
        raise DataError(message(str(path), "the RTI", requirement, fact, step))
    head = _Head(width, height, terms, found.end())
    if min(width, height) < 1 or head.body != size - head.bytes:
        fact = f"{width} x {height} with {terms} terms take {head.body} bytes and {size - head.bytes} follow the head"
        step = "The file is truncated, or its head is wrong: restore it from the original."
        raise DataError(message(str(path), "the RTI", "have the size that its head says", fact, step))
    return head


def write_rti(material: Material, path: Path, *, terms: int | None = None) -> Losses:
    """Write a material as an ``.rti`` file of harmonics.

    An `hsh` in codes of a screen is written as it is; any other material is fitted first, as it is seen along the normal.
    `terms`: 4, 9 or 16; None is what an `hsh` has, and 9 of others.
    """
    if terms not in (None, *HSH_TERMS):
        step = f"Choose one of {', '.join(map(str, HSH_TERMS))}."
        raise RangeError(message("export to rti", "terms", "be those of a band", f"they are {terms!r}", step))
    own = material.options["terms"] if is_rti(material, ("hsh",)) else None
    count = int(terms or own or 9)
    written = material if own == count else as_rti(material, "hsh", count)
    found = coefficients_of(written, shared=True, adjusted=_single)
    place, sign = harmonics_in_files(count)
    codes, low, high = found.codes[place], (sign * found.low[place])[::3], (sign * found.high[place])[::3]
    height, width = material.size
    head = f"#HSH1.2\n{_HARMONICS}\n{width} {height} 3\n{count} 2 {_BYTE}\n".encode("ascii")
    ranges = np.concatenate((high - low, low)).astype("<f4").tobytes()
    body = codes.reshape(count, 3, height, width).transpose(2, 3, 1, 0).tobytes()
    path.write_bytes(head + ranges + body)
    return losses_of(material, written, read_rti(path), "8 bits")


def _single(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ranges as the file's single precision has them."""
    start, span = low.astype(np.float32).astype(np.float64), (high - low).astype(np.float32).astype(np.float64)
    return start, start + span


RTI = Exporter("rti", "hemispherical harmonics, RTIBuilder's .rti: one view, 8 bits; other materials are fitted to it", write_rti, SUFFIX)
