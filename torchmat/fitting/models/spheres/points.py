"""Points on pictures of a lit sphere at which sphere images are fitted to a BRDF and measured against it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchmat import colour
from torchmat.errors import RangeError, message
from torchmat.models.sphere_geometry import directions_on
from torchmat.repeatable import one_thread

_EDGE = 0.999  # of the radius; the rest is a thousandth of the picture, seen at more than 87 degrees
_CORE, _REACH = 0.005, 0.5  # radii about the highlight, in radii of the disc, between which points grow sparse
_WINDOW_DEG, _STEP_DEG = 12.0, 0.1


class SpherePoints(NamedTuple):
    """Points of pictures, one picture after another: directions [3, 1, P] and the true values [3, P].

    `weight` [P] is each point's share of its picture's area, divided by the picture's energy, so that the weighted sum
    of squared errors is the sum of the pictures' relative errors. `counts` are the points of each picture.
    """

    light: Tensor
    view: Tensor
    value: Tensor
    weight: Tensor
    counts: tuple[int, ...]

    def per_picture(self, error: Tensor) -> Tensor:
        """Return the relative error of each picture for errors [3, P]."""
        with one_thread():
            return torch.stack([part.sum() for part in (self.weight * error.square()).sum(dim=0).split(self.counts)])


def sphere_points(brdf: Any, lights_deg: Sequence[float], count: int, seed: int = 0) -> SpherePoints:
    """Return about `count` points on each of the pictures of a sphere lit at `lights_deg` from the view.

    Two thirds are spread over the disc, one third gathers about the highlight, which on a near-mirror is a hundredth of
    the disc wide; weights make up for it. Deterministic for a `seed`.
    """
    generator = torch.Generator().manual_seed(seed)
    pictures = []
    with torch.no_grad():
        for angle in map(math.radians, lights_deg):
            place, area = _points_on_disc(count, angle, generator)
            light, view = directions_on(_raised(place.to(brdf.dtype))[:, None], angle)
            pictures.append((light, view, brdf.shade(light, view)[:, 0], area.to(brdf.dtype)))
    lights, views, values, weights = zip(*pictures, strict=True)
    with one_thread():
        energy = torch.stack([(w * v.square()).sum() for w, v in zip(weights, values, strict=True)])
    # A picture lit from behind is black: its error counts as that of the other pictures does.
    energy = energy.clamp(min=float(energy.mean()) * 1e-4 or 1.0)
    scaled = [w / e for w, e in zip(weights, energy, strict=True)]
    counts = tuple(len(w) for w in weights)
    return SpherePoints(torch.cat(lights, 2), torch.cat(views, 2), torch.cat(values, 1), torch.cat(scaled), counts)


def _raised(place: Tensor) -> Tensor:
    """Return the normals [3, P] of disc points [2, P]."""
    return torch.cat((place, torch.sqrt(1 - place.square().sum(dim=0, keepdim=True))))


def _points_on_disc(count: int, angle: float, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return points [2, P] of the unit disc and the area that each stands for, in float64."""
    side = max(2, round(math.sqrt(count * 2 / 3 * 4 / math.pi)))
    jitter = torch.rand(2, side, side, generator=generator, dtype=torch.float64)
    steps = torch.arange(side, dtype=torch.float64)
    spread = torch.stack((steps + jitter[0], steps[:, None] + jitter[1])).flatten(1) / side * 2 - 1
    centre = torch.tensor([[math.sin(angle / 2)], [0.0]], dtype=torch.float64)
    gathered = centre + _gathered(count - count * 2 // 3, generator)
    place = torch.cat((spread, gathered), dim=1)
    place = place[:, place.norm(dim=0) < _EDGE]
    # Two ways to draw one point: its density is the sum of both (the balance heuristic of Veach & Guibas 1995).
    distance = (place - centre).norm(dim=0)
    near = (count - count * 2 // 3) / (math.pi * math.log1p((_REACH / _CORE) ** 2) * (distance**2 + _CORE**2))
    density = side**2 / 4 + torch.where(distance < _REACH, near, torch.zeros_like(near))
    return place, 1 / density


def _gathered(count: int, generator: torch.Generator) -> Tensor:
    """Return offsets [2, count] whose density falls with the square of the distance, beyond a core."""
    jitter = torch.rand(2, count, generator=generator, dtype=torch.float64)
    share = (torch.arange(count, dtype=torch.float64) + jitter[0]) / max(count, 1)
    radius = _CORE * torch.sqrt(torch.expm1(share * math.log1p((_REACH / _CORE) ** 2)))
    azimuth = 2 * math.pi * jitter[1]
    return torch.stack((radius * torch.cos(azimuth), radius * torch.sin(azimuth)))


def sphere_errors(
    material: Any, brdf: Any, lights_deg: Sequence[float], count: int = 20_000, seed: int = 1
) -> list[float]:
    """Return sum (p - t)^2 / sum t^2 over the picture of a sphere of `material` (or Brdf) at each of `lights_deg`.

    `count` points stand for a picture; those of a `seed` are the same for every material.
    """
    points = sphere_points(brdf, lights_deg, count, seed)
    with torch.no_grad():
        found = material.shade_at(points.light.new_zeros(2, 1, points.light.shape[2]), points.light, points.view)[:, 0]
    return points.per_picture(found - points.value).tolist()


def unseen_lights(angles_deg: Sequence[float], count: int, last_deg: float | None = None) -> list[float]:
    """Return up to `count` light angles evenly between 0 and the last of `angles_deg`; those next to a picture's are left out."""
    last = max(angles_deg) if last_deg is None else last_deg
    lights = [(number + 0.5) * last / count for number in range(count)]
    return [light for light in lights if min(abs(light - angle) for angle in angles_deg) > 0.05 * last / count]


def highlight_error(material: Any, brdf: Any, light_deg: float) -> float:
    """Return by how many degrees the highlight of `material` (or Brdf) lies beside that of `brdf`.

    Both are compared over normals within 12 degrees of the half vector: the shift at which they correlate best, in
    steps of 0.1 degrees. So a flat-topped highlight has a place, and a doubled one is off by either half.
    """
    if not 0 <= light_deg <= 150:
        fact = f"it is {light_deg}"
        raise RangeError(message("highlight_error", "light_deg", "lie in [0, 150]", fact, "Beyond, the window is cut."))
    steps = torch.deg2rad(torch.arange(-_WINDOW_DEG, _WINDOW_DEG + _STEP_DEG / 2, _STEP_DEG, dtype=brdf.dtype))
    up, along = torch.meshgrid(steps, steps, indexing="ij")
    angle = math.radians(light_deg)
    toward = angle / 2 + along
    normal = torch.stack((torch.sin(toward) * torch.cos(up), torch.sin(up), torch.cos(toward) * torch.cos(up)))
    light, view = directions_on(normal.reshape(3, 1, -1), angle)
    uv = light.new_zeros(2, 1, light.shape[2])
    with torch.no_grad():
        shaded = [one.shade_at(uv, light, view)[:, 0] for one in (brdf, material)]
    pictures = [colour.luminance(values, dim=0).reshape(up.shape) for values in shaded]
    true, found = (torch.fft.rfft2(p - p.min(), s=(2 * len(steps), 2 * len(steps))) for p in pictures)
    match = torch.fft.irfft2(found * true.conj())
    shift = divmod(int(match.argmax()), match.shape[1])
    return _STEP_DEG * math.hypot(*(min(s, 2 * len(steps) - s) for s in shift))
