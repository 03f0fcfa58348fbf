"""Height to normals, and slopes back and forth.

Heights are maps [1, H, W]. Slopes [2, H, W] are the height's change toward +x (right) and +y (up the texture). Where a
height is physical it is measured in texture widths, so that a slope is rise over run.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat import safe
from torchmat.errors import RangeError, ShapeError, check_finite, message
from torchmat.fast import normals as fast_normals
from torchmat.parts_of import part_of

STRENGTH_RANGE = (1.0, 8.0)
# A height of ten texture widths is no relief of a surface; it comes from a unit taken for another.
LARGEST_SCALE = 10.0


def check_height(where: str, height: Tensor) -> None:
    """Raise ShapeError or RangeError unless `height` is a finite map [1, H, W]."""
    if height.ndim != 3 or height.shape[0] != 1 or 0 in height.shape:
        raise ShapeError(message(where, "height", "be [1, H, W]", f"it is {tuple(height.shape)}"))
    check_finite(where, "height", height.detach())


def check_height_scale(where: str, scale: float) -> None:
    """Raise RangeError unless `scale`, physical height over texture width, is one that a surface has."""
    if not 0 < scale < LARGEST_SCALE:
        step = "It is the physical height of 1 divided by the width of the texture; for a flat surface leave the height out."
        requirement = f"be positive and below {LARGEST_SCALE:g} texture widths"
        raise RangeError(message(where, "height_scale", requirement, f"it is {scale}", step))


def pad_border(image: Tensor, tiles: bool, width: int = 1) -> Tensor:
    """Continue [N, C, H, W] by `width` texels on each side: around the corner if it tiles, else with its border."""
    if not tiles:
        return functional.pad(image, (width,) * 4, mode="replicate")
    # Indexing wraps any number of times; circular padding refuses more than the map's own size.
    rows = torch.arange(-width, image.shape[-2] + width) % image.shape[-2]
    columns = torch.arange(-width, image.shape[-1] + width) % image.shape[-1]
    return image[..., rows, :][..., columns]


def sobel(height: Tensor, tiles: bool = True) -> Tensor:
    """Return the 3 x 3 Sobel response [2, H, W] of `height` [1, H, W]: 8 times its change a texel toward +x and +y."""
    check_height("sobel", height)
    padded = pad_border(height[None], tiles)
    found = part_of("kornia.filters", "spatial_gradient")(padded, mode="sobel", order=1, normalized=False)[0, 0, :, 1:-1, 1:-1]
    return torch.stack((found[0], -found[1]))  # rows run downward, y runs up


def slopes_from_height(height: Tensor, height_scale: float = 1.0, tiles: bool = True) -> Tensor:
    """Return the slopes [2, H, W] of a physical height: `height` times `height_scale` in texture widths."""
    check_height_scale("slopes_from_height", height_scale)
    return sobel(height, tiles) * (height_scale * height.shape[-1] / 8)


def normals_from_slopes(slopes: Tensor) -> Tensor:
    """Return unit normals [..., 3, H, W] of slopes [..., 2, H, W]: a flank that rises to the right faces left."""
    found = fast_normals.normals(slopes, _normals_of)
    return _normals_of(slopes) if found is None else found


def _normals_of(slopes: Tensor) -> Tensor:
    flat = torch.ones_like(slopes[..., :1, :, :])
    return safe.normalise(torch.cat((-slopes, flat), dim=-3))


def slopes_from_normals(normal: Tensor, steepest_deg: float = 84.0) -> Tensor:
    """Return slopes [2, H, W] of unit normals [3, H, W]; what is steeper than `steepest_deg` counts as that steep."""
    least = math.cos(math.radians(steepest_deg))
    return -normal[:2] / normal[2:].clamp(min=least)


def normals_from_height(height: Tensor, normal_strength: float = 1.0, tiles: bool = True) -> Tensor:
    """Return unit normals [3, H, W] of an artist's height in [0, 1]: ``normalise(-dx, -dy, 1 / normal_strength)``.

    `dx`, `dy` are the Sobel responses (Liao 2011, section 3.1.2); `normal_strength` runs from 1 to 8. For a physical
    height use `slopes_from_height` and `normals_from_slopes`.
    """
    low, high = STRENGTH_RANGE
    if not low <= normal_strength <= high:
        fact = f"it is {normal_strength}"
        raise RangeError(message("normals_from_height", "normal_strength", f"lie in [{low:g}, {high:g}]", fact))
    return normals_from_slopes(sobel(height, tiles) * normal_strength)


def flip_green(normal: Tensor) -> Tensor:
    """Turn an OpenGL normal map (green up the texture) into a DirectX one (green down), and back."""
    return normal * torch.tensor([1.0, -1.0, 1.0], dtype=normal.dtype)[:, None, None]
