"""Rays against a height field: where a view meets the surface (parallax), what it hides, and soft self-shadow.

Liao 2011 and Tatarchuk 2006: a linear search along the ray, then refinement. A physical height [1, H, W] in texture
widths stands over the plane z = 0, on which the images of a BTF are registered: an image shows at plane position p
what the ray through p meets. Texture coordinates run 0..1, u to the right, v up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat import safe
from torchmat.errors import ShapeError, check_positive, message
from torchmat.fast import look_up as fast_look_up, rays as fast_rays
from torchmat.geometry.normals import check_height, pad_border
from torchmat.planes import common_lead

_STEPS_PER_TEXEL = 1.0
REFINEMENTS = 4
_SHORTEST = 1e-6  # run for each unit of height
SHIFT_TEXELS = 10_000  # maps of at least so many texels are moved whole along a shared ray rather than looked up
_LARGEST_SLOPE = math.tan(math.radians(88.0))  # beyond, a ray crosses many tiles before it meets anything


class Hits(NamedTuple):
    """Where rays meet the surface: `uv` [..., 2, h, w], and its `height` there [..., 1, h, w]."""

    uv: Tensor
    height: Tensor


def texel_centres(height: int, width: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """Return the texture coordinates [2, H, W] of texel centres, row 0 at the top (v near 1)."""
    u = (torch.arange(width, dtype=dtype) + 0.5) / width
    v = 1 - (torch.arange(height, dtype=dtype) + 0.5) / height
    down, across = torch.meshgrid(v, u, indexing="ij")
    return torch.stack((across, down))


def look_up(maps: Tensor, uv: Tensor, tiles: bool = True, mode: str = "bilinear") -> Tensor:
    """Return `maps` [N or 1, C, H, W] at `uv` [N, 2, h, w] as [N, C, h, w]; a border texel goes on if not tiling.

    `mode` is that of `grid_sample`: bilinear, bicubic or nearest.
    """
    found = fast_look_up.look_up(maps, uv, tiles, mode, _look_up)
    return _look_up(maps, uv, tiles, mode) if found is None else found


def _look_up(maps: Tensor, uv: Tensor, tiles: bool, mode: str) -> Tensor:
    border = (2 if mode == "bicubic" else 1) if tiles else 0
    return _sampled(pad_border(maps, True, border) if tiles else maps, uv, border, mode)


def _sampled(maps: Tensor, uv: Tensor, border: int, mode: str) -> Tensor:
    """Look `maps` up that have a `border` of what repeats, or none where the border texel goes on."""
    u, v = uv[:, 0], 1 - uv[:, 1]
    if border:
        rows, columns = maps.shape[-2] - 2 * border, maps.shape[-1] - 2 * border
        u = ((u % 1) * columns + border) / (columns + 2 * border)
        v = ((v % 1) * rows + border) / (rows + 2 * border)
    grid = torch.stack((u * 2 - 1, v * 2 - 1), dim=-1)
    maps = maps.expand(len(grid), -1, -1, -1)
    return functional.grid_sample(maps, grid, mode=mode, padding_mode="border", align_corners=False)


class _Field:
    """A height map that is asked for at uv + z * slope, over and over.

    With one direction for a whole map of texel centres every texel moves by the same amount: the map is shifted and
    blended with its neighbours, four reads in order, where a look-up computes an address for each texel.
    """

    def __init__(self, height: Tensor, uv: Tensor, slope: Tensor, tiles: bool, centres: bool, span: float) -> None:
        self.map, self.uv, self.slope, self.tiles = height[None], uv, slope, tiles
        # What a walk asks over and over is bordered once.
        self._border = 1 if tiles else 0
        self._bordered = pad_border(self.map, True) if tiles else self.map
        rows, columns = height.shape[-2:]
        # A shift is a whole number of texels and a blend, both plain floats: no gradient would reach the direction.
        large = rows * columns >= SHIFT_TEXELS
        self._shifts = centres and slope.shape[-2:] == (1, 1) and large and not slope.requires_grad
        if self._shifts:
            texels = slope[:, :, 0, 0].detach() * torch.tensor([columns, -rows], dtype=slope.dtype)  # rows run downward
            self._texels = texels.tolist()
            self._margin = int(math.ceil(float(texels.abs().max()) * span)) + 2
            self._wide = pad_border(self.map, tiles, self._margin)[0]

    def at(self, z: Tensor) -> Tensor:
        """Return the surface at uv + z slope, [N, 1, h, w], for a height per pixel."""
        return _sampled(self._bordered, self.uv + z * self.slope, self._border, "bilinear")

    def along(self, z: Tensor) -> Tensor:
        """Return the same for one height per direction [N, 1, 1 or h, 1 or w]; |z| at most the span given."""
        if not self._shifts:
            return self.at(z)
        heights = z.flatten().tolist()
        return torch.stack([self._shifted(z * x, z * y) for z, (x, y) in zip(heights, self._texels, strict=True)])

    def _shifted(self, across: float, down: float) -> Tensor:
        rows, columns = self.map.shape[-2:]
        left, top = math.floor(across), math.floor(down)
        x, y = across - left, down - top
        part = self._wide[:, self._margin + top :, self._margin + left :]
        part = part[:, : rows + 1, : columns + 1]
        part = torch.lerp(part[:, :-1], part[:, 1:], y)
        return torch.lerp(part[:, :, :-1], part[:, :, 1:], x)


def ray_slope(direction: Tensor, height: int, width: int) -> Tensor:
    """Return how far a ray moves in uv for each unit of height, [..., 2, h, w], from directions [..., 3, h, w].

    Rays flatter than 2 degrees count as that steep. v has the texture's height as its unit, u its width.
    """
    across, rise = direction[..., :2, :, :], direction[..., 2:, :, :]
    # The bound is on what is divided by: the quotient of a ray at the very horizon overflows, and so does its square.
    least = safe.sqrt((across * across).sum(dim=-3, keepdim=True)) / _LARGEST_SLOPE
    steep = torch.maximum(rise.abs(), least)
    slope = safe.divide(across, torch.where(rise < 0, -steep, steep))
    aspect = torch.tensor([1.0, width / height], dtype=slope.dtype)[:, None, None]
    return slope * aspect


def _batched(where: str, height: Tensor, direction: Tensor, uv: Tensor | None) -> tuple[Tensor, Tensor, torch.Size]:
    """Return uv [N, 2, h, w], slope [N, 2, 1 or h, 1 or w] and the leading shape, for one view or one per pixel."""
    check_height(where, height)
    if direction.ndim < 3 or direction.shape[-3] != 3:
        raise ShapeError(message(where, "direction", "be [..., 3, h, w]", f"it is {tuple(direction.shape)}"))
    rows, columns = height.shape[-2:]
    uv = texel_centres(rows, columns, height.dtype) if uv is None else uv
    slope = ray_slope(direction, rows, columns)
    lead = common_lead(slope, uv)
    slope = slope.expand(*lead, *slope.shape[-3:]).reshape(-1, *slope.shape[-3:])
    uv = uv.expand(*lead, *uv.shape[-3:]).reshape(-1, *uv.shape[-3:])
    return uv, slope, lead


def _length(vector: Tensor) -> Tensor:
    """Return the length [N, 1, h, w] of [N, 2, h, w]; torch's norm over so short a dimension takes ten times as long."""
    return safe.sqrt(vector[:, :1] * vector[:, :1] + vector[:, 1:] * vector[:, 1:])


def _walk(slope: Tensor, span: float, rows: int, columns: int) -> Iterator[Tensor]:
    """Yield the share of the way, 0 to 1, that each ray has gone after each step, [N, 1, 1 or h, 1 or w].

    Every ray takes steps of its own length, so that what it meets does not depend on the others of the call.
    """
    texels = slope.detach() * torch.tensor([columns, rows], dtype=slope.dtype)[:, None, None]
    count = (_length(texels) * (span * _STEPS_PER_TEXEL)).ceil() + 2
    for step in range(int(count.max()) + 1):
        yield (step / count).clamp(max=1)


def trace_view(height: Tensor, view: Tensor, uv: Tensor | None = None, tiles: bool = True) -> Hits:
    """Return where the view rays through plane positions `uv` meet the surface first.

    `view` [..., 3, 1, 1] or per pixel; `uv` [2, h, w], by default the texel centres. A linear search from the top with
    one step a texel, then regula falsi; differentiable in height, view and `uv`: one Newton step from the root found
    carries the gradient of the implicit equation ``height(p + z slope) = z``.
    """
    centres = uv is None
    uv, slope, lead = _batched("trace_view", height, view, uv)
    low, high = float(height.detach().min()), float(height.detach().max())
    field = _Field(height, uv, slope, tiles, centres, max(abs(low), abs(high)))
    with torch.no_grad():
        root = fast_rays.first_roots(height, uv, slope, low, high, REFINEMENTS, tiles)
        root = _first_root(field, low, high) if root is None else root
    wanted = torch.is_grad_enabled() and any(x.requires_grad for x in (height, slope, uv))
    hit_height = _implicit(field, root) if wanted else root
    hit = uv + hit_height * slope
    return Hits(hit.reshape(*lead, *hit.shape[1:]), hit_height.reshape(*lead, *hit_height.shape[1:]))


def _implicit(field: _Field, root: Tensor) -> Tensor:
    """Return `root` with the gradient that the equation surface(uv + z slope) = z gives it."""
    with torch.enable_grad():
        z = root.detach().requires_grad_()
        met = look_up(field.map.detach(), field.uv + z * field.slope, field.tiles)
        (climb,) = torch.autograd.grad(met.sum(), z)
    # Where the ray only just touches, the true gradient is infinite: it is held at ten times that of a flat surface.
    steepness = (1 - climb).clamp(min=0.1)
    gap = field.at(root) - root
    return root + (gap - gap.detach()) / steepness


def _first_root(field: _Field, low: float, high: float) -> Tensor:
    """Return the largest z at which the surface at uv + z slope reaches z, [N, 1, h, w]."""
    last = torch.full_like(field.slope[:, :1], high)
    gap_last = field.along(last) - last
    above, gap_above = torch.full_like(gap_last, high), gap_last
    below, gap_below = above.clone(), gap_last
    found = torch.zeros_like(above, dtype=torch.bool)
    for share in _walk(field.slope, high - low, *field.map.shape[-2:]):
        z = high - (high - low) * share
        here = field.along(z) - z
        new = (here >= 0) & ~found
        above, below = torch.where(new, last, above), torch.where(new, z, below)
        gap_above, gap_below = torch.where(new, gap_last, gap_above), torch.where(new, here, gap_below)
        found |= new
        if bool(found.all()):
            break
        last, gap_last = z, here
    for _ in range(REFINEMENTS):
        z = torch.lerp(above, below, safe.divide(gap_above, gap_above - gap_below).clamp(0, 1))
        here = field.at(z) - z
        outside = here < 0
        above, gap_above = torch.where(outside, z, above), torch.where(outside, here, gap_above)
        below, gap_below = torch.where(outside, below, z), torch.where(outside, gap_below, here)
    return torch.lerp(above, below, safe.divide(gap_above, gap_above - gap_below).clamp(0, 1))


def clearance(height: Tensor, direction: Tensor, uv: Tensor | None = None, tiles: bool = True) -> Tensor:
    """Return by how much the ray from the surface at `uv` toward `direction` misses the surface, [..., 1, h, w].

    It is the least over the ray of (ray height - surface height) / distance, a difference of slopes: positive where
    the way is free, negative where it is blocked. Walks until the ray is above the highest point.
    """
    centres = uv is None
    uv, slope, lead = _batched("clearance", height, direction, uv)
    span = float(height.detach().max() - height.detach().min())
    found = fast_rays.clearances(height, uv, slope, span, _SHORTEST, tiles, with_rise=False)
    if found is not None:
        return found[0].reshape(*lead, *found[0].shape[1:])
    field = _Field(height, uv, slope, tiles, centres, span)
    run = _length(slope).clamp(min=_SHORTEST)  # distance along the plane for each unit of height
    start = field.along(torch.zeros_like(run))
    least = (1 / run).expand_as(start)  # what a flat surface leaves free
    shares = islice(_walk(slope, span, *height.shape[-2:]), 1, None) if span > 0 else ()
    for share in shares:
        z = span * share
        least = torch.minimum(least, (start + z - field.along(z)) / (z * run))
    return least.reshape(*lead, *least.shape[1:])


class Obstacles(NamedTuple):
    """What comes nearest to rays from texel centres: they pass it `rise` [n, 1, H, W] above where they start.

    `slope` [n, 2, 1, 1] is how far they move in uv for each unit of height.
    """

    rise: Tensor
    slope: Tensor

    def clearance(self, height: Tensor, tiles: bool, which: Tensor) -> Tensor:
        """Return the clearance of rays `which` [k] on `height` [1, H, W], a little other perhaps; its gradient is the true one.

        That of a least value is the gradient of what is least where it is least.
        """
        rise, slope = self.rise[which], self.slope[which]
        over = look_up(height[None], texel_centres(height.shape[-2], height.shape[-1], height.dtype) + rise * slope, tiles)
        return (height + rise - over) / (rise * _length(slope).clamp(min=_SHORTEST))


def find_obstacles(height: Tensor, direction: Tensor, tiles: bool = True) -> Obstacles:
    """Return what `clearance` finds along `direction` [n, 3, 1, 1], and where, without gradients."""
    uv, slope, _ = _batched("find_obstacles", height, direction, None)
    span = max(float(height.max() - height.min()), torch.finfo(height.dtype).tiny)
    found = fast_rays.clearances(height, uv, slope, span, _SHORTEST, tiles, with_rise=True)
    if found is not None and found[1] is not None:
        return Obstacles(found[1], slope)
    field = _Field(height, uv, slope, tiles, True, span)
    run = _length(slope).clamp(min=_SHORTEST)
    start = field.along(torch.zeros_like(run))
    least, rise = torch.full_like(start, math.inf), torch.full_like(start, span)
    for share in islice(_walk(slope, span, *height.shape[-2:]), 1, None):
        z = span * share
        here = (start + z - field.along(z)) / (z * run)
        rise, least = torch.where(here < least, z, rise), torch.minimum(least, here)
    return Obstacles(rise, slope)


def soft_shadow(
    height: Tensor, light: Tensor, softness: float = 0.05, uv: Tensor | None = None, tiles: bool = True
) -> Tensor:
    """Return how much of the light reaches the surface at `uv`, [..., 1, h, w] in [0, 1].

    The penumbra widens with the distance of what casts the shadow (Tatarchuk 2006): full light where the ray clears
    everything by a slope of `softness` / 2, none where it is blocked by as much, linear between. A light at or below
    the horizon gives 0.
    """
    check_positive("soft_shadow", "softness", softness)
    free = clearance(height, light, uv, tiles)
    lit = (free / softness + 0.5).clamp(0, 1)
    return torch.where(light[..., 2:, :, :] > 0, lit, torch.zeros_like(lit))


def visible(height: Tensor, view: Tensor, tolerance: float = 0.02, tiles: bool = True) -> Tensor:
    """Return where the view sees the surface point of each texel, bool [..., 1, H, W]."""
    return clearance(height, view, None, tiles) > -tolerance
