"""The measured images themselves on an object: what a material made of them is compared with."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat import safe
from torchmat.btf.btf import Btf
from torchmat.btf.near import far_only
from torchmat.btf.neighbours import Triangulation
from torchmat.btf.pairs import measured_pairs
from torchmat.errors import RangeError, ShapeError, message
from torchmat.planes import common_lead
from torchmat.progress import progress

_BLOCK_VALUES = 8_000_000  # of images, 32 MB in float32
_BLOCK_POINTS = 32_768


class RawBtf:
    """A BTF as it was measured, to be rendered like a Material: images interpolated between known lights and views.

    Around the light and around the view of a point lie three known directions each (`Triangulation`): nine images, four
    texels of each. A light beyond the known ones takes the value at their outline times ``cos(light) / cos(there)``, so
    that it falls to 0 at the horizon; a view beyond them takes the outline's value as it is. A pair of light and view
    that was not measured takes the nearest pair that was, times the ratio of the lights' cosines. Of a pair measured
    twice the first image counts; images of lights below the surface do not. Texels without data leave their share to
    the others; where all lack it the value is 0. No gradient runs through.

    Args:
        btf: the images.
        tiles: whether they repeat; else their border goes on.
        memory_gb: decoded images of up to so many GB (12 bytes a texel and image in float32, 16 with missing texels) are
            held in memory; larger data is read for each picture anew.
        dtype: precision of directions and values.

    Raises RangeError for near lights or cameras, whose images are of no one direction, DataError when no light stands above the surface, or when lights and views are scattered over more than a
    million combinations.
    """

    name = "raw_btf"
    has_relief = False

    def __init__(
        self, btf: Btf, tiles: bool = True, memory_gb: float = 2.0, dtype: torch.dtype = torch.float32
    ) -> None:
        if not memory_gb >= 0:
            step = "0 reads the images for each picture anew."
            raise RangeError(message("RawBtf", "memory_gb", "not be negative", f"it is {memory_gb}", step))
        far_only("RawBtf", btf.near)
        self.tiles = tiles
        self.dtype = dtype
        self.size = (btf.height, btf.width)
        self._btf = btf
        self._memory_gb = memory_gb
        self._masked = btf.mask is not None or btf.invalid_share > 0
        self._pairs = measured_pairs(btf.source.path, btf.light, btf.view)
        factor = self._pairs.factor
        self._factor = None if factor is None else factor.to(dtype).flatten()
        self._table = self._whole()

    def halved(self) -> RawBtf:
        """Return the same data with images of half the size, rounded up: each texel the mean of those it covers."""
        other = copy.copy(self)
        height, width = self.size
        other.size = ((height + 1) // 2, (width + 1) // 2)
        other._table = other._whole()
        return other

    def shade_at(self, uv: Tensor, light: Tensor, view: Tensor) -> Tensor:
        """Return ``pi * f_r * cos(light)`` [..., 3, h, w], linear, never negative, at coordinates `uv` [2, h, w].

        u runs to the right and v up, the images span 0..1. `light`, `view`: unit vectors [..., 3, h, w] or
        [..., 3, 1, 1] of the dtype of this object. Exactly 0 where the light or the view is not above z = 0. Raises
        ShapeError or RangeError for directions that do not fit.
        """
        self._check(uv, light, view)
        with torch.no_grad():
            lead = common_lead(light, view)
            size = tuple(uv.shape[-2:])
            texel, share = self._texels(uv.detach().reshape(2, -1).to(self.dtype))
            lights = self._around(self._pairs.lights, light, (*lead, *size), falls=True)
            views = self._around(self._pairs.views, view, (*lead, *size), falls=False)
            value = torch.empty(*lead, 3, *size, dtype=self.dtype)
            for where in np.ndindex(*lead):
                sample, weight = self._samples(*(part[where] for part in (*lights, *views)))
                value[where] = self._gather(sample, weight, texel, share).T.reshape(3, *size)
            return value.clamp(min=0)

    def _check(self, uv: Tensor, light: Tensor, view: Tensor) -> None:
        where = "RawBtf.shade_at"
        if uv.ndim != 3 or uv.shape[0] != 2:
            raise ShapeError(message(where, "uv", "be [2, H, W]", f"it is {tuple(uv.shape)}"))
        size = tuple(uv.shape[-2:])
        for name, direction in (("light", light), ("view", view)):
            if direction.ndim < 3 or direction.shape[-3] != 3 or tuple(direction.shape[-2:]) not in ((1, 1), size):
                requirement = f"be [..., 3, 1, 1] or [..., 3, {size[0]}, {size[1]}]"
                step = "Vectors lie on dimension -3."
                raise ShapeError(message(where, name, requirement, f"it is {tuple(direction.shape)}", step))
            if direction.dtype != self.dtype:
                step = "Convert with .to(dtype); one call has one precision."
                raise RangeError(message(where, name, f"be {self.dtype}", f"it is {direction.dtype}", step))

    def _around(
        self, known: Triangulation, direction: Tensor, shape: tuple[int, ...], falls: bool
    ) -> tuple[Tensor, Tensor]:
        """Return indices and weights [..., h * w, k] of the known directions around `direction` [..., 3, h, w].

        `shape` is that of the result, (..., h, w), to which one direction per image is spread. Below the horizon the
        weights are 0; with `falls` they fall to it.
        """
        rows = direction.movedim(-3, -1)
        flat = rows.reshape(-1, 3)
        above = flat[:, 2:] > 0
        found = known.find(torch.where(above, flat, flat.new_tensor((0.0, 0.0, 1.0))))
        weight = found.weight * above * (found.ratio[:, None] if falls else 1)
        lead, points = shape[:-2], math.prod(shape[-2:])
        parts = []
        for part in (found.index, weight.to(self.dtype)):
            corners = part.shape[-1]
            spread = part.reshape(*rows.shape[:-1], corners).expand(*lead, *rows.shape[-3:-1], corners)
            flat_part = spread.reshape(*lead, math.prod(rows.shape[-3:-1]), corners)
            parts.append(flat_part.expand(*lead, points, corners))
        return parts[0], parts[1]

    def _samples(
        self, light: Tensor, light_weight: Tensor, view: Tensor, view_weight: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the samples [P, pairs] around each point and their weights, from those of lights and views [P, k]."""
        pair, weight = self._pairs.combined(light, light_weight, view, view_weight)
        if self._factor is not None:
            weight = weight * self._factor[pair]
        return self._pairs.sample.flatten()[pair], weight

    def _texels(self, uv: Tensor) -> tuple[Tensor, Tensor]:
        """Return the four texels [P, 4] around coordinates [2, P], numbered row by row, and their bilinear weights."""
        ends = []
        for place, count in ((uv[0], self.size[1]), (1 - uv[1], self.size[0])):
            place = (place % 1 if self.tiles else place.clamp(0, 1)) * count - 0.5
            low = place.floor()
            share = place - low
            numbers = torch.stack((low, low + 1), dim=1).long()
            numbers = numbers % count if self.tiles else numbers.clamp(0, count - 1)
            ends.append((numbers, torch.stack((1 - share, share), dim=1)))
        (column, across), (row, down) = ends
        texel = row[:, :, None] * self.size[1] + column[:, None]
        return texel.flatten(1), (down[:, :, None] * across[:, None]).flatten(1)

    def _gather(self, sample: Tensor, weight: Tensor, texel: Tensor, share: Tensor) -> Tensor:
        """Return the weighted sum [P, 3] over samples [P, pairs] and texels [P, 4]."""
        if self._table is None:
            total = self._streamed(sample, weight, texel, share)
        else:
            total = torch.cat([self._looked_up(*part) for part in zip(
                *(whole.split(_BLOCK_POINTS) for whole in (sample, weight, texel, share)), strict=True
            )])
        if not self._masked:
            return total
        # The last channel has counted the share of the weight that stands on data.
        return safe.divide(total[:, :3] * weight.sum(dim=1, keepdim=True), total[:, 3:])

    def _looked_up(self, sample: Tensor, weight: Tensor, texel: Tensor, share: Tensor) -> Tensor:
        assert self._table is not None
        rows = (sample[:, :, None] * math.prod(self.size) + texel[:, None]).flatten(1)
        return _weighted_rows(self._table, rows, (weight[:, :, None] * share[:, None]).flatten(1))

    def _streamed(self, sample: Tensor, weight: Tensor, texel: Tensor, share: Tensor) -> Tensor:
        """Add up image by image: each needed one is read once, whatever the number of points that it serves."""
        pairs = sample.shape[1]
        total = torch.zeros(len(sample), 4 if self._masked else 3, dtype=self.dtype)
        used = (weight.flatten() != 0).nonzero()[:, 0]
        ordered, order = sample.flatten()[used].sort(stable=True)
        order = used[order]
        for samples, table in self._blocks(ordered.unique_consecutive(), show=False):
            first = int(torch.searchsorted(ordered, samples[0]))
            last = int(torch.searchsorted(ordered, samples[-1], right=True))
            entry = order[first:last]
            point = entry // pairs
            image = torch.searchsorted(samples, ordered[first:last])
            rows = image[:, None] * math.prod(self.size) + texel[point]
            total.index_add_(0, point, _weighted_rows(table, rows, weight.flatten()[entry][:, None] * share[point]))
        return total

    def _blocks(self, samples: Tensor, show: bool | None) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield runs of `samples` with the rows [k * H * W, channels] of their texels."""
        step = max(1, _BLOCK_VALUES // (4 * self._btf.height * self._btf.width))
        runs = samples.split(step) if len(samples) else ()
        for run in progress(runs, "reading images", show=show):
            yield run, self._rows(run)

    def _rows(self, samples: Tensor) -> Tensor:
        """Return the texels of images as rows of three colours, of data with gaps also of the share that is there."""
        images = self._btf.images(samples, self.dtype)
        if self._masked:
            valid = self._btf.valid(samples)
            images = torch.cat((torch.where(valid, images, images.new_zeros(())), valid.to(self.dtype)), dim=1)
        if tuple(images.shape[-2:]) != self.size:
            images = functional.adaptive_avg_pool2d(images, self.size)
        return images.permute(0, 2, 3, 1).reshape(-1, images.shape[1])

    def _whole(self) -> Tensor | None:
        """Return the rows of all images, or None if they do not fit the memory granted."""
        count, texels, channels = len(self._btf), math.prod(self.size), 4 if self._masked else 3
        if count * texels * channels * self.dtype.itemsize > self._memory_gb * 1e9:
            return None
        table = torch.empty(count * texels, channels, dtype=self.dtype)
        for run, rows in self._blocks(torch.arange(count), show=None):
            table[int(run[0]) * texels : (int(run[-1]) + 1) * texels] = rows
        return table


def _weighted_rows(table: Tensor, rows: Tensor, weight: Tensor) -> Tensor:
    """Return the sum [n, channels] of `rows` [n, k] of `table` with weights [n, k], without an array of all of them."""
    return functional.embedding_bag(rows, table, per_sample_weights=weight, mode="sum")
