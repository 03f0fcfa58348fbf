"""What a scene uses of a material: which texels, under which lights and views, and how much.

A scene is a camera, an object and lights. All that a material must know of it are the points that are seen and lit, as
planes of numbers: a picture and a fit share this one notion, and neither needs the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from torchmat.btf.pairs import measured_pairs
from torchmat.errors import RangeError, ShapeError, message
from torchmat.repeatable import one_thread

_SHARP = 0.999  # of the use must see no more than the texture that is left
_MOST = 5_000  # points, or pairs of point and light, that a share is estimated from
_OUTSIDE = 0.02  # in the disc, 2 degrees: directions so far beyond the measured ones count as outside of them
_REACH = 2  # coarse texels that a copy of half the size, halved again and again, mixes on each side
_WORTH = 0.9  # of the texels: a window of more is no saving


class SampleWeights(NamedTuple):
    """`weight` [n] of each measured sample, float64; `outside`, the share of the use beyond the measured directions."""

    weight: Tensor
    outside: float


@dataclass(frozen=True, eq=False)
class SceneUse:
    """The points that a scene shows, and each pair of a point and a light that reaches it.

    `uv` [2, P] counts textures, u right and v up; `footprint` [P] is how many textures a pixel covers. Of the pairs,
    `point` [K] is their point, `light` and `view` [3, K] the unit directions in its tangent frame, both above the
    horizon, and `weight` [K] the share of a pixel times the light's intensity. Raises ShapeError for planes that do not
    fit, RangeError for a scene in which nothing is seen and lit.
    """

    uv: Tensor
    footprint: Tensor
    point: Tensor
    light: Tensor
    view: Tensor
    weight: Tensor

    def __post_init__(self) -> None:
        points, pairs = self.uv.shape[-1], len(self.weight)
        wanted = {"uv": (2, points), "footprint": (points,), "point": (pairs,), "light": (3, pairs), "view": (3, pairs)}
        for name, shape in wanted.items():
            found = tuple(getattr(self, name).shape)
            if found != shape:
                raise ShapeError(message("SceneUse", name, f"be {list(shape)}", f"it is {list(found)}"))
        if not bool((self.weight > 0).any()):
            step = "Check that the camera looks at the object, and that a light stands before it."
            raise RangeError(message("SceneUse", "the scene", "show a point that is lit", "it shows none", step))

    def __add__(self, other: SceneUse) -> SceneUse:
        """Return what both use together, as two pictures that count by their pixels."""
        return joined((self, other))

    def sample_weights(self, light: Tensor, view: Tensor) -> SampleWeights:
        """Return how much each measured pair of `light` and `view` [n, 3] is used; all weights add up to 1.

        Each point's light and view are spread over the measured pairs around them, as they are where measured images
        are interpolated (`RawBtf`): barycentric in light times barycentric in view, the outline's beyond the known
        directions, the nearest pair's where a pair was not measured.
        """
        chosen = _evenly(len(self.weight))
        pairs = measured_pairs("the scene's use", light, view)
        lights, views = pairs.lights.find(self.light[:, chosen].T), pairs.views.find(self.view[:, chosen].T)
        pair, weight = pairs.combined(lights.index, lights.weight, views.index, views.weight)
        used = self.weight[chosen].double()
        used = used / used.sum()
        total = torch.zeros(len(light), dtype=torch.float64)
        with one_thread():
            total.index_add_(0, pairs.sample.flatten()[pair].flatten(), (weight * used[:, None]).flatten())
        outside = (lights.beyond > _OUTSIDE) | (views.beyond > _OUTSIDE)
        return SampleWeights(total, float(used[outside].sum()))

    def evenly(self, most: int) -> Tensor:
        """Return the numbers of at most `most` pairs of a point and a light, evenly chosen."""
        return _evenly(len(self.weight), most)

    def levels(self, height: int, width: int) -> Tensor:
        """Return at which level of a texture of that size a texel is as wide as a point's pixel, [P]; 0 is full."""
        return _levels(self.footprint, height, width)

    def level(self, height: int, width: int) -> int:
        """Return how often a texture of that size may be halved before all but a thousandth of the use sees it."""
        chosen = _evenly(len(self.weight))
        found, order = _levels(self.footprint[self.point[chosen]], height, width).sort()
        below = self.weight[chosen[order]].double().cumsum(0)
        return int(found[int((below <= (1 - _SHARP) * below[-1]).sum())].floor())

    def texels(self, height: int, width: int, tiles: bool = True) -> Tensor:
        """Return which texels, bool [height, width], are touched by the filter of a point, at the level that it needs.

        A texture that tiles is touched on its other side as well.
        """
        touched = torch.zeros(height, width, dtype=torch.bool)
        coarse = self.levels(height, width).ceil()
        for level in range(int(coarse.max()) + 1):
            size = (math.ceil(height / 2**level), math.ceil(width / 2**level))
            small = _touched(self.uv[:, coarse == level], size, tiles)
            if level:
                small = _grown(small, _REACH, tiles)
            row, column = (torch.arange(n) * s // n for n, s in zip((height, width), size, strict=True))
            touched |= small[row][:, column]
        return touched

    def window(self, height: int, width: int, tiles: bool = True) -> tuple[int, int, int, int] | None:
        """Return top, left, height and width of the texels that are touched; None for all, or nearly all.

        Its borders stand where texels of the coarsest level that is seen do, so that it can be halved as the whole is.
        None also for a use that reaches around the border of a texture that tiles.
        """
        step = 2 ** int(self.levels(height, width).max().ceil())
        if step > 1 and (height % step or width % step):
            return None
        # What some of the points touch says in most cases that there is no window.
        found = None
        for points in (_evenly(self.uv.shape[-1]), slice(None)):
            uv, coarse = self.uv[:, points], _levels(self.footprint[points], height, width).ceil()
            top, rows = _span(1 - uv[1], coarse, height, step, tiles)
            left, columns = _span(uv[0], coarse, width, step, tiles)
            around = tiles and ((rows == height) != (columns == width))
            if around or rows * columns > _WORTH * height * width:
                return None
            found = (top, left, rows, columns)
        return found


class Usable(Protocol):
    """A scene: what says what it uses."""

    def use(self) -> SceneUse:
        """Return what the scene uses."""


def _span(place: Tensor, coarse: Tensor, count: int, step: int, tiles: bool) -> tuple[int, int]:
    """Return the first texel and the number of those, of `count` along one side, that points touch, in whole steps.

    `place` [P] counts textures from the first texel on, `coarse` [P] is the level that each point needs.
    """
    low, high = count, 0
    for level in range(int(coarse.max()) + 1):
        at = place if not int(coarse.max()) else place[coarse == level]
        if not len(at):
            continue
        texels = count // 2**level
        at = ((at % 1 if tiles else at.clamp(0, 1)) * texels - 0.5).floor()
        reach = _REACH if level else 0
        first, last = int(at.min()) - reach, int(at.max()) + 2 + reach
        if tiles and (first < 0 or last > texels):
            return 0, count
        low, high = min(low, max(0, first) * 2**level), max(high, min(last, texels) * 2**level)
    low, high = low // step * step, min(-(-high // step) * step, count)
    return low, high - low


def _evenly(count: int, most: int = _MOST) -> Tensor:
    """Return at most `most` of `count` numbers, evenly chosen."""
    step = max(1, -(-count // most))
    return torch.arange(step // 2, count, step)


def _levels(footprint: Tensor, height: int, width: int) -> Tensor:
    texels = (footprint * max(height, width)).clamp(min=1e-30)
    return torch.log2(texels).clamp(0, (max(height, width) - 1).bit_length())


def joined(uses: Sequence[SceneUse]) -> SceneUse:
    """Return what several pictures use together; each counts by its pixels."""
    starts = torch.tensor([0, *(use.uv.shape[-1] for use in uses)]).cumsum(0)
    point = torch.cat([use.point + start for use, start in zip(uses, starts[:-1], strict=True)])
    planes = (torch.cat([getattr(use, name) for use in uses], dim=-1) for name in ("light", "view", "weight"))
    return SceneUse(
        torch.cat([use.uv for use in uses], dim=-1), torch.cat([use.footprint for use in uses]), point, *planes
    )


def as_use(scene: SceneUse | Usable | Sequence[SceneUse | Usable]) -> SceneUse:
    """Return what a scene uses, or a list of them together; raises RangeError for what is no scene."""
    if isinstance(scene, SceneUse):
        return scene
    if isinstance(scene, list | tuple) and scene:
        return joined([as_use(one) for one in scene])
    if isinstance(scene, Sequence) or not hasattr(scene, "use"):
        step = "Give torchmat.Scene(mesh, lights, ...), its use(), or a list of them."
        raise RangeError(message("fit", "scene", "be a Scene", f"it is {type(scene).__name__}", step))
    return scene.use()


def _touched(uv: Tensor, size: tuple[int, int], tiles: bool) -> Tensor:
    """Return which texels, bool of `size`, a bilinear look-up at `uv` [2, P] reads."""
    ends = []
    for place, count in ((1 - uv[1], size[0]), (uv[0], size[1])):
        low = ((place % 1 if tiles else place.clamp(0, 1)) * count - 0.5).floor().long()
        pair = torch.stack((low, low + 1))
        ends.append(pair % count if tiles else pair.clamp(0, count - 1))
    row, column = ends
    touched = torch.zeros(size, dtype=torch.bool)
    touched[row[:, None], column[None]] = True
    return touched


def _grown(mask: Tensor, reach: int, tiles: bool) -> Tensor:
    """Return a mask [h, w] grown by `reach` on all sides, around the border where it tiles."""
    for dim in (0, 1):
        grown = mask.clone()
        for step in range(1, min(reach, mask.shape[dim] - 1) + 1):
            for way in (step, -step):
                moved = mask.roll(way, dim)
                if not tiles:
                    edge = slice(0, step) if way > 0 else slice(mask.shape[dim] - step, None)
                    moved[(slice(None),) * dim + (edge,)] = False
                grown |= moved
        mask = grown
    return mask
