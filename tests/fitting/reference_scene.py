"""Small BTFs whose geometry is known, rendered by NumPy alone: a Lambert relief with shadow and ambient, and a flat gloss.

The renderer is a vectorised form of the loops in `reference.relief`; tests/fitting/test_surface.py compares the two.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from tests.support import all_pairs, hemisphere

from torchmat import Btf

SOFTNESS = 0.05  # of the penumbra, in slopes: the package's default
VIEWS = ((0, 1), (35, 4), (60, 4))
LIGHTS = ((15, 1), (35, 4), (68, 5))


@dataclass(frozen=True)
class Scene:
    """What was rendered: `images` [n, 3, H, W] under `light` and `view` [n, 3], and the maps that made them."""

    height: np.ndarray
    albedo: np.ndarray
    ambient: np.ndarray
    light: np.ndarray
    view: np.ndarray
    images: np.ndarray
    tiles: bool = True

    def btf(self, kind: type = np.float32, weight: np.ndarray | None = None) -> Btf:
        """Return the images as a Btf of that precision."""
        return Btf.from_tensors(self.images.astype(kind), self.light, self.view, weight)

    @property
    def true_height(self) -> torch.Tensor:
        """The height [1, H, W] in texture widths."""
        return torch.from_numpy(self.height[None])


def centres(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Return u and v [H, W] of texel centres, v upward."""
    v, u = np.meshgrid(1 - (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
    return u, v


def waves(
    rows: int, columns: int, seed: int, count: int, highest: int, tiles: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a smooth random map in [0, 1] and its derivatives toward u and v; it repeats at its borders if it tiles."""
    random = np.random.default_rng(seed)
    u, v = centres(rows, columns)
    value, along_u, along_v = np.zeros((3, rows, columns))
    for _ in range(count):
        a, b = random.integers(-highest, highest + 1, 2)
        a, b = (a, b) if a or b else (1, 1)
        a, b = (a, b) if tiles else (a + 0.4, b + 0.3)
        size, phase = random.uniform(0.4, 1), random.uniform(0, 2 * np.pi)
        angle = 2 * np.pi * (a * u + b * v) + phase
        value += size * np.cos(angle)
        along_u -= size * 2 * np.pi * a * np.sin(angle)
        along_v -= size * 2 * np.pi * b * np.sin(angle)
    low, span = value.min(), np.ptp(value)
    return (value - low) / span, along_u / span, along_v / span


def bilinear(image: np.ndarray, u: np.ndarray, v: np.ndarray, tiles: bool) -> np.ndarray:
    """Return `image` [..., H, W] at texture coordinates of one shape."""
    rows, columns = image.shape[-2:]
    x, y = u * columns - 0.5, (1 - v) * rows - 0.5
    if not tiles:
        x, y = np.clip(x, 0, columns - 1), np.clip(y, 0, rows - 1)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - left, y - top
    near, far = [(index % size if tiles else np.minimum(index, size - 1)) for index, size in ((left, columns), (left + 1, columns))]
    upper, lower = [(index % size if tiles else np.minimum(index, size - 1)) for index, size in ((top, rows), (top + 1, rows))]
    above = image[..., upper, near] * (1 - fx) + image[..., upper, far] * fx
    below = image[..., lower, near] * (1 - fx) + image[..., lower, far] * fx
    return above * (1 - fy) + below * fy


def _slope(direction: np.ndarray, shape: tuple[int, int]) -> tuple[float, float]:
    return direction[0] / direction[2], direction[1] / direction[2] * shape[1] / shape[0]


def hits(height: np.ndarray, view: np.ndarray, tiles: bool, steps: int = 64) -> np.ndarray:
    """Return the height [H, W] at which each texel centre's view ray first meets the surface."""
    u, v = centres(*height.shape)
    du, dv = _slope(view, height.shape)
    low, high = height.min(), height.max()

    def gap(z: np.ndarray) -> np.ndarray:
        return bilinear(height, u + z * du, v + z * dv, tiles) - z

    above, below = np.full(height.shape, high), np.full(height.shape, low)
    found = np.zeros(height.shape, bool)
    for z in np.linspace(high, low, steps + 1):
        new = (gap(np.full(height.shape, z)) >= 0) & ~found
        below[new], found = z, found | new
        above[~found] = z
    for _ in range(40):
        middle = (above + below) / 2
        outside = gap(middle) < 0
        above, below = np.where(outside, middle, above), np.where(outside, below, middle)
    return (above + below) / 2


def clearance(
    height: np.ndarray, direction: np.ndarray, u: np.ndarray, v: np.ndarray, tiles: bool, steps: int = 64
) -> np.ndarray:
    """Return the least (ray height - surface height) / distance from the surface at u, v toward `direction`."""
    du, dv = _slope(direction, height.shape)
    run = np.hypot(du, dv)
    start, span = bilinear(height, u, v, tiles), np.ptp(height)
    z = (span * np.arange(1, steps + 1) / steps)[:, None, None]
    free = (start + z - bilinear(height, u + z * du, v + z * dv, tiles)) / (z * max(run, 1e-9))
    return np.minimum(1 / max(run, 1e-9), free.min(axis=0))


def render(
    height: np.ndarray, normal: np.ndarray, albedo: np.ndarray, ambient: np.ndarray, light: np.ndarray, view: np.ndarray,
    tiles: bool, met: np.ndarray | None = None,
) -> np.ndarray:
    """Return one image [3, H, W] of a Lambert relief: albedo * soft shadow * cosine + ambient, where the view meets it.

    `met` is what `hits` says of this view, where that is known.
    """
    u, v = centres(*height.shape)
    z = hits(height, view, tiles) if met is None else met
    du, dv = _slope(view, height.shape)
    u, v = u + z * du, v + z * dv
    lit = np.clip(clearance(height, light, u, v, tiles) / SOFTNESS + 0.5, 0, 1)
    cosine = np.maximum(0, np.tensordot(light, bilinear(normal, u, v, tiles), 1))
    return bilinear(albedo, u, v, tiles) * lit * cosine + bilinear(ambient, u, v, tiles)


def colours(rows: int, columns: int, highest: int, seed: int = 11, tiles: bool = True) -> np.ndarray:
    """Return a textured albedo [3, H, W] in 0.15..0.85."""
    return np.stack([0.15 + 0.7 * waves(rows, columns, seed + channel, 12, highest, tiles)[0] for channel in range(3)])


@functools.lru_cache(maxsize=8)
def relief_scene(
    rows: int = 24, columns: int = 24, tiles: bool = True, depth: float = 0.16, offset: float = 0.015, finest: int = 6,
    views: tuple[tuple[float, int], ...] = VIEWS, lights: tuple[tuple[float, int], ...] = LIGHTS,
) -> Scene:
    """Return a Lambert relief of `depth` texture widths, its lowest point `offset` over the plane of the images."""
    value, along_u, along_v = waves(rows, columns, 3, 5, 2, tiles)
    height = offset + depth * value
    # v spans rows / columns texture widths.
    slopes = depth * along_u, depth * along_v * columns / rows
    normal = np.stack((-slopes[0], -slopes[1], np.ones_like(height)))
    normal /= np.linalg.norm(normal, axis=0)
    albedo = colours(rows, columns, finest, tiles=tiles)
    ambient = 0.04 * albedo
    light, view = all_pairs(hemisphere(lights), hemisphere(views))
    met = {one: hits(height, np.array(one), tiles) for one in set(map(tuple, view.tolist()))}
    images = np.stack([
        render(height, normal, albedo, ambient, *pair, tiles, met[tuple(pair[1].tolist())]) for pair in zip(light, view, strict=True)
    ])
    return Scene(height, albedo, ambient, light, view, images, tiles)


@functools.lru_cache(maxsize=2)
def glossy_scene(rows: int = 24, columns: int = 24) -> Scene:
    """Return a flat, textured surface with a Blinn lobe whose strength is textured too."""
    light, view = all_pairs(hemisphere(LIGHTS), hemisphere(VIEWS))
    albedo, gloss = colours(rows, columns, 6), waves(rows, columns, 29, 8, 5)[0]
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    images = light[:, 2, None, None, None] * albedo + 0.8 * gloss * half[:, 2, None, None, None] ** 20
    zero = np.zeros((rows, columns))
    return Scene(zero, albedo, np.zeros_like(albedo), light, view, images)
