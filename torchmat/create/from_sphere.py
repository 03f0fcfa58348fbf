"""Photographs of a real sphere to sphere images (Mihálik & Ďurikovič)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.errors import RangeError, ShapeError, check_finite, check_positive, message
from torchmat.models.sphere_geometry import sphere_normals
from torchmat.models.sphere_images import SphereImages, checked_angles, paper_turn

_WHERE = "sphere_images_from_photographs"
_INSIDE = 0.98  # of the radius: at the outline itself a pixel shows the background too


def sphere_images_from_photographs(
    photographs: Tensor, angles_deg: Sequence[float], centre: Sequence[float], radius: float, *,
    azimuths_deg: Sequence[float] | None = None, exposure: float = 1.0, size: int = 512, storage: str = "half",
) -> SphereImages:
    """Return the material of a sphere photographed from one place under lights at several angles from the view.

    `photographs` [n, 3, H, W] linear and >= 0, taken from so far away that the sphere's outline is a circle: `centre`
    (x to the right, y down, in pixels; the first pixel's centre is 0.5, 0.5) and `radius` in pixels. `angles_deg` are
    the angles between light and view, ascending from 0; `azimuths_deg` (default 0) from which side the lights came:
    0 from the right, 90 from above. Each photograph is turned back by its azimuth, so that the light comes from the
    right, and resampled to `size` texels, averaged where it holds more pixels than that. `exposure` divides them: what
    a white diffuse patch facing the view read under the light at 0. The outermost 2 % of the radius, where pixels show
    the background too, are filled from what lies inside. Raises ShapeError or RangeError, naming what does not fit.
    """
    angles, azimuths = _checked(photographs, angles_deg, centre, radius, azimuths_deg, exposure, size)
    normal = sphere_normals(size, torch.float64)
    place = normal[:2] * (_INSIDE / normal[:2].norm(dim=0).clamp(min=_INSIDE))
    found = [
        _resampled(picture.double(), place, centre, radius, math.radians(azimuth))
        for picture, azimuth in zip(photographs, azimuths, strict=True)
    ]
    images = (torch.cat(found) / exposure).float().contiguous()
    maps = {"images": images, "turn": paper_turn(), "tint": torch.ones(3, 1, 1)}
    return SphereImages(maps, angles_deg=angles, storage=storage)


def _resampled(picture: Tensor, place: Tensor, centre: Sequence[float], radius: float, azimuth: float) -> Tensor:
    """Return a photograph [3, H, W] at points [2, S, S] of the unit disc, turned about the view by `azimuth`."""
    size = place.shape[-1]
    finer = max(1, round(2 * radius / size))  # points per texel and axis, so that no pixel is passed over
    total = torch.zeros(3, size, size, dtype=picture.dtype)
    cosine, sine = math.cos(azimuth), math.sin(azimuth)
    for number in range(finer * finer):
        shift = [((number // step % finer) + 0.5) / finer - 0.5 for step in (1, finer)]
        x, y = place[0] + shift[0] * 2 / size, place[1] - shift[1] * 2 / size
        shrink = (_INSIDE / torch.sqrt(x * x + y * y).clamp(min=_INSIDE)) * radius
        # The point that the light from `azimuth` shows as the light from the right shows (x, y); rows run downward.
        across, up = (cosine * x - sine * y) * shrink, (sine * x + cosine * y) * shrink
        column, row = centre[0] + across, centre[1] - up
        grid = torch.stack((column / picture.shape[2] * 2 - 1, row / picture.shape[1] * 2 - 1), dim=-1)
        total += functional.grid_sample(
            picture[None], grid[None], mode="bilinear", padding_mode="border", align_corners=False
        )[0]
    return total / finer**2


def _checked(
    photographs: Tensor, angles_deg: Sequence[float], centre: Sequence[float], radius: float,
    azimuths_deg: Sequence[float] | None, exposure: float, size: int,
) -> tuple[list[float], list[float]]:
    """Return angles and azimuths in degrees; raise what `sphere_images_from_photographs` says."""
    if photographs.ndim != 4 or photographs.shape[1] != 3 or 0 in photographs.shape:
        fact = f"they are {tuple(photographs.shape)}"
        raise ShapeError(message(_WHERE, "photographs", "be [n, 3, H, W]", fact))
    check_finite(_WHERE, "photographs", photographs)
    if bool((photographs < 0).any()):
        fact = f"{int((photographs < 0).sum())} values are negative"
        raise RangeError(message(_WHERE, "photographs", "be linear light, 0 or more", fact))
    angles = list(angles_deg)
    checked_angles(_WHERE, angles)
    azimuths = [0.0] * len(angles) if azimuths_deg is None else [float(azimuth) for azimuth in azimuths_deg]
    for name, values in (("angles_deg", angles), ("azimuths_deg", azimuths)):
        if len(values) != len(photographs) or not all(math.isfinite(value) for value in values):
            requirement = f"be {len(photographs)} finite numbers, one for each photograph"
            raise RangeError(message(_WHERE, name, requirement, f"they are {values}"))
    for name, value in (("exposure", exposure), ("radius", radius), ("size", size)):
        check_positive(_WHERE, name, value)
    rows, columns = photographs.shape[-2:]
    x, y = centre
    if not (radius <= x <= columns - radius and radius <= y <= rows - radius):
        fact = f"centre {x:g}, {y:g} and radius {radius:g} reach outside {columns} x {rows} pixels"
        step = "Crop less, or correct them."
        raise RangeError(message(_WHERE, "the sphere", "lie inside the photographs", fact, step))
    return angles, azimuths
