"""Directions that stand for all: what a form is measured on, and what a lobe is fitted to."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchmat import frames

_VIEWS = ((0.0, 1), (30.0, 3), (55.0, 4), (72.0, 3))  # polar angle in degrees, and how many stand around
_AROUND, _LOWEST_DEG = 11, 78.0  # lights of a view that are spread over the hemisphere
_BESIDE_DEG = (0.0, 2.0, 6.0, 14.0)  # and those beside the mirror's direction, where a lobe is
_HALF_DEG = (0.0, 1.5, 3.5, 6.0, 9.0, 13.0, 18.0, 25.0, 34.0, 45.0, 60.0)
_APART_DEG = (5.0, 30.0, 55.0, 72.0)  # between either direction and the half vector
_LOWEST = 0.08  # cosine: further down what a lobe says is its masking alone


def measured_pairs() -> tuple[Tensor, Tensor]:
    """Return light and view [n, 3], float64, of the pairs that a form's shading error is measured on: always the same."""
    views = [
        (math.radians(polar), 2 * math.pi * (number + 0.25 * row) / count)
        for row, (polar, count) in enumerate(_VIEWS) for number in range(count)
    ]
    lights, seen = [], []
    for number, (polar, azimuth) in enumerate(views):
        share = (torch.arange(_AROUND, dtype=torch.float64) + 0.5) / _AROUND
        least = math.cos(math.radians(_LOWEST_DEG))
        around = frames.from_polar(torch.acos(1 - share * (1 - least)), frames.GOLDEN_ANGLE * (torch.arange(_AROUND) + 0.37 * number).double())
        beside = torch.tensor(_BESIDE_DEG, dtype=torch.float64).deg2rad()
        turned = frames.from_polar(beside, frames.GOLDEN_ANGLE * (torch.arange(len(beside)) + number).double())
        mirror = frames.from_polar(torch.tensor(polar, dtype=torch.float64), torch.tensor(azimuth + math.pi, dtype=torch.float64))
        tangent, bitangent = frames.tangent_frame(mirror, dim=-1)
        lit = torch.cat((around, turned @ torch.stack((tangent, bitangent, mirror))))
        lit = lit[lit[:, 2] > _LOWEST]
        lights.append(lit)
        view = frames.from_polar(torch.tensor(polar, dtype=torch.float64), torch.tensor(azimuth, dtype=torch.float64))
        seen.append(view.expand(len(lit), 3))
    return torch.cat(lights), torch.cat(seen)


def lobe_pairs() -> tuple[Tensor, Tensor]:
    """Return light and view [n, 3], float64, that lie densely about a lobe: half vectors by polar angle, all around."""
    half_polar, apart = (torch.tensor(angles, dtype=torch.float64).deg2rad() for angles in (_HALF_DEG, _APART_DEG))
    around, turns = 8, 3
    grid = torch.meshgrid(half_polar, torch.arange(around).double(), apart, torch.arange(turns).double(), indexing="ij")
    polar, azimuth, difference, turn = (one.reshape(-1) for one in grid)
    azimuth = 2 * math.pi * (azimuth + 0.5 * (torch.arange(len(azimuth)) % 2)) / around
    half = frames.from_polar(polar, azimuth)
    tangent, bitangent = frames.tangent_frame(half, dim=-1)
    local = frames.from_polar(difference, math.pi * (turn + 0.25) / turns)
    light = local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * half
    view = 2 * (light * half).sum(dim=1, keepdim=True) * half - light
    above = (light[:, 2] > _LOWEST) & (view[:, 2] > _LOWEST)
    return light[above], view[above]
