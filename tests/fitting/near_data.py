"""Surfaces under near point lights, by plain NumPy: a BTF that knows where its lights stand, and what is true."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from torchmat import Btf

DOME = 40 / 30  # the radius of a dome of 80 cm over a wall 30 cm wide, in widths of it


class Scene(NamedTuple):
    """`btf` of near lights; `far` the same images with the directions at the centre; `light` [n, 3, H, W] and `normal` [3, H, W]."""

    btf: Btf
    far: Btf
    light: np.ndarray
    normal: np.ndarray


def dome(count: int = 24, radius: float = DOME, highest_deg: float = 70.0) -> np.ndarray:
    """Return positions [n, 3] spread evenly over a dome, down to so many degrees from the pole (a golden spiral)."""
    step = (np.arange(count) + 0.5) / count
    z = 1 - step * (1 - np.cos(np.deg2rad(highest_deg)))
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    return radius * np.stack((np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z), axis=1)


def places(height: int, width: int) -> np.ndarray:
    """Return x and y [2, H, W] of texels' centres, in widths from the centre."""
    x, y = (np.arange(width) + 0.5) / width - 0.5, (height / 2 - np.arange(height) - 0.5) / width
    return np.stack(np.meshgrid(x, y))


def bumps(height: int, width: int, strength: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a height [H, W] with mean 0 in widths, and its normals [3, H, W], of formulas."""
    x, y = places(height, width)
    z = strength * (np.sin(7 * x + 1) * np.cos(6 * y) + 0.5 * np.sin(11 * y - 5 * x))
    across = strength * (7 * np.cos(7 * x + 1) * np.cos(6 * y) - 2.5 * np.cos(11 * y - 5 * x))
    up = strength * (-6 * np.sin(7 * x + 1) * np.sin(6 * y) + 5.5 * np.cos(11 * y - 5 * x))
    normal = np.stack((-across, -up, np.ones_like(z)))
    return z - z.mean(), normal / np.linalg.norm(normal, axis=0)


def towards(position: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit directions [n, 3, H, W] from points of a height [H, W] to positions, and (d0 / d)^2 as [n, 1, H, W]."""
    point = np.concatenate((places(*height.shape), height[None]))
    gap = position[:, :, None, None] - point
    square = (gap * gap).sum(axis=1, keepdims=True)
    return gap / np.sqrt(square), (position * position).sum(axis=1)[:, None, None, None] / square


def scene(values, height: np.ndarray, normal: np.ndarray, position: np.ndarray, dtype=np.float64) -> Scene:
    """Return the scene whose values [n, 3, H, W] are those of a function of the lights [n, 3, H, W], darkened by distance."""
    light, darker = towards(position, height)
    images = (values(light) * darker).astype(dtype)
    view = np.tile([0.0, 0.0, 1.0], (len(position), 1))
    btf = Btf.from_tensors(images, None, view, light_position=position)
    return Scene(btf, Btf.from_tensors(images, btf.light, view), light, normal)


def lambert(albedo: np.ndarray, normal: np.ndarray):
    """Return the function that gives the values [n, 3, H, W] of a matte surface for lights [n, 3, H, W]."""
    return lambda light: albedo * np.maximum((light * normal).sum(axis=1, keepdims=True), 0)


def degrees(found: torch.Tensor, truth: np.ndarray) -> np.ndarray:
    """Return the angles [H, W] between unit normals [3, H, W], in degrees."""
    return np.rad2deg(np.arccos(np.clip((found.double().numpy() * truth).sum(axis=0), -1, 1)))
