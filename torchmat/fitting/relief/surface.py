"""De-parallaxed samples: every image resampled onto the surface once, so that per-texel models are closed-form again.

What a view hides has no weight there. On the surface a sample is ``lit * direct + ambient``: `lit` is the soft shadow of
its light, `ambient` what a texel receives by way of others.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike
import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.btf import Btf
from torchmat.btf.decode import Decoder
from torchmat.btf.near import Near
from torchmat.btf.store import CLIPPED, INVALID, VALID, summarise
from torchmat.fitting.objective import shown, white_of
from torchmat.fitting.relief.window import Window, surroundings
from torchmat.fitting.training import Training
from torchmat.geometry import slopes_from_height
from torchmat.geometry.rays import look_up, ray_slope, soft_shadow, texel_centres, visible
from torchmat.models.fine_relief import FACTOR, refined
from torchmat.models.relief_maps import FINE
from torchmat.progress import progress
from torchmat.repeatable import one_thread

IN_MEMORY = 1_000_000_000  # bytes of resampled images; more go to a temporary file, of which the system maps what is used
BLOCK = 4_000_000  # values resampled at a time
_RAYS = 500_000  # walked at a time
_BLOCK_VALUES = 2_000_000  # compared at a time
_SEEN = 0.5  # of a texel
_LIT = 0.5  # samples that get less of the light say more of the ambient than of the texel
_DARK = 0.2  # and those below say nothing else


@dataclass(frozen=True)
class Surface:
    """Samples on the surface: `training` over a Btf of them, whose pixels may be rewritten, and `lit` [light, 1, H, W].

    `source` are the samples of the same texels as the images show them; `slopes` [2, H, W] those of the height.
    `window` is the part of the whole that these texels are, None for all.
    """

    source: Training
    training: Training
    pixels: np.ndarray
    flags: np.ndarray
    lit: Tensor
    slopes: Tensor
    window: Window | None = None

    def psnr_db(self, rows: Tensor, level: float, predict: Callable[[Tensor], Tensor]) -> float:
        """Return the PSNR of what `predict` says of samples `rows`: see `agreement_db`."""
        return self.agreement_db(rows, level, predict)[0]

    def agreement_db(self, rows: Tensor, level: float, predict: Callable[[Tensor], Tensor]) -> tuple[float, float]:
        """Return how well `predict` says what samples `rows` are, in dB: after the display root, as far as white, and relative.

        `level` is the mean of the data, which says what is white. The second is of linear values, highlights and all: 20 is a
        relative error of .01. Texel by texel, which rounds alike on any number of threads.
        """
        btf, white = self.training.btf, white_of(level)
        error, count = torch.zeros(btf.height, btf.width, dtype=torch.float64), 0.0
        linear, power = torch.zeros_like(error), torch.zeros_like(error)
        for some in rows.split(max(1, _BLOCK_VALUES // (3 * btf.height * btf.width))):
            values, valid = self.values(some)
            found = predict(some)
            gap = shown(found / white, 0).clamp(max=1) - shown(values / white, 0).clamp(max=1)
            linear += ((found - values).square() * valid).sum(dim=(0, 1)).double()
            power += (values.square() * valid).sum(dim=(0, 1)).double()
            error += (gap.square() * valid).sum(dim=(0, 1)).double()
            count += float(valid.sum()) * 3
        relative = float(linear.sum()) / max(float(power.sum()), 1e-30)
        return _db(float(error.sum()) / max(count, 1)), _db(relative)

    def values(self, samples: slice | Tensor) -> tuple[Tensor, Tensor]:
        """Return values [k, 3, H, W] of some samples and what they count, [k, 1, H, W] in [0, 1]."""
        index = samples if isinstance(samples, slice) else samples.numpy()
        flags = torch.from_numpy(np.ascontiguousarray(self.flags[index]))[:, None]
        weight = (flags == VALID).to(self.training.dtype)
        clipped = self.training.btf.clipped_weight * (flags == CLIPPED)
        return torch.from_numpy(np.ascontiguousarray(self.pixels[index])), weight + clipped

    @property
    def weights(self) -> Tensor:
        """What samples of each flag count, [3]: `values` says the same of each sample."""
        found = torch.zeros(3, dtype=self.training.dtype)
        found[VALID], found[CLIPPED] = 1.0, self.training.btf.clipped_weight
        return found

    def shadow(self, samples: slice | range) -> Tensor:
        """Return how much light reaches each texel in some samples, [k, 1, H, W]."""
        return self.lit[self.training.btf.light_index[samples.start : samples.stop]]


def _db(share: float) -> float:
    return -10 * math.log10(max(share, 1e-12))


def space_for(shape: tuple[int, ...], dtype: DTypeLike) -> np.ndarray:
    """Return an array that is not filled yet: in memory, or where that would be much in a temporary file."""
    if np.prod(shape) * np.dtype(dtype).itemsize <= IN_MEMORY:
        return np.empty(shape, dtype)
    with tempfile.TemporaryFile(prefix="torchmat-") as file:  # the map keeps it alive
        return np.memmap(file, dtype, "w+", shape=shape)


class ViewSlopes:
    """How far the rays of each sample's view move for each unit of height: the same for all texels, or each its own."""

    def __init__(self, btf: Btf, dtype: torch.dtype) -> None:
        self.btf, self.dtype = btf, dtype
        self._known = None if btf.view_position is not None else self._of(btf.views[:, :, None, None].to(dtype))

    def _of(self, view: Tensor) -> Tensor:
        return ray_slope(view, self.btf.height, self.btf.width)

    def of(self, rows: Tensor) -> Tensor:
        """Return the slopes [k, 2, 1, 1], or [k, 2, H, W] of near cameras."""
        if self._known is not None:
            return self._known[self.btf.view_index[rows]]
        return self._of(self.btf.directions(rows, self.dtype)[1])

    @property
    def steepest(self) -> tuple[float, float]:
        """The largest along u and along v, which near cameras have in a corner."""
        found = self._known
        if found is None:
            found = self._of(self.btf.corners().view_planes(torch.arange(len(self.btf.views)), self.dtype))
        return float(found[:, 0].abs().max()), float(found[:, 1].abs().max())


class Sight(NamedTuple):
    """What views and lights see of a height: `seen` bool [view, 1, H, W], `lit` [light, 1, H, W] in [0, 1]."""

    seen: Tensor
    lit: Tensor


def look_along(training: Training, height: Tensor) -> Sight:
    """Return what each view and each light sees of `height` [1, H, W], all texels of it.

    On a fine relief a texel is lit as much as it is on average, and seen where most of it is.
    """
    btf, dtype = training.btf, training.dtype
    fine = training.relief == FINE
    size, height = height.shape, refined(height.to(dtype), training.tiles) if fine else height.to(dtype)
    seen = torch.empty(len(btf.views), *size, dtype=torch.bool)
    lit = torch.empty(len(btf.lights), *size, dtype=dtype)
    some = max(1, _RAYS // height.numel())

    def by_texel(found: Tensor) -> Tensor:
        return functional.avg_pool2d(found.to(dtype), FACTOR) if fine else found.to(dtype)

    placed = btf.of_size(height.shape[-2], height.shape[-1])
    for found, views in zip(seen.split(some), torch.arange(len(seen)).split(some), strict=True):
        found.copy_(by_texel(visible(height, placed.view_planes(views, dtype), tiles=training.tiles)) > _SEEN)
    for found, lights in zip(lit.split(some), torch.arange(len(lit)).split(some), strict=True):
        found.copy_(by_texel(soft_shadow(height, placed.light_planes(lights, dtype), tiles=training.tiles)))
    return Sight(seen, lit)


def bring_onto(
    training: Training, height: Tensor, into: Surface | None = None, window: Window | None = None,
    sight: Sight | None = None,
) -> Surface:
    """Resample the training samples onto the surface of `height` [1, H, W]; the pixels of `into` are written over.

    Of a `window` only its texels are found, from the images around them. `sight` is that of the whole height where it
    is known already.
    """
    btf, dtype = training.btf, training.dtype
    rows = training.used.nonzero()[:, 0]
    height = height.to(dtype)
    sight = sight or look_along(training, height)
    here = window or Window(0, 0, btf.height, btf.width)
    if into is None:
        size = tuple(here.crop(height).shape[-2:])
        pixels = space_for((len(rows), 3, *size), np.float64 if dtype == torch.float64 else np.float32)
        flags = space_for((len(rows), *size), np.uint8)
    else:
        pixels, flags = into.pixels, into.flags
    _resample(training, rows, height, here, here.crop(sight.seen), pixels, flags)
    slopes = here.crop(slopes_from_height(height, tiles=training.tiles))
    # Lights are sorted as in the source, but those without a training sample are gone.
    lit = here.crop(sight.lit)[btf.light_index[rows].unique()]
    source = training if window is None else replace(training, btf=window.of(btf))
    raised = None if btf.near is None else source.btf.near and source.btf.near.raised(here.crop(height) * (btf.width / here.width))
    return Surface(source, _on_surface(source, pixels, flags, rows, raised), pixels, flags, lit, slopes, window)


def _resample(
    training: Training, rows: Tensor, height: Tensor, window: Window, seen: Tensor, pixels: np.ndarray,
    flags: np.ndarray,
) -> None:
    """Write samples `rows` at the window's texels on the surface into `pixels` and `flags`."""
    btf, dtype = training.btf, training.dtype
    slopes = ViewSlopes(btf if btf.near is None else btf.with_near(btf.near.raised(height)), dtype)
    across, up = (float(height.abs().max() * steepest) for steepest in slopes.steepest)
    around = surroundings(btf, window, (up * btf.height, across * btf.width), training.tiles)
    centres, raised = window.crop(texel_centres(btf.height, btf.width, dtype)), window.crop(height)
    outside = torch.zeros(()).bool() if btf.mask is None else ~window.crop(btf.mask)
    parts = torch.arange(len(rows)).split(max(1, BLOCK // (3 * math.prod(around.size))))
    for part in progress(parts, "onto the surface", show=training.progress):
        which = btf.view_index[rows[part]]
        slope = slopes.of(rows[part])
        position = around.place(centres - raised * (slope if slope.shape[-2:] == (1, 1) else window.crop(slope)))
        first, last = int(part[0]), int(part[-1]) + 1
        valid = around.valid(rows[part])
        # Bicubic: what is interpolated here is interpolated again when the surface is seen, and blur adds up.
        image = look_up(around.images(rows[part], dtype) * valid, position, training.tiles, "bicubic")
        pixels[first:last] = image.clamp(min=0).numpy()
        hidden = ~seen[which] | (look_up((~valid).to(dtype), position, training.tiles) > 0) | outside
        clipped = look_up(around.clipped(rows[part]).to(dtype), position, training.tiles) > 0
        flags[first:last] = torch.where(hidden, INVALID, torch.where(clipped, CLIPPED, 0))[:, 0].numpy()


def _on_surface(training: Training, pixels: np.ndarray, flags: np.ndarray, rows: Tensor, near: Near | None) -> Training:
    source = training.btf
    decoder = Decoder(pixels.dtype, "linear", 1.0)
    light, view = source.light[rows], source.view[rows]
    near = None if near is None else replace(near.picked(rows), falloff=False)  # which is out of the samples already
    btf = Btf(
        summarise(pixels, flags), light, view, decoder, source.source, source.clipped_weight, mask=source.mask, near=near
    )
    importance = None if training.importance is None else training.importance[rows]
    return replace(training, btf=btf, used=torch.ones(len(btf), dtype=torch.bool), importance=importance)


def ambient(surface: Surface) -> Tensor:
    """Return the mean [3, H, W] of what each texel shows in shadow; see `ambient_and_usual`."""
    return ambient_and_usual(surface)[0]


def ambient_and_usual(surface: Surface) -> tuple[Tensor, Tensor]:
    """Return the mean [3, H, W] of what each texel shows in shadow, and what is usual, a number.

    Texels that are hardly ever in shadow take what is usual for their colour: the mean of all shadowed samples over
    that of all lit ones, times their own. `Training.shared` may know what is usual.
    """
    btf, dtype = surface.training.btf, surface.training.dtype
    size = (btf.height, btf.width)
    dark, bright = torch.zeros(3, *size, dtype=dtype), torch.zeros(3, *size, dtype=dtype)
    dark_weight, bright_weight = torch.zeros(1, *size, dtype=dtype), torch.zeros(1, *size, dtype=dtype)
    for block in btf.blocks(None, dtype, surface.training.progress):
        lit = surface.shadow(block.samples)
        weight = torch.ones_like(lit) if block.weight is None else block.weight.to(dtype)
        shadowed, exposed = weight * (_DARK - lit).clamp(min=0) / _DARK, weight * (lit >= _LIT)
        dark += (block.images * shadowed).sum(dim=0)
        bright += (block.images * exposed).sum(dim=0)
        dark_weight += shadowed.sum(dim=0)
        bright_weight += exposed.sum(dim=0)
    own = bright / bright_weight.clamp(min=1e-6)
    known = surface.training.shared
    usual = None if known is None else known.usual_ambient
    if usual is None:
        with one_thread():
            shadowed = dark.sum() / dark_weight.sum().clamp(min=1e-6)
            exposed = bright.sum() / bright_weight.sum().clamp(min=1e-6)
            usual = (shadowed / exposed.clamp(min=1e-12)).clamp(0, 1)
    return (dark + usual * own) / (dark_weight + 1), usual


def without_shadow(surface: Surface, ambient: Tensor) -> Training:
    """Return training samples ``(value - ambient) / lit`` of what is lit; the rest has no weight."""
    btf = surface.training.btf
    pixels, flags = space_for(surface.pixels.shape, surface.pixels.dtype), space_for(surface.flags.shape, np.uint8)
    for block in btf.blocks(None, surface.training.dtype):
        rows = slice(block.samples.start, block.samples.stop)
        lit = surface.shadow(block.samples)
        direct = (block.images - ambient) / lit.clamp(min=_LIT)
        pixels[rows] = direct.numpy()
        flags[rows] = np.where((lit[:, 0] < _LIT).numpy(), INVALID, surface.flags[rows])
    store = summarise(pixels, flags)
    decoder = Decoder(pixels.dtype, "linear", 1.0)
    bare = Btf(store, btf.light, btf.view, decoder, btf.source, btf.clipped_weight, mask=btf.mask, near=btf.near)
    return replace(surface.training, btf=bare)
