"""A leather swatch of which everything is known, and the photographs that somebody takes of it in twenty minutes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from tests.capturing.shots import Lamp, Shot

_GLOSS, _EXPONENT = 0.06, 40.0


@dataclass(frozen=True)
class Swatch:
    """Pebbled leather: unit `normal` and `albedo` [3, h, w], row 0 at the top; a gloss of one exponent over it."""

    normal: torch.Tensor
    albedo: torch.Tensor

    def __call__(self, light: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
        """Return pi f_r cos(light) [3, h, w] of unit directions [3, h, w]: matte, and Blinn's lobe, normalised by (e + 8) / 8."""
        half = torch.nn.functional.normalize(light + view, dim=0)
        lobe = (self.normal * half).sum(0, keepdim=True).clamp(min=0) ** _EXPONENT
        return (self.albedo + _GLOSS * (_EXPONENT + 8) / 8 * lobe) * (self.normal * light).sum(0, keepdim=True).clamp(min=0)


def leather(texels: int = 512, grain: int = 40, seed: int = 5) -> Swatch:
    """Return a swatch of `texels` along a side, with about `grain` pebbles along it."""
    random = np.random.default_rng(seed)
    seeds = (np.indices((grain, grain)).reshape(2, -1).T + random.uniform(0.1, 0.9, (grain**2, 2))) / grain
    place = (np.indices((texels, texels)).reshape(2, -1).T + 0.5) / texels
    distance, owner = cKDTree(seeds).query(place, k=2)
    crease = (distance[:, 1] - distance[:, 0]).reshape(texels, texels) * grain
    height = gaussian_filter(np.minimum(crease, 0.5), texels / grain / 8) * 0.35 / grain  # in widths of the swatch
    down, across = np.gradient(height, 1 / texels)
    normal = torch.from_numpy(np.stack((-across, down, np.ones_like(height)))).float()
    tint = random.uniform(0.85, 1.15, grain**2)[owner[:, 0]].reshape(texels, texels)
    shade = gaussian_filter(tint * np.clip(0.55 + crease, 0.55, 1), texels / grain / 12)
    albedo = torch.from_numpy(shade[None] * np.array([0.34, 0.17, 0.08])[:, None, None]).float()
    return Swatch(torch.nn.functional.normalize(normal, dim=0), albedo)


def shots_by_hand(count: int = 30, seed: int = 11) -> list[Shot]:
    """Return shots from 20 to 60 degrees, no two from one distance, each with the lamp put elsewhere, half a metre away."""
    random = np.random.default_rng(seed)
    found = []
    for number in range(count):
        polar, azimuth = np.radians(20 + 40 * (number + 0.5) / count), np.radians(137.5 * number)
        place = random.uniform(400, 470) * np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
        tilt, turn = np.radians(8 + 47 * ((number * 7) % count + 0.5) / count), np.radians(222.5 * number)
        lamp = random.uniform(450, 600) * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        colour = random.uniform(0.93, 1.07) * np.array([1.0, 0.93, 0.82])
        aim, roll = (*random.uniform(-10, 10, 2), 0.0), float(random.choice([90, 270]) + random.uniform(-8, 8))
        found.append(Shot(tuple(place), Lamp(tuple(lamp), tuple(colour)), random.uniform(0.55, 0.8), aim, roll))
    return found
