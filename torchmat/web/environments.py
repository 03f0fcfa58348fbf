"""Environments of the viewer: small skies made by formula, each as a few distant lights (`torchmat.rendering.lights`).

`js/environments.js` holds what `source` returns; a test compares the two.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torchmat.rendering.lights import environment_lights

COUNT = 8  # lights of an environment: a shader sums up to 12
_ROWS, _COLUMNS = 64, 128


def _directions() -> tuple[Tensor, Tensor, Tensor]:
    """Return x, y, z [H, W] of a map's pixels: its top is +y, its middle column -z."""
    polar = ((torch.arange(_ROWS, dtype=torch.float64) + 0.5) / _ROWS * math.pi)[:, None]
    turn = math.pi - ((torch.arange(_COLUMNS, dtype=torch.float64) + 0.5) / _COLUMNS * 2 - 1) * math.pi
    return torch.sin(polar) * torch.sin(turn), torch.cos(polar).expand(_ROWS, _COLUMNS), torch.sin(polar) * torch.cos(turn)


def _spot(toward: tuple[float, float, float], sharpness: float) -> Tensor:
    length = math.sqrt(sum(one * one for one in toward))
    cosine = (torch.stack(_directions()) * torch.tensor(toward, dtype=torch.float64)[:, None, None]).sum(dim=0) / length
    return torch.exp(sharpness * (cosine - 1))


def _planes(value: Tensor, colour: tuple[float, float, float]) -> Tensor:
    return value[None] * torch.tensor(colour, dtype=torch.float64)[:, None, None]


def _sky() -> Tensor:
    """Return noon: a sun at the upper left before a blue sky, over pale ground."""
    _, up, _ = _directions()
    above = (up > 0).double()
    return _planes(above * (0.6 + 0.4 * up), (0.25, 0.32, 0.45)) + _planes(1 - above, (0.12, 0.11, 0.1)) \
        + _planes(_spot((-0.5, 0.7, 0.6), 200.0), (75.0, 70.0, 62.0))


def _studio() -> Tensor:
    """Return a dark room with a large soft light at the left, a smaller one at the right, and a strip above and behind."""
    return _planes(_spot((-0.8, 0.4, 0.6), 12.0), (5.0, 5.0, 5.0)) + _planes(_spot((0.9, 0.1, 0.5), 20.0), (2.6, 2.7, 2.9)) \
        + _planes(_spot((0.1, 0.8, -0.6), 30.0), (4.0, 3.9, 3.7)) + 0.02


def _evening() -> Tensor:
    """Return a low warm sun at the right, under a sky that darkens to blue."""
    _, up, _ = _directions()
    above = (up > 0).double()
    return _planes(above * (1 - 0.7 * up), (0.2, 0.17, 0.24)) + _planes(1 - above, (0.05, 0.04, 0.04)) \
        + _planes(_spot((0.85, 0.22, 0.5), 120.0), (52.0, 30.0, 14.0))


SKIES: dict[str, tuple[str, Callable[[], Tensor]]] = {"sky": ("Noon", _sky), "studio": ("Studio", _studio), "evening": ("Evening", _evening)}


def source() -> str:
    """Return the JavaScript module of the presets: directions toward the lights and their linear RGB."""
    lines = ["// Made by torchmat/web/environments.py: distant lights that stand for small skies.", "", "export const ENVIRONMENTS = {"]
    for name, (title, sky) in SKIES.items():
        lines += [f"  {name}: {{", f'    title: "{title}",', "    lights: ["]
        for light in environment_lights(sky(), COUNT):
            direction, shine = (", ".join(f"{float(one):.5f}" for one in part) for part in (light.direction, light.intensity))
            lines.append(f"      [[{direction}], [{shine}]],")
        lines += ["    ],", "  },"]
    return "\n".join([*lines, "};", ""])
