"""Lights of a scene: distant ones, points with fall-off, and an environment as a number of distant ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat import colour, safe
from torchmat.errors import RangeError, ShapeError, check_finite, message

WHITE = (1.0, 1.0, 1.0)
ORIGIN = (0.0, 0.0, 0.0)
DEFAULT_LIGHT = (-0.4, 0.5, 0.768)
_Numbers = Sequence[float] | Tensor


def _three(where: str, name: str, given: _Numbers, dtype: torch.dtype) -> Tensor:
    found = torch.as_tensor(given, dtype=dtype)
    if found.shape != (3,):
        raise ShapeError(message(where, name, "be x, y, z", f"its shape is {tuple(found.shape)}"))
    return found


def vector(where: str, name: str, given: _Numbers, dtype: torch.dtype = torch.float64) -> Tensor:
    """Return three finite numbers as a tensor [3]; raises ShapeError or RangeError, naming the argument."""
    found = _three(where, name, given, dtype)
    if not bool(torch.isfinite(found).all()):
        raise RangeError(message(where, name, "be finite", f"it is {found.tolist()}"))
    return found


def unit(where: str, name: str, given: _Numbers, dtype: torch.dtype = torch.float64) -> Tensor:
    """Return a direction [3] of length 1; raises RangeError for one without length."""
    found = _three(where, name, given, dtype)
    if not bool(torch.isfinite(found).all()) or not bool(found.any()):
        raise RangeError(message(where, name, "be a finite direction", f"it is {found.tolist()}"))
    return safe.normalise(found, dim=0)


def _intensity(where: str, given: _Numbers) -> Tensor:
    found = vector(where, "intensity", given)
    if bool((found < 0).any()):
        raise RangeError(message(where, "intensity", "not be negative", f"it is {found.tolist()}"))
    return found


@dataclass(frozen=True)
class Directional:
    """A light so far away that its rays are parallel.

    Args:
        direction: x, y, z toward the light, in the scene's frame; its length does not matter.
        intensity: linear RGB, not negative; a white diffuse surface that faces a light of 1 reads 1.
    """

    direction: _Numbers
    intensity: _Numbers = WHITE

    def __post_init__(self) -> None:
        unit("Directional", "light", self.direction)
        _intensity("Directional", self.intensity)

    def reach(self, position: Tensor, origin: _Numbers = ORIGIN) -> tuple[Tensor, Tensor, None]:
        """Return direction [3, 1, 1], intensity [3, 1, 1] and distance (none) as seen from positions [3, 1, P]."""
        dtype = position.dtype
        direction = unit("Directional", "light", self.direction).to(dtype)
        return direction[:, None, None], _intensity("Directional", self.intensity).to(dtype)[:, None, None], None


@dataclass(frozen=True)
class Point:
    """A light at a place of the scene that shines alike into all directions.

    Args:
        position: x, y, z in the scene's frame and unit of length.
        intensity: linear RGB, not negative: what it gives at distance 1; it falls off with the distance squared.
    """

    position: _Numbers
    intensity: _Numbers = WHITE

    def __post_init__(self) -> None:
        vector("Point", "position", self.position)
        _intensity("Point", self.intensity)

    def reach(self, position: Tensor, origin: _Numbers = ORIGIN) -> tuple[Tensor, Tensor, Tensor]:
        """Return direction [3, 1, P], intensity [3, 1, P] and distance [1, P] as seen from positions [3, 1, P].

        Positions count from `origin` of the scene: far away from 0 they would have few digits left.
        """
        dtype = position.dtype
        here = vector("Point", "position", self.position) - vector("Point", "origin", origin)
        way = here.to(dtype)[:, None, None] - position
        squared = (way * way).sum(dim=0)
        intensity = _intensity("Point", self.intensity).to(dtype)[:, None, None]
        # A surface in the very place of the light has no direction to it, and is left dark.
        return safe.normalise(way), safe.divide(intensity, squared), safe.sqrt(squared)


Light = Directional | Point


def as_light(given: Light | _Numbers) -> Light:
    """Return a light; x, y, z stand for a distant one of intensity 1."""
    if isinstance(given, Light):
        return given
    unit("render", "light", given)
    return Directional(given)


def environment_lights(picture: Tensor, count: int = 64, turn: float = 0.0) -> list[Directional]:
    """Return distant lights that stand for an environment map.

    The map is cut `count` - 1 times, each time the region of most light into halves of equal light across its longer side
    (median cut, Debevec 2005); each region becomes a light at its centre of light. The sum of light is kept.

    Args:
        picture: latitude-longitude map [3, H, W], linear, not negative. Its top row is up (+y), its middle column lies in
            direction -z, behind the object as the default camera sees it; columns to the right of it turn toward +x.
        count: number of lights, at least 1.
        turn: radians by which the map turns about y, positive from +z toward +x.

    Raises RangeError for a map that is negative, not finite or black, or for a count below 1, ShapeError for no map.
    """
    where = "environment_lights"
    if picture.ndim != 3 or picture.shape[0] != 3 or 0 in picture.shape:
        raise ShapeError(message(where, "the environment", "be [3, H, W]", f"it is {tuple(picture.shape)}"))
    check_finite(where, "the environment", picture)
    if count < 1 or not math.isfinite(turn):
        raise RangeError(message(where, "count and turn", "be at least 1 and finite", f"they are {count} and {turn}"))
    if bool((picture < 0).any()) or not bool((picture > 0).any()):
        fact = f"it lies in [{float(picture.min()):.6g}, {float(picture.max()):.6g}]"
        raise RangeError(message(where, "the environment", "hold light, none of it negative", fact))
    rows, columns = picture.shape[-2:]
    edges = torch.arange(rows + 1, dtype=torch.float64) / rows * math.pi
    solid_angle = (torch.cos(edges[:-1]) - torch.cos(edges[1:])) * (2 * math.pi / columns)
    power = picture.double() * solid_angle[:, None]
    direction = _latitude_longitude(rows, columns, turn)
    grey = colour.luminance(power)
    lights = []
    for top, bottom, left, right in _median_cut(grey, solid_angle, count):
        part = power[:, top:bottom, left:right]
        total = part.sum(dim=(1, 2))
        if not bool(total.any()):
            continue
        weight = grey[top:bottom, left:right] if bool(grey[top:bottom, left:right].any()) else part.sum(dim=0)
        centre = (direction[:, top:bottom, left:right] * weight).sum(dim=(1, 2))
        if not bool(centre.norm() > 1e-9 * weight.sum()):  # light from all sides alike has no centre
            centre = direction[:, (top + bottom) // 2, (left + right) // 2]
        # A value is pi times reflectance times cosine, so light that fills a solid angle counts over pi.
        lights.append(Directional(tuple(safe.normalise(centre, dim=0).tolist()), tuple((total / math.pi).tolist())))
    return lights


def _latitude_longitude(rows: int, columns: int, turn: float) -> Tensor:
    """Return the directions [3, H, W] of an environment's pixels."""
    polar = ((torch.arange(rows, dtype=torch.float64) + 0.5) / rows * math.pi)[:, None]
    # pi is -z, the middle; from there to the right toward +x.
    azimuth = math.pi - ((torch.arange(columns, dtype=torch.float64) + 0.5) / columns * 2 - 1) * math.pi + turn
    sine = torch.sin(polar)
    return torch.stack((sine * torch.sin(azimuth), torch.cos(polar).expand(rows, columns), sine * torch.cos(azimuth)))


def _median_cut(grey: Tensor, solid_angle: Tensor, count: int) -> list[tuple[int, int, int, int]]:
    """Return up to `count` regions (top, bottom, left, right) of about equal light."""
    regions = [(0, grey.shape[0], 0, grey.shape[1])]
    light = [float(grey.sum())]
    while len(regions) < count:
        order = sorted(range(len(regions)), key=lambda k: -light[k])
        chosen = next((k for k in order if _area(regions[k]) > 1 and light[k] > 0), None)
        if chosen is None:  # every pixel that shines is a light of its own
            break
        halves = _halves(grey, solid_angle, regions.pop(chosen))
        light.pop(chosen)
        regions += halves
        light += [float(grey[a:b, c:d].sum()) for a, b, c, d in halves]
    return regions


def _area(region: tuple[int, int, int, int]) -> int:
    top, bottom, left, right = region
    return (bottom - top) * (right - left)


def _halves(grey: Tensor, solid_angle: Tensor, region: tuple[int, int, int, int]) -> list[tuple[int, int, int, int]]:
    top, bottom, left, right = region
    # A region's width shrinks toward the poles as its rows' solid angle does.
    shrink = float(solid_angle[top:bottom].mean() / solid_angle.max())
    across = (right - left) * shrink > bottom - top
    if (across and right - left > 1) or bottom - top == 1:
        cut = left + _middle(grey[top:bottom, left:right].sum(dim=0))
        return [(top, bottom, left, cut), (top, bottom, cut, right)]
    cut = top + _middle(grey[top:bottom, left:right].sum(dim=1))
    return [(top, cut, left, right), (cut, bottom, left, right)]


def _middle(light: Tensor) -> int:
    """Return where to cut a line of two or more cells so that both sides hold about the same light."""
    total = light.cumsum(dim=0)
    nearest = int((total[:-1] - total[-1] / 2).abs().argmin())
    return nearest + 1
