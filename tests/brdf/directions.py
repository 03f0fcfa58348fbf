"""Random directions, and the pairs of them at which formulas break."""

from __future__ import annotations

import math

import numpy as np
import torch


def random_directions(count: int, seed: int, lowest: float = 0.02) -> np.ndarray:
    """Return unit directions [n, 3] spread evenly over the hemisphere above height `lowest`."""
    random = np.random.default_rng(seed)
    z, azimuth = random.uniform(lowest, 1, count), random.uniform(0, 2 * np.pi, count)
    flat = np.sqrt(1 - z * z)
    return np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), z), axis=1)


def near_mirror(light: np.ndarray, seed: int, spread: float = 0.05) -> np.ndarray:
    """Return views [n, 3] near the mirror directions of `light`, where highlights lie."""
    random = np.random.default_rng(seed)
    view = light * (-1, -1, 1) + random.normal(0, spread, light.shape)
    view[:, 2] = np.abs(view[:, 2])
    return view / np.linalg.norm(view, axis=1, keepdims=True)


def planes(rows: np.ndarray, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """Return directions [n, 3] as one per image, [n, 3, 1, 1]."""
    return torch.as_tensor(rows, dtype=dtype)[:, :, None, None]


def graze(azimuth: float, height: float) -> tuple[float, float, float]:
    """Return the direction at an azimuth and a height above the horizon."""
    flat = math.sqrt(1 - height * height)
    return flat * math.cos(azimuth), flat * math.sin(azimuth), height


POLE = (0.0, 0.0, 1.0)
HARD_PAIRS = {
    "light_and_view_are_the_normal": (POLE, POLE),
    "light_is_view": (graze(0.3, 0.6), graze(0.3, 0.6)),
    "mirror_pair": (graze(0.3, 0.6), graze(0.3 + math.pi, 0.6)),
    "light_at_normal_view_at_horizon": (POLE, graze(1.0, 1e-4)),
    "both_at_horizon_same_side": (graze(0.2, 1e-4), graze(0.2, 1e-4)),
    "both_at_horizon_across": (graze(0.2, 1e-4), graze(0.2 + math.pi / 2, 1e-4)),
    "both_at_horizon_opposite": (graze(0.2, 1e-4), graze(0.2 + math.pi, 1e-4)),
    "both_a_rounding_error_above_the_horizon": ((1.0, 0.0, 6.1e-17), (-1.0, 0.0, 6.1e-17)),
    "a_rounding_error_above_on_the_same_side": ((1.0, 0.0, 6.1e-17), (1.0, 0.0, 6.1e-17)),
    "a_rounding_error_above_side_by_side": ((1.0, 0.0, 6.1e-17), (0.0, 1.0, 6.1e-17)),
    "light_lower_than_view_at_horizon": (graze(0.0, 1e-7), graze(math.pi, 1e-4)),
    "nearly_the_pole": ((1e-20, -1e-20, 1.0), (3e-25, 0.0, 1.0)),
    "negative_zeros": ((-0.0, -0.0, 1.0), (-0.0, 0.0, 1.0)),
}


def shade_and_differentiate(brdf, light, view, dtype: torch.dtype, *leaves: torch.Tensor) -> torch.Tensor:
    """Return the value at one pair; assert that it and all gradients, those of `leaves` too, are finite."""
    directions = [torch.tensor(d, dtype=dtype)[:, None, None].requires_grad_() for d in (light, view)]
    value = brdf.shade(*directions)
    assert bool(torch.isfinite(value).all()) and bool((value >= 0).all())
    value.sum().backward()
    for label, leaf in (("light", directions[0]), ("view", directions[1]), *(("parameters", one) for one in leaves)):
        assert leaf.grad is None or bool(torch.isfinite(leaf.grad).all()), f"the gradient of {label} is not finite"
        leaf.grad = None
    return value.detach()
