"""A relief looked at closely: cubic heights between texels, shadow where each ray ends, and rays enough for silhouettes.

A texel of the images is a square of surface that shadow edges and silhouettes cross. The height is interpolated to
`FACTOR` times its resolution (Keys 1981), one ray starts in each texel of that, every light has one map of what it
reaches at that resolution, and a ray takes its light from where it ends rather than from the texel that it ends in.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.geometry.normals import pad_border
from torchmat.geometry.rays import clearance, look_up, texel_centres, trace_view
from torchmat.models.indirect import Between

FACTOR = 2
SOFTNESS = 0.05  # slopes that a penumbra spans, as in the fast way
_EDGE = 0.5  # finer texels that the edge of a shadow is wide at least, so that it moves smoothly with the height
_MARGIN = 3  # texels that cubic interpolation looks beyond a place, and one


class FineRays(NamedTuple):
    """What light and view meet on a finer height: `lit` [l, 1, h, w] for the distinct lights, `ends` [v, 2, h, w].

    h and w are FACTOR times the texels. `ends` holds the places, uv, where the rays of the distinct views end; sample i
    has number `light[i]` and `view[i]` among them.
    """

    lit: Tensor
    light: Tensor
    ends: Tensor
    view: Tensor


def refined(height: Tensor, tiles: bool) -> Tensor:
    """Return a height [1, H, W] at FACTOR times its resolution, [1, h, w]: cubic between texels, linear in the height."""
    if height.min() == height.max():  # rounding would make a relief of it
        return height.repeat_interleave(FACTOR, -2).repeat_interleave(FACTOR, -1)
    wide = pad_border(height[None], tiles, _MARGIN)
    # With `antialias`, which changes nothing where a map grows, torch's kernel is Catmull and Rom's, which keeps slopes;
    # without it torch's own overshoots.
    fine = functional.interpolate(wide, scale_factor=FACTOR, mode="bicubic", antialias=True, align_corners=False)[0]
    cut = _MARGIN * FACTOR
    return fine[:, cut:-cut, cut:-cut].contiguous()


def lit_by(fine: Tensor, light: Tensor, tiles: bool) -> Tensor:
    """Return how much of lights [l, 3, 1, 1] above the horizon reaches each texel of a finer height, [l, 1, h, w]."""
    free = clearance(fine, light, tiles=tiles)
    return coverage(free, edge_width(free, tiles))


def edge_width(free: Tensor, tiles: bool) -> Tensor:
    """Return the clearances, [l, 1, h, w], that the edge of a shadow spans where rays are `free` by so much."""
    wide = pad_border(free.detach(), tiles)
    across, down = wide[..., 1:-1, 2:] - wide[..., 1:-1, :-2], wide[..., 2:, 1:-1] - wide[..., :-2, 1:-1]
    return (_EDGE / 2 * (across.abs() + down.abs())).clamp(min=SOFTNESS)


def coverage(free: Tensor, width: Tensor) -> Tensor:
    """Return how much of the light there is where its rays are `free` by so much: linear over `width`, half of it at 0."""
    return (free / width + 0.5).clamp(0, 1)


def fine_rays(height: Tensor, lights: Tensor, light: Tensor, views: Tensor, view: Tensor, tiles: bool) -> FineRays:
    """Return what the distinct `lights`, `views` [k, 3, 1, 1] meet on `height` [1, H, W]; sample i has number `light[i]`, `view[i]`."""
    fine = refined(height, tiles)
    return FineRays(lit_by(fine, lights, tiles), light, trace_view(fine, views, tiles=tiles).uv, view)


def seen_along(shaded: Tensor, sent: Between | None, met: FineRays, tiles: bool) -> Tensor:
    """Return what is seen [n, 3, H, W] of texels that give `shaded` [n, 3, H, W] under all their light: the mean of a texel's rays.

    `sent` is what texels give in shadow as well, None for nothing. As in the fast way a ray looks colours up
    by what it has moved from its texel's centre, so that without parallax nothing is blurred; its light where it ends.
    """
    moved = met.ends - _starts(shaded.shape[-2], shaded.shape[-1], shaded.dtype)
    lit = look_up(met.lit[met.light], met.ends[met.view], tiles)
    if sent is not None and sent.value.ndim == 4:  # another under every light: looked up in one go
        both = look_up(torch.cat((shaded, sent.whole().expand_as(shaded)), dim=1), moved[met.view], tiles, "bicubic")
        return functional.avg_pool2d(torch.addcmul(both[:, 3:], both[:, :3], lit), FACTOR)
    seen = functional.avg_pool2d(look_up(shaded, moved[met.view], tiles, "bicubic") * lit, FACTOR)
    if sent is None:
        return seen
    every = functional.avg_pool2d(look_up(sent.value[None], moved, tiles, "bicubic"), FACTOR)[met.view]
    return seen + (every if sent.share is None else every * sent.share)


def _starts(rows: int, columns: int, dtype: torch.dtype) -> Tensor:
    """Return where in its texel each ray starts, [2, h, w], counted from the texel's centre."""
    centres = texel_centres(rows, columns, dtype).repeat_interleave(FACTOR, 1).repeat_interleave(FACTOR, 2)
    return texel_centres(rows * FACTOR, columns * FACTOR, dtype) - centres
