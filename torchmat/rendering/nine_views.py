"""Nine views of a material over the hemisphere, as its specular maps are designed with (Liao 2011, fig. 3.9), and their marks.

Each view has azimuths of its own for light and view; the polar angles are chosen for all nine. Eight lie round a middle one,
with light and view on one side, so that their half vectors run outward; in the middle the two face each other.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchmat import frames
from torchmat.errors import RangeError, ShapeError, message
from torchmat.models import Material

# Of light and view, degrees, row by row from the upper left.
AZIMUTHS_DEG = ((135, 135), (90, 90), (45, 45), (180, 180), (0, 180), (0, 0), (225, 225), (270, 270), (315, 315))


def nine_pairs(light_deg: float = 30.0, view_deg: float = 30.0) -> tuple[Tensor, Tensor]:
    """Return light and view [9, 3], float64, for polar angles of 0 to 90 degrees; raises RangeError for others."""
    for name, polar in (("light_deg", light_deg), ("view_deg", view_deg)):
        if not 0 <= polar <= 90:
            raise RangeError(message("nine_pairs", name, "lie in [0, 90] degrees", f"it is {polar}"))
    azimuths = torch.deg2rad(torch.tensor(AZIMUTHS_DEG, dtype=torch.float64))
    found = []
    for polar, azimuth in zip((light_deg, view_deg), azimuths.T, strict=True):
        angle = math.radians(polar)
        sine, cosine = math.sin(angle), math.cos(angle)
        found.append(torch.stack((sine * azimuth.cos(), sine * azimuth.sin(), torch.full_like(azimuth, cosine)), dim=1))
    return found[0], found[1]


def marks(light: Tensor, view: Tensor) -> Tensor:
    """Return where in a parabolic map the half vectors of pairs [n, 3] lie: [n, 2], u to the right and v up, 0 to 1."""
    half = frames.half_vector(light, view, dim=-1)
    return 0.5 + half[:, :2] / (1 + half[:, 2:]) / 2


def half_at(place: Tensor) -> Tensor:
    """Return the half vectors [n, 3] of places [n, 2] in a parabolic map; raises RangeError for one outside its disc.

    A view whose light and eye both stand there shows it.
    """
    if place.ndim != 2 or place.shape[1] != 2:
        raise ShapeError(message("half_at", "place", "be [n, 2]", f"it is {tuple(place.shape)}"))
    disc = 2 * place - 1
    squared = disc.square().sum(dim=1, keepdim=True)
    if bool((squared > 1).any()):
        first = int((squared > 1)[:, 0].nonzero()[0, 0])
        raise RangeError(message("half_at", "place", "lie in the disc", f"number {first} is {tuple(place[first].tolist())}"))
    return torch.cat((2 * disc, 1 - squared), dim=1) / (1 + squared)


def nine_views(material: Material, light_deg: float = 30.0, view_deg: float = 30.0) -> Tensor:
    """Return the values of a material in nine views on one sheet, [3, 3 H, 3 W], linear: each `shade` at its pair."""
    light, view = (one.to(material.dtype)[:, :, None, None] for one in nine_pairs(light_deg, view_deg))
    with torch.no_grad():
        values = torch.stack([material.shade(one, other) for one, other in zip(light, view, strict=True)])
    height, width = material.size
    return values.reshape(3, 3, 3, height, width).permute(2, 0, 3, 1, 4).reshape(3, 3 * height, 3 * width)
