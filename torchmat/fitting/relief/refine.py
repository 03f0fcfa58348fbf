"""Move a height to where a fitted appearance wants it: one Gauss-Newton step per texel, held together by slopes."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchmat.fitting.relief.surface import Surface, ViewSlopes
from torchmat.geometry import poisson
from torchmat.geometry.normals import pad_border
from torchmat.geometry.rays import look_up, texel_centres
from torchmat.repeatable import one_thread

_SLOPE_ERROR, _SLOPE_SHARE = 0.03, 0.1  # fitted normals are off by so much, steep ones by so much of their slope
_INDEPENDENT = 0.03  # of the samples of a texel: what the model cannot follow is shared by neighbouring directions
_OUTLYING = 0.05  # residuals (display values) from which Cauchy's weights count them as hidden or misplaced
_LONGEST_STEP = 0.75  # texels
_BLOCK_VALUES = 1_000_000


def image_gradient(images: Tensor, tiles: bool) -> Tensor:
    """Return the change of images [n, C, h, w] along u and v, central differences, as [n, 2 C, h, w]."""
    rows, columns = images.shape[-2:]
    wide = pad_border(images, tiles)
    across = (wide[..., 1:-1, 2:] - wide[..., 1:-1, :-2]) * (columns / 2)
    up = (wide[..., :-2, 1:-1] - wide[..., 2:, 1:-1]) * (rows / 2)
    return torch.cat((across, up), dim=1)


def limited(height: Tensor, step: Tensor) -> Tensor:
    """Return `height` [1, h, w] after `step`, no texel moving by more than the images' gradients reach."""
    longest = _LONGEST_STEP / height.shape[-1]
    return height + step.clamp(-longest, longest)


def refine_height(
    surface: Surface, height: Tensor, slopes: Tensor, predict: Callable[[slice], Tensor],
    steepness: Callable[[Tensor], Tensor],
) -> Tensor:
    """Return the height [1, H, W] that agrees best with the images, given the appearance, and with `slopes` [2, H, W].

    `predict` gives the values [k, 3, H, W] of a run of the surface's samples, `steepness` the derivative of the
    residual's scale at a value: where the scale is steep a difference counts more.
    """
    source, btf = surface.source.btf, surface.training.btf
    tiles, dtype = surface.training.tiles, surface.training.dtype
    rows = surface.source.used.nonzero()[:, 0]
    slopes_of_views = ViewSlopes(source, dtype)
    centres = texel_centres(btf.height, btf.width, dtype)
    curvature, pull = torch.zeros(1, btf.height, btf.width, dtype=dtype), torch.zeros(1, btf.height, btf.width, dtype=dtype)
    squares, count = torch.zeros_like(curvature), torch.zeros_like(curvature)
    for part in torch.arange(len(rows)).split(max(1, _BLOCK_VALUES // (3 * btf.height * btf.width))):
        run = slice(int(part[0]), int(part[-1]) + 1)
        slope = slopes_of_views.of(rows[part])
        gradient = image_gradient(source.images(rows[part], dtype), tiles)
        across, up = look_up(gradient, centres - height * slope, tiles, "bicubic").split(3, dim=1)
        target, weight = surface.values(run)
        scale = steepness(target)
        residual = (target - predict(run)) * scale
        change = -(across * slope[:, :1] + up * slope[:, 1:]) * scale
        weight = weight / (1 + (residual / _OUTLYING) ** 2)
        curvature += (weight * change * change).sum(dim=(0, 1))
        pull -= (weight * change * residual).sum(dim=(0, 1))
        squares += (weight * residual * residual).sum(dim=(0, 1))
        count += weight.sum(dim=(0, 1))
    with one_thread():
        variance = (squares.sum() / count.sum().clamp(min=1e-12)).clamp(min=1e-12)
        # The residual is target - prediction, and the target is what moves with the height.
        step = pull / curvature.clamp(min=1e-6 * float(curvature.mean()) + 1e-30)
        spread = _SLOPE_ERROR + _SLOPE_SHARE * slopes.square().sum(dim=0, keepdim=True).sqrt()
        known = curvature.clamp(min=1e-30) * (_INDEPENDENT / variance)
        return poisson(slopes, 1 / spread**2, tiles, limited(height, step), known, btf.mask).to(dtype)
