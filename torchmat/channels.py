"""What the channels of a picture mean: grey or RGB, with alpha or without, or CIE XYZ, which becomes linear RGB."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchmat.errors import DataError, RangeError, message

# IEC 61966-2-1: CIE XYZ, where the white of D65 has Y = 1, to linear RGB with Rec. 709 primaries.
XYZ_TO_RGB = (
    (3.2404542, -1.5371385, -0.4985314),
    (-0.9692660, 1.8760108, 0.0415560),
    (0.0556434, -0.2040259, 1.0572252),
)
_GREY, _RGB, _XYZ, _ALPHA = ("Y",), ("R", "G", "B"), ("X", "Y", "Z"), ("A",)


def channel_order(path: str | Path, names: Sequence[str]) -> tuple[list[int], bool]:
    """Return where the named channels of an EXR stand in the order Y, RGB or XYZ and alpha, and whether they are XYZ.

    Raises DataError, which names the file and its channels, for any others: what a layer or a pass means, or which
    of several is wanted, its name alone does not say.
    """
    plain = [name.upper() for name in names]
    for colours in (_GREY, _RGB, _XYZ):
        for wanted in (colours, colours + _ALPHA):
            if sorted(plain) == sorted(wanted):
                return [plain.index(name) for name in wanted], colours == _XYZ
    fact = f"they are {', '.join(map(repr, names))}"
    step = "Save the picture alone, in one layer, as R, G, B (linear) or as X, Y, Z (CIE XYZ)."
    raise DataError(message(str(path), "the channels", "be Y, or R, G, B, or X, Y, Z, with A or without", fact, step))


def numbered_order(names: Sequence[str]) -> list[int] | None:
    """Return where channels that are numbered stand in the order of their numbers; None where they do already, or are not.

    OpenImageIO calls the channels of an EXR R, G, B, A, channel4, channel5 ..., and the file keeps them sorted as texts, channel10
    before channel4.
    """
    numbers = ["RGBA".find(name) if len(name) == 1 else _number_of(name) for name in names]
    order = sorted(range(len(names)), key=numbers.__getitem__)
    return order if sorted(numbers) == list(range(len(names))) and numbers != sorted(numbers) else None


def _number_of(name: str) -> int:
    number = name.removeprefix("channel")
    return int(number) if number != name and number.isdecimal() else -1


def rgb_of_xyz(where: str, codes: np.ndarray) -> np.ndarray:
    """Return linear Rec. 709 RGB of CIE XYZ under D65, planes [3, ...] of a floating-point type, in that type.

    Colours outside of the gamut have negative channels, and keep them. Raises RangeError, which names `where`, for
    whole numbers: codes of XYZ have no agreed scale.
    """
    if not np.issubdtype(codes.dtype, np.floating):
        step = "Save it in floating point, or leave the encoding to `auto`."
        raise RangeError(message(where, "CIE XYZ", "be in floating-point numbers", f"they are {codes.dtype}", step))
    with np.errstate(over="ignore", invalid="ignore"):  # what is no number is the caller's to find
        found = np.tensordot(np.array(XYZ_TO_RGB, np.float32), codes.astype(np.float32), axes=1)
        return found.astype(codes.dtype)
