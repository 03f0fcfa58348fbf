"""Specular maps and tilt curves to start from: a few shapes with names, each with its controls.

A specular map [3, S, S] gives a colour for each half vector, on the parabolic disc ``H.xy / (1 + H.z)``: its centre is
the mirror direction, its rim grazing, row 0 at the top, h_y up. Painting one is hard because nobody sees which half
vector a texel is for; these shapes say it in angles instead.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import RangeError, check_known_keys, check_option, check_positive, message
from torchmat.models.distribution import TILT_SAMPLES, default_tilt
from torchmat.models.parabolic import EVEN, SPACINGS, evenly, texel_places

WHITE = (1.0, 1.0, 1.0)
_QUARTER = math.pi / 2


def disc(size: int, spacing: str = EVEN) -> tuple[Tensor, Tensor]:
    """Return polar angle and azimuth [S, S] of the half vector of each texel; beyond the rim the angle grows on."""
    check_option("specular map", "spacing", spacing, SPACINGS)
    if not isinstance(size, int) or isinstance(size, bool) or size < 1:
        raise RangeError(message("specular map", "size", "be a whole number of texels", f"it is {size!r}"))
    x, y = evenly(texel_places(size), spacing)
    return 2 * torch.atan(torch.hypot(x, y)), torch.atan2(y, x)


def glossy(*, size: int = 48, strength: float = 1.0, width: float = 0.25, colour: Sequence[float] = WHITE, spacing: str = EVEN) -> Tensor:
    """Return a round dot: a Gaussian of the polar angle that falls to half at `width` radians."""
    polar, _ = disc(size, spacing)
    return _tinted(_bell(polar, width), strength, colour)


def soft(*, size: int = 48, strength: float = 1.0, width: float = 0.7, colour: Sequence[float] = WHITE, spacing: str = EVEN) -> Tensor:
    """Return a broad sheen: a power of the polar angle's cosine, half at `width` radians and nothing at the rim."""
    if not 0 < width < _QUARTER:
        raise RangeError(message("specular map", "width", "lie between 0 and pi/2 radians", f"it is {width}"))
    polar, _ = disc(size, spacing)
    return _tinted(torch.cos(polar).clamp(min=0) ** (math.log(0.5) / math.log(math.cos(width))), strength, colour)


def rim(*, size: int = 48, strength: float = 1.0, width: float = 0.35, colour: Sequence[float] = WHITE, spacing: str = EVEN) -> Tensor:
    """Return a bright rim, as of upright fibres: full at 90 degrees, half `width` radians before it."""
    polar, _ = disc(size, spacing)
    return _tinted(_bell(polar - _QUARTER, width), strength, colour)


def anisotropic(
    *, size: int = 48, strength: float = 1.0, width: float = 0.15, ratio: float = 4.0, colour: Sequence[float] = WHITE,
    spacing: str = EVEN,
) -> Tensor:
    """Return a dot drawn out along x: half at `width` radians along y, at `ratio` times as many along x.

    The rotation map turns it texel by texel, which is how brushed and woven surfaces are made.
    """
    check_positive("specular map", "ratio", ratio, "1 is round.")
    polar, azimuth = disc(size, spacing)
    along, across = polar * torch.cos(azimuth) / ratio, polar * torch.sin(azimuth)
    return _tinted(_bell(torch.hypot(along, across), width), strength, colour)


def noise(
    *, size: int = 48, strength: float = 1.0, width: float = 0.5, colour: Sequence[float] = WHITE, seed: int = 0,
    spacing: str = EVEN,
) -> Tensor:
    """Return glints: a glossy dot, each texel of which is scaled by a random number in [0, 1) that `seed` determines."""
    polar, _ = disc(size, spacing)
    random = torch.rand(size, size, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return _tinted(_bell(polar, width) * random, strength, colour)


def _bell(distance: Tensor, width: float) -> Tensor:
    if not 0 < width <= math.pi:
        raise RangeError(message("specular map", "width", "lie in (0, pi] radians", f"it is {width}"))
    return torch.exp2(-((distance / width) ** 2))


def _tinted(shape: Tensor, strength: float, colour: Sequence[float]) -> Tensor:
    """Return `shape` [S, S] as a colour map [3, S, S], float32."""
    if not 0 <= strength < math.inf:
        raise RangeError(message("specular map", "strength", "be finite and not negative", f"it is {strength}"))
    tint = torch.tensor(colour, dtype=torch.float64)
    if tint.shape != (3,) or not bool((tint >= 0).all()) or not bool(tint.isfinite().all()):
        requirement = "be three finite numbers, none negative"
        raise RangeError(message("specular map", "colour", requirement, f"it is {tuple(tint.tolist())}", "Linear RGB."))
    return (strength * tint[:, None, None] * shape).float()


SPECULAR_MAPS: dict[str, Callable[..., Tensor]] = {
    "glossy": glossy, "soft": soft, "rim": rim, "anisotropic": anisotropic, "noise": noise,
}


def specular_map(text: str, size: int | None = None, spacing: str = EVEN) -> Tensor:
    """Return the map of a name with controls, such as ``glossy`` or ``anisotropic:ratio=6,width=0.1,colour=1/0.8/0.5``.

    `size` is its side where the text gives none, `spacing` how the texels lie in the material that it is for. Raises RangeError for a name or control that does not exist, naming the
    nearest, or a value that is no number.
    """
    name, _, rest = text.partition(":")
    check_option("specular map", "the name", name, SPECULAR_MAPS)
    controls: dict[str, Any] = {"spacing": spacing} | ({} if size is None else {"size": size})
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        check_known_keys(f"specular map {name!r}", [key], inspect.signature(SPECULAR_MAPS[name]).parameters.keys() - {"spacing"})
        try:
            numbers = tuple(int(number) if number.isdigit() else float(number) for number in value.split("/"))
        except ValueError as error:
            step = "Write NAME:KEY=VALUE,... and a colour as R/G/B."
            raise RangeError(message(f"specular map {name!r}", key, "be a number", f"it is {value!r}", step)) from error
        controls[key] = numbers if key == "colour" else _single(name, key, numbers)
    return SPECULAR_MAPS[name](**controls)


def _single(name: str, key: str, numbers: tuple[float, ...]) -> float:
    if len(numbers) != 1:
        raise RangeError(message(f"specular map {name!r}", key, "be one number", f"there are {len(numbers)}"))
    return numbers[0]


_ANGLE = torch.deg2rad(torch.arange(TILT_SAMPLES, dtype=torch.float64))[None, None]
# Stored is 1 - d, and d takes the place of both cosines in D: where it is small, grazing light and views are brightened.
TILTS: dict[str, Tensor] = {
    "default": default_tilt(),
    "velvet": torch.sin(_ANGLE).float(),  # d falls at once: a sheen from moderate angles on
    "gentle": default_tilt() / 2,  # half the default's fall: D stays above 3/4
    "flat": torch.zeros(1, 1, TILT_SAMPLES),  # D is 1: nothing brightens toward grazing
}


def tilt_curve(text: str) -> Tensor:
    """Return the tilt curve [1, 1, 91] of a name, or through points such as ``0:0,30:0.1,90:1`` (degrees:tilt).

    Raises RangeError for another name, naming the nearest, or for what are no points.
    """
    if ":" not in text:
        check_option("tilt", "the name", text, TILTS)
        return TILTS[text].clone()
    try:
        points = [tuple(float(number) for number in part.split(":")) for part in text.split(",")]
    except ValueError as error:
        raise RangeError(message("tilt", "points", "be DEGREES:TILT,...", f"they are {text!r}")) from error
    return tilt_through(points)


def tilt_through(points: Sequence[Sequence[float]]) -> Tensor:
    """Return the tilt curve [1, 1, 91] through points (degrees 0 to 90, tilt 0 to 1), straight between them.

    Beyond the first and the last point it is even. Raises RangeError for points that are not so, or share an angle.
    """
    wrong = [point for point in points if len(point) != 2 or not (0 <= point[0] <= 90 and 0 <= point[1] <= 1)]
    ordered = sorted(tuple(point) for point in points if not wrong)
    twice = [one[0] for one, other in zip(ordered, ordered[1:], strict=False) if one[0] == other[0]]
    if wrong or twice or not ordered:
        fact = f"{wrong[0]} is not" if wrong else f"{twice[0]:g} degrees stand there twice" if twice else "there is none"
        requirement = "be one or more of degrees in [0, 90] and tilt in [0, 1], each angle once"
        raise RangeError(message("tilt", "points", requirement, fact))
    angles, values = zip(*ordered, strict=True)
    curve = np.interp(np.arange(TILT_SAMPLES), angles, values)
    return torch.from_numpy(curve).float()[None, None]
