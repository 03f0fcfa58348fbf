"""How well images from many views agree on a height, whatever the surface's reflectance.

Seen on its true surface, a material is simple: as light and view change, its texels follow a few patterns between them,
so the matrix of samples x texels is nearly of low rank, highlights and all. Seen on a wrong height, texels are mixed
with their neighbours and the rank grows. Plain photo-consistency (a texel keeps its colour) prefers a wrong height
on anything that shines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.fitting.training import Training
from torchmat.geometry.rays import look_up, ray_slope, texel_centres, visible
from torchmat.repeatable import one_thread, orthonormal, product

_SAMPLES = 400  # images that are compared, evenly chosen
_TEXELS = 96  # along the longer side; larger images are averaged down, since fine relief shows in the slopes
_RANK = 16
_FEWEST_VIEWS = 8  # with less the directions of parallax are chance
_SWEEPS = 3
_HIGHEST = math.cos(math.radians(80))  # views flatter than that see too little of each texel
_LOWEST_LIGHT = 0.1


@dataclass(frozen=True)
class Captured:
    """Images to compare: `images` [n, 3, h, w], `weight` [n, 1, h, w], and `view_index` [n] into `view` [v, 3, 1, 1].

    Of near cameras `view` is that of each texel, [v, 3, h, w].
    """

    images: Tensor
    weight: Tensor
    view: Tensor
    view_index: Tensor
    tiles: bool

    @property
    def slope(self) -> Tensor:
        """How far each view's rays move for each unit of height, [v, 2, 1, 1]."""
        return ray_slope(self.view, *self.images.shape[-2:])

    def few(self, share: float) -> Captured:
        """Return the images of a `share` of the views, at least eight of them, chosen at random but always the same."""
        views, index = self.view_index.unique(return_inverse=True)
        count = max(_FEWEST_VIEWS, math.ceil(share * len(views)))
        chosen = torch.randperm(len(views), generator=torch.Generator().manual_seed(0))[:count].sort().values
        kept = torch.isin(index, chosen)
        found, index = views[index[kept]].unique(return_inverse=True)
        return Captured(self.images[kept], self.weight[kept], self.view[found], index, self.tiles)


def capture(training: Training) -> Captured:
    """Choose samples evenly among those that are fitted, well lit and not seen too flatly, and shrink them."""
    btf = training.btf
    useful = training.used & (btf.light[:, 2] > _LOWEST_LIGHT) & (btf.view[:, 2] > _HIGHEST)
    rows = useful.nonzero()[:, 0]
    generator = torch.Generator().manual_seed(training.seed)
    rows = rows[torch.randperm(len(rows), generator=generator)[:_SAMPLES]].sort().values
    factor = max(1.0, max(btf.height, btf.width) / _TEXELS)
    size = (max(1, round(btf.height / factor)), max(1, round(btf.width / factor)))
    images, weights = [], []
    for part in rows.split(max(1, 8_000_000 // (3 * btf.height * btf.width))):
        weight = (btf.weights(part) > 0.5).float()
        image = btf.images(part).clamp(min=0) * weight
        if factor > 1:
            weight = functional.adaptive_avg_pool2d(weight, size)
            image = functional.adaptive_avg_pool2d(image, size) / weight.clamp(min=1e-6)
        images.append(image)
        weights.append(weight)
    view = btf.of_size(*size).view_planes(torch.arange(len(btf.views)), torch.float32)
    return Captured(torch.cat(images), torch.cat(weights), view, btf.view_index[rows], training.tiles)


@dataclass(frozen=True)
class Agreement:
    """Samples brought onto a height, against the nearest matrix of low rank; rows are scaled to one brightness.

    `residual`, `weight` [n, 3 t] and the rows' `subspace` [n, rank]; `scale` [n, 1] is what rows were multiplied with.
    """

    residual: Tensor
    weight: Tensor
    subspace: Tensor
    scale: Tensor
    energy: float

    @property
    def error(self) -> float:
        """Mean absolute residual over mean absolute value: outliers (what a view hides) do not decide it."""
        with one_thread():
            return float((self.residual.abs() * self.weight).sum()) / max(self.energy, 1e-30)


def on_surface(captured: Captured, maps: Tensor, height: Tensor, smooth: bool = True) -> Tensor:
    """Return maps [n, C, h, w], which are as the images are, brought onto the surface."""
    position = texel_centres(height.shape[-2], height.shape[-1], height.dtype) - height * captured.slope
    return look_up(maps, position[captured.view_index], captured.tiles, "bicubic" if smooth else "bilinear")


def agreement(captured: Captured, height: Tensor) -> Agreement:
    """Compare all samples on `height` [1, h, w] with their best approximation of low rank.

    Images are interpolated bicubically: the blur of bilinear interpolation alone favours heights that are 20 % too low.
    Samples that a view hides are filled in from the approximation itself, a few times over.
    """
    seen = visible(height, captured.view, tiles=captured.tiles)[captured.view_index]
    weight = seen * on_surface(captured, captured.weight, height, smooth=False)
    weight = weight.expand(-1, 3, -1, -1).flatten(1)
    rows = on_surface(captured, captured.images, height).flatten(1)
    with one_thread():
        size = (rows * rows * weight).sum(dim=1, keepdim=True) / weight.sum(dim=1, keepdim=True).clamp(min=1)
        scale = 1 / size.sqrt().clamp(min=1e-4)
        rows = rows * scale
        mean = (rows * weight).sum(dim=0) / weight.sum(dim=0).clamp(min=1e-6)
        energy = float((rows.abs() * weight).sum())
    generator = torch.Generator().manual_seed(0)
    subspace = torch.randn(len(rows), min(_RANK, max(1, len(rows) // 4)), generator=generator)
    known, filled = rows * weight, mean.expand_as(rows)
    for _ in range(_SWEEPS):
        whole = known + filled * (1 - weight)
        subspace = orthonormal(product(whole, product(whole.T, subspace)))
        filled = product(subspace, product(subspace.T, whole))
    return Agreement(rows - filled, weight, subspace, scale, energy)
