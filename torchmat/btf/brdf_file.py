"""BRDF files as a BTF of 1 x 1 texels: the measured table, looked up under lights and views that lie where it matters."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from torchmat import frames
from torchmat.brdf import is_brdf_file, is_isotropic_file, load_brdf
from torchmat.btf.listing import Listing
from torchmat.btf.reader import Pixels, Reader
from torchmat.btf.source import File

VIEWS_DEG = (0, 15, 30, 45, 60, 75)
HALF_ANGLES, HALF_AZIMUTHS = 24, 8
_VIEW_AZIMUTHS = {True: 4, False: 12}  # of an isotropic surface, and of another
_LOWEST = math.cos(math.radians(85))  # of a light: beyond it neither database was measured


def hemispheres(isotropic: bool) -> tuple[Tensor, Tensor]:
    """Return lights and views [n, 3], float64: where a measured BRDF is asked.

    Views lie 0 to 75 degrees from the normal, 15 apart, at 4 azimuths, of an anisotropic surface at 12. Lights mirror
    each at half vectors of 24 polar angles, which grow with the square to 90 degrees and so lie densest about the
    mirror direction (0.04, 0.35, 1.0, 1.9 ... degrees), and 8 azimuths, as far as they are at least 5 degrees high.
    """
    lights, views = [], []
    share = (torch.arange(HALF_ANGLES, dtype=torch.float64) + 0.5) / HALF_ANGLES
    polar = (share**2 * (math.pi / 2)).repeat_interleave(HALF_AZIMUTHS)
    azimuth = (torch.arange(HALF_AZIMUTHS, dtype=torch.float64) * (2 * math.pi / HALF_AZIMUTHS)).repeat(HALF_ANGLES)
    for number, (view_polar, view_azimuth) in enumerate(_views(_VIEW_AZIMUTHS[isotropic])):
        view = frames.from_polar(view_polar, view_azimuth)
        half = frames.from_polar(polar, azimuth + number * frames.GOLDEN_ANGLE)
        cosine = half @ view
        light = 2 * cosine[:, None] * half - view
        light = light[(cosine > 0) & (light[:, 2] >= _LOWEST)]
        lights.append(light / light.norm(dim=1, keepdim=True))
        views.append(view.expand(len(light), 3))
    return torch.cat(lights), torch.cat(views)


def _views(azimuths: int) -> list[tuple[Tensor, Tensor]]:
    found = [(0.0, 0.0)]
    for ring, polar_deg in enumerate(VIEWS_DEG[1:]):
        # Each ring is turned by a share of its gaps, so that azimuths differ from ring to ring.
        turn = ring / len(VIEWS_DEG[1:])
        found += [(math.radians(polar_deg), 2 * math.pi * (number + turn) / azimuths) for number in range(azimuths)]
    return [(torch.tensor(polar, dtype=torch.float64), torch.tensor(turned, dtype=torch.float64)) for polar, turned in found]


def _sniff(source: File) -> bool:
    return is_brdf_file(source.path)


def _listing(source: File) -> Listing:
    light, view = hemispheres(is_isotropic_file(source.path))
    angles = [torch.rad2deg(torch.stack(frames.to_polar(directions), dim=1)).tolist() for directions in (light, view)]
    names = [f"light {l_polar:.2f} {l_azimuth:.2f} view {v_polar:.0f} {v_azimuth:.2f}"
             for (l_polar, l_azimuth), (v_polar, v_azimuth) in zip(*angles, strict=True)]
    return Listing("brdf", tuple(names), light, view)


def _pixels(source: File, listing: Listing) -> Pixels:
    brdf = load_brdf(source.path)
    light, view = (directions.to(brdf.dtype).T[:, None] for directions in (listing.light, listing.view))
    with torch.no_grad():
        value = brdf.shade(light, view)  # [3, 1, n]
    return Pixels.of(np.ascontiguousarray(value.permute(2, 1, 0)[:, None].numpy()))


BRDF = Reader(
    "brdf", "a measured BRDF, MERL `.binary` or RGL `.bsdf`, over a grid that is dense about the mirror direction", _sniff,
    _listing, _pixels, one_file=True,
)
