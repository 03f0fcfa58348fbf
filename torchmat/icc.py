"""ICC colour profiles of pictures: matrix and curve ones are converted to sRGB, others are refused by name (ICC.1:2022)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from torchmat.errors import DataError, message

Curve = Callable[[np.ndarray], np.ndarray]
# Red, green and blue of sRGB in the profiles' own space, XYZ adapted to D50 (Lindbloom).
_SRGB_TO_XYZ = np.array([
    [0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169], [0.0139322, 0.0971045, 0.7141733],
])
_SAME_MATRIX, _SAME_CURVE = 0.004, 0.003  # sRGB profiles differ by so much among each other
_STEP = "Convert the picture to sRGB, or give its encoding (srgb or linear): then the profile is not looked at."
_PARAMETERS = {0: 1, 1: 3, 2: 4, 3: 5, 4: 7}


@dataclass(frozen=True)
class Profile:
    """What a profile says: its `name`, curves to linear light, and the matrix to linear sRGB (None: it is of grey)."""

    name: str
    curves: tuple[Curve, ...]
    matrix: np.ndarray | None

    @property
    def is_srgb(self) -> bool:
        """Whether it is sRGB, so that nothing need be converted."""
        return self._plain and all(self._follows(curve, _from_srgb) for curve in self.curves)

    @property
    def is_linear(self) -> bool:
        """Whether it has sRGB's primaries and no curve."""
        return self._plain and all(self._follows(curve, lambda x: x) for curve in self.curves)

    @property
    def _plain(self) -> bool:
        return self.matrix is None or bool(np.abs(self.matrix - np.eye(3)).max() < _SAME_MATRIX)

    @staticmethod
    def _follows(curve: Curve, other: Curve) -> bool:
        at = np.linspace(0, 1, 256)
        with np.errstate(all="ignore"):
            return bool(np.abs(curve(at) - other(at)).max() < _SAME_CURVE)

    def to_linear(self, values: np.ndarray) -> np.ndarray:
        """Return linear sRGB values [H, W, 1 or 3], float32, of values in [0, 1] as the profile has them."""
        with np.errstate(all="ignore"):  # numbers of a damaged profile
            linear = np.stack([curve(values[..., c]) for c, curve in enumerate(self.curves)], axis=-1)
            linear = np.nan_to_num(linear.astype(np.float32), nan=0.0, posinf=1.0, neginf=0.0)
            return linear if self.matrix is None else linear @ self.matrix.T.astype(np.float32)


def _from_srgb(x: np.ndarray) -> np.ndarray:
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)


def _to_srgb(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** np.float32(1 / 2.4) - np.float32(0.055))


def read_profile(where: str, data: bytes) -> Profile:
    """Return what a profile says; raises DataError, which names the picture, for kinds that are not matrix and curves."""
    try:
        return _parse(where, data)
    except DataError:
        raise
    except (struct.error, ValueError, KeyError, IndexError, ArithmeticError) as error:
        raise DataError(message(where, "its colour profile", "be readable", f"it is damaged ({error})", _STEP)) from error


def _parse(where: str, data: bytes) -> Profile:
    (count,) = struct.unpack_from(">I", data, 128)
    if count > 200:
        raise ValueError(f"{count} tags")
    tags = {}
    for number in range(count):
        sign, offset, size = struct.unpack_from(">4sII", data, 132 + 12 * number)
        tags[sign] = data[offset : offset + size]
    name, space = _name(tags.get(b"desc", b"")), data[16:20]
    if space == b"GRAY" and b"kTRC" in tags:
        return Profile(name, (_curve(tags[b"kTRC"]),), None)
    if space != b"RGB " or not {b"rXYZ", b"gXYZ", b"bXYZ", b"rTRC", b"gTRC", b"bTRC"} <= tags.keys():
        kind = space.decode("latin-1").strip()
        kind = kind if kind and kind.isprintable() else "unknown"
        fact = f"{name!r} is a table for {kind} colours" if space == b"RGB " else f"{name!r} is for {kind} colours"
        raise DataError(message(where, "its colour profile", "be of RGB or grey, by matrix and curves", fact, _STEP))
    columns = [struct.unpack_from(">3i", tags[sign], 8) for sign in (b"rXYZ", b"gXYZ", b"bXYZ")]
    to_xyz = np.array(columns, dtype=np.float64).T / 65536
    curves = tuple(_curve(tags[sign]) for sign in (b"rTRC", b"gTRC", b"bTRC"))
    return Profile(name, curves, np.linalg.inv(_SRGB_TO_XYZ) @ to_xyz)


def _name(tag: bytes) -> str:
    if tag[:4] == b"desc" and len(tag) > 12:
        (length,) = struct.unpack_from(">I", tag, 8)
        return tag[12 : 12 + min(length, 200)].split(b"\0")[0].decode("latin-1")
    if tag[:4] == b"mluc" and len(tag) >= 28:
        length, offset = struct.unpack_from(">II", tag, 20)
        return tag[offset : offset + min(length, 400)].decode("utf-16-be", "replace").split("\0")[0]
    return "without a name"


def _curve(tag: bytes) -> Curve:
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return lambda x: x
        table = np.frombuffer(tag, ">u2", count, 12)
        if count == 1:
            gamma = float(table[0]) / 256
            return lambda x: np.maximum(x, 0) ** gamma
        steps, values = np.linspace(0, 1, count), table.astype(np.float64) / 65535
        return lambda x: np.interp(x, steps, values)
    if tag[:4] != b"para":
        raise ValueError(f"a curve of kind {tag[:4]!r}")
    (kind,) = struct.unpack_from(">H", tag, 8)
    numbers = [value / 65536 for value in struct.unpack_from(f">{_PARAMETERS[kind]}i", tag, 12)]
    return _parametric(kind, numbers)


def _parametric(kind: int, numbers: list[float]) -> Curve:
    gamma, a, b, c, d, e, f = (numbers + [0.0] * 7)[:7]
    if kind == 0:
        return lambda x: np.maximum(x, 0) ** gamma
    if kind in (1, 2):  # the power from x = -b / a on, and a constant below
        c, d, e, f = 0.0, -b / a, c, c
    # Now as kinds 3 and 4: (a x + b)^gamma + e from d on, c x + f below.
    return lambda x: np.where(x >= d, np.maximum(a * x + b, 0) ** gamma + e, c * x + f)


def converted(where: str, pixels: np.ndarray, data: bytes) -> np.ndarray:
    """Return pixels [H, W, C] with a colour profile as sRGB: 16-bit codes of whole numbers, linear light of floating point.

    Those that are sRGB already come back as they are, and alpha always does. A channel at its largest code stays there, so
    that what was clipped counts as clipped. Raises DataError for profiles that cannot be converted.
    """
    profile = read_profile(where, data)
    whole = np.issubdtype(pixels.dtype, np.integer)
    if profile.is_srgb if whole else profile.is_linear:
        return pixels
    channels = pixels.shape[2] - (pixels.shape[2] in (2, 4))
    if channels != len(profile.curves):
        fact = f"{profile.name!r} has {len(profile.curves)} channels, the picture {channels}"
        raise DataError(message(where, "its colour profile", "be that of its colours", fact, _STEP))
    colours, alpha = pixels[..., :channels], pixels[..., channels:]
    if not whole:
        return np.concatenate((profile.to_linear(colours), alpha.astype(np.float32)), axis=-1)
    levels = np.iinfo(pixels.dtype).max
    codes = np.rint(_to_srgb(profile.to_linear(colours / np.float32(levels))) * 65535).astype(np.uint16)
    codes[colours == levels] = 65535
    return np.concatenate((codes, alpha.astype(np.uint16) * (65535 // levels)), axis=-1)
