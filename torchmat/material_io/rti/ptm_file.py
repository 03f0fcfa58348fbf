"""Polynomial texture maps, ``.ptm`` (Malzbender et al. 2001; Hewlett-Packard's file format, version 1.2).

A head in ASCII: ``PTM_1.2``, ``PTM_FORMAT_RGB`` or ``PTM_FORMAT_LRGB``, width, height, six scales, six whole biases. Then bytes,
rows from the bottom: of RGB the six of each texel for red, then for green, then for blue; of LRGB six a texel, then the colours.
A coefficient is ``(code - bias) * scale``, for values of 0 to 255, in the order of ours.
"""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchmat.errors import DataError, RangeError, message
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.rti.coefficients import Coefficients, Ranges, coefficients_of
from torchmat.material_io.rti.losses import losses_of
from torchmat.material_io.rti.sampled import as_rti, is_rti
from torchmat.models import Material

SUFFIX = ".ptm"
MAGIC = b"PTM_1."
COLOURS = ("auto", "rgb", "lrgb")
_LONGEST = 4096  # bytes of a head
_TERMS, _LEVELS = 6, 255
_FORMATS = {"PTM_FORMAT_RGB": "ptm", "PTM_FORMAT_LRGB": "lptm"}
_BYTES = {"ptm": 18, "lptm": 9}  # of a texel
_HEAD = re.compile(
    rb"(PTM_1\.[12])\s+(PTM_FORMAT_\w+)\s+(\d{1,9})\s+(\d{1,9})((?:\s+[-+.\deE]{1,40}){12})[ \t]*\r?\n"
)
_START = re.compile(rb"(PTM_1\.\d)\s+(PTM_FORMAT_\w+)\s")


class _Head(NamedTuple):
    version: str
    model: str
    width: int
    height: int
    scale: np.ndarray
    bias: np.ndarray
    bytes: int


def read_ptm(path: str | Path) -> Material:
    """Return the material of a ``.ptm`` file: a `ptm`, or of LRGB an `lptm`, in codes of a screen.

    Raises DataError, which names the file, for compressed forms and others, a damaged head, and one that promises another size
    than the file has; nothing is read before that is checked.
    """
    path = Path(path)
    try:
        with open(path, "rb") as stream:
            head = _read_head(path, stream.read(_LONGEST))
            _check_size(path, head, os.fstat(stream.fileno()).st_size)
            stream.seek(head.bytes)
            data = np.frombuffer(stream.read(_BYTES[head.model] * head.width * head.height), np.uint8)
    except OSError as error:
        raise DataError(message(str(path), "the PTM", "be readable", str(error), "Check the path.")) from error
    if len(data) != _BYTES[head.model] * head.width * head.height:
        raise DataError(message(str(path), "the PTM", "be readable to its end", f"{len(data)} bytes came", "Read it again."))
    low, high = -head.bias * head.scale / _LEVELS, (_LEVELS - head.bias) * head.scale / _LEVELS
    if head.model == "ptm":
        codes = data.reshape(3, head.height, head.width, _TERMS)[:, ::-1].transpose(3, 0, 1, 2)
        codes = codes.reshape(3 * _TERMS, head.height, head.width)
        return Coefficients("ptm", codes, low.repeat(3), high.repeat(3)).material()
    terms, colours = _luminance_and_colours(data, head)
    codes = np.concatenate((colours, terms), axis=2)[::-1].transpose(2, 0, 1)
    ends = np.concatenate((np.zeros(3), low)), np.concatenate((np.ones(3), high))
    return Coefficients("lptm", np.ascontiguousarray(codes), *ends).material()


def _luminance_and_colours(data: np.ndarray, head: _Head) -> tuple[np.ndarray, np.ndarray]:
    size = (head.height, head.width)
    if head.version == "PTM_1.1":  # colours stood with each texel before
        texels = data.reshape(*size, _TERMS + 3)
        return texels[..., :_TERMS], texels[..., _TERMS:]
    first = _TERMS * head.width * head.height
    return data[:first].reshape(*size, _TERMS), data[first:].reshape(*size, 3)


def _read_head(path: Path, data: bytes) -> _Head:
    start = _START.match(data)
    if start is None:
        step = "Check that it is a PTM, and complete."
        raise DataError(message(str(path), "the head", "begin with PTM_1.2 and a format", f"it begins {data[:24]!r}", step))
    kind = start[2].decode("ascii")
    if kind not in _FORMATS or start[1] not in (b"PTM_1.1", b"PTM_1.2"):
        fact = f"it is {start[1].decode('ascii')}, {kind}"
        step = "Save it uncompressed as PTM_FORMAT_RGB or PTM_FORMAT_LRGB, version 1.2, from PTM fitter or RTIBuilder."
        raise DataError(message(str(path), "the PTM", f"be {' or '.join(_FORMATS)}", fact, step))
    found = _HEAD.match(data)
    if found is None:
        step = "Check that the file is complete, and was copied as binary."
        requirement = "be width, height, six scales and six biases"
        raise DataError(message(str(path), f"the head of {kind}", requirement, f"it begins {data[:80]!r}", step))
    return _checked(path, found, _FORMATS[kind])


def _checked(path: Path, found: re.Match[bytes], model: str) -> _Head:
    try:
        numbers = [float(word) for word in found[5].split()]
    except ValueError:
        numbers = [math.nan]
    scale, bias = np.array(numbers[:_TERMS]), np.array(numbers[_TERMS:])
    sound = len(numbers) == 2 * _TERMS and all(math.isfinite(number) and abs(number) < 1e6 for number in numbers)
    if not sound or (scale == 0).any():
        fact = f"they are {found[5].split()}"
        step = "Restore the file from the original."
        raise DataError(message(str(path), "scales and biases", "be finite, and scales not 0", fact, step))
    width, height = int(found[3]), int(found[4])
    if min(width, height) < 1:
        raise DataError(message(str(path), "width and height", "be positive", f"they are {width} and {height}", "Correct the head."))
    return _Head(found[1].decode("ascii"), model, width, height, scale, bias, found.end())


def _check_size(path: Path, head: _Head, size: int) -> None:
    wanted = _BYTES[head.model] * head.width * head.height
    if wanted != size - head.bytes:
        fact = f"{head.width} x {head.height} x {_BYTES[head.model]} are {wanted} bytes and {size - head.bytes} follow the head"
        step = "The file is truncated, or its head is wrong: restore it from the original."
        raise DataError(message(str(path), "the PTM", "have the size that its head says", fact, step))


def write_ptm(material: Material, path: Path, *, colours: str = "auto") -> Losses:
    """Write a material as a ``.ptm`` file.

    A `ptm` or `lptm` in codes of a screen is written as it is; any other material is fitted first, as it is seen along the
    normal. `colours`: "rgb", "lrgb" (half the bytes: one luminance polynomial and a colour), or "auto", as the material has it.
    """
    if colours not in COLOURS:
        step = f"Choose one of {', '.join(COLOURS)}."
        raise RangeError(message("export to ptm", "colours", "be a known form", f"it is {colours!r}", step))
    model = {"rgb": "ptm", "lrgb": "lptm"}.get(colours, "lptm" if material.name == "lptm" else "ptm")
    written = material if is_rti(material, (model,)) else as_rti(material, model)
    path.write_bytes(_encoded(coefficients_of(written, shared=True, adjusted=_with_whole_biases)))
    return losses_of(material, written, read_ptm(path), "8 bits")


def _ends(found: Coefficients) -> tuple[np.ndarray, np.ndarray]:
    """Return the low and high ends of the six terms."""
    return (found.low[::3], found.high[::3]) if found.model == "ptm" else (found.low[3:], found.high[3:])


def _scales(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the scale and bias of each term, for values of 0 to 255."""
    return high - low, -low * _LEVELS / (high - low)


def _with_whole_biases(low: np.ndarray, high: np.ndarray) -> Ranges:
    """Return ranges whose biases are whole numbers, as the file wants them: those that are not begin anew from 0 to 255."""
    _, bias = _scales(low, high)
    whole = abs(bias - np.rint(bias)) < 1e-6 * np.maximum(1, abs(bias))
    least, most = np.minimum(np.minimum(low, high), 0), np.maximum(np.maximum(low, high), 0)
    step = (most - least) / (_LEVELS - 1)  # one step is left for the rounding of the bias
    other = np.rint(-least / step)
    return np.where(whole, low, -other * step), np.where(whole, high, (_LEVELS - other) * step)


def _encoded(found: Coefficients) -> bytes:
    height, width = found.codes.shape[1:]
    scale, bias = _scales(*_ends(found))
    kind = next(name for name, model in _FORMATS.items() if model == found.model)
    # Nine digits bring a scale back as the same single-precision number, which is what readers keep.
    scales, biases = " ".join(f"{one:.9g}" for one in scale), " ".join(str(round(one)) for one in bias)
    head = f"PTM_1.2\n{kind}\n{width}\n{height}\n{scales}\n{biases}\n"
    upright = found.codes[:, ::-1]
    if found.model == "ptm":
        body = upright.reshape(_TERMS, 3, height, width).transpose(1, 2, 3, 0).tobytes()
    else:
        body = upright[3:].transpose(1, 2, 0).tobytes() + upright[:3].transpose(1, 2, 0).tobytes()
    return head.encode("ascii") + body


PTM = Exporter("ptm", "a polynomial texture map, HP's .ptm: one view, 8 bits; other materials are fitted to it", write_ptm, SUFFIX)
