"""De-parallaxed samples: every image resampled onto the surface once, so that per-texel models are closed-form again.

What a view hides has no weight there. On the surface a sample is ``lit * direct + ambient``: `lit` is the soft shadow of
its light, `ambient` what a texel receives by way of others.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchmat.btf import Btf
from torchmat.btf.decode import Decoder
from torchmat.btf.store import CLIPPED, INVALID, VALID, summarise
from torchmat.fit.training import Training
from torchmat.geometry.relief import look_up, ray_slope, soft_shadow, texel_centres, visible
from torchmat.progress import progress
from torchmat.repeatable import one_thread

_IN_MEMORY = 1_000_000_000  # bytes of resampled images; more go to a temporary file, of which the system maps what is used
_BLOCK = 4_000_000  # values resampled at a time
_LIT = 0.5  # samples that get less of the light say more of the ambient than of the texel
_DARK = 0.2  # and those below say nothing else


@dataclass(frozen=True)
class Surface:
    """Samples on the surface: `training` over a Btf of them, whose pixels may be rewritten, and `lit` [light, 1, H, W].

    `source` are the samples as the images show them.
    """

    source: Training
    training: Training
    pixels: np.ndarray
    flags: np.ndarray
    lit: Tensor

    def values(self, samples: slice | Tensor) -> tuple[Tensor, Tensor]:
        """Return values [k, 3, H, W] of some samples and what they count, [k, 1, H, W] in [0, 1]."""
        index = samples if isinstance(samples, slice) else samples.numpy()
        flags = torch.from_numpy(np.ascontiguousarray(self.flags[index]))[:, None]
        weight = (flags == VALID).to(self.training.dtype)
        clipped = self.training.btf.clipped_weight * (flags == CLIPPED)
        return torch.from_numpy(np.ascontiguousarray(self.pixels[index])), weight + clipped

    def shadow(self, samples: slice | range) -> Tensor:
        """Return how much light reaches each texel in some samples, [k, 1, H, W]."""
        return self.lit[self.training.btf.light_index[samples.start : samples.stop]]


def _space(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    if np.prod(shape) * np.dtype(dtype).itemsize <= _IN_MEMORY:
        return np.empty(shape, dtype)
    with tempfile.TemporaryFile(prefix="torchmat-") as file:  # the map keeps it alive
        return np.memmap(file, dtype, "w+", shape=shape)


def bring_onto(training: Training, height: Tensor, into: Surface | None = None) -> Surface:
    """Resample the training samples onto the surface of `height` [1, H, W]; the pixels of `into` are written over."""
    btf, dtype = training.btf, training.dtype
    rows = training.used.nonzero()[:, 0]
    height = height.to(dtype)
    view, light = btf.views[:, :, None, None].to(dtype), btf.lights[:, :, None, None].to(dtype)
    seen = torch.cat([visible(height, v[None], tiles=training.tiles) for v in view])
    lit = torch.cat([soft_shadow(height, v[None], tiles=training.tiles) for v in light])
    slope = ray_slope(view, btf.height, btf.width)
    centres = texel_centres(btf.height, btf.width, dtype)
    if into is None:
        pixels = _space((len(rows), 3, btf.height, btf.width), np.float64 if dtype == torch.float64 else np.float32)
        flags = _space((len(rows), btf.height, btf.width), np.uint8)
    else:
        pixels, flags = into.pixels, into.flags
    parts = torch.arange(len(rows)).split(max(1, _BLOCK // (3 * btf.height * btf.width)))
    for part in progress(parts, "onto the surface", show=training.progress):
        which = btf.view_index[rows[part]]
        position = centres - height * slope[which]
        first, last = int(part[0]), int(part[-1]) + 1
        valid = btf.valid(rows[part])
        # Bicubic: what is interpolated here is interpolated again when the surface is seen, and blur adds up.
        image = look_up(btf.images(rows[part], dtype) * valid, position, training.tiles, "bicubic")
        pixels[first:last] = image.clamp(min=0).numpy()
        hidden = ~seen[which] | (look_up((~valid).to(dtype), position, training.tiles) > 0)
        clipped = look_up(btf.clipped(rows[part]).to(dtype), position, training.tiles) > 0
        flags[first:last] = torch.where(hidden, INVALID, torch.where(clipped, CLIPPED, 0))[:, 0].numpy()
    return _surface(training, pixels, flags, btf.light[rows], btf.view[rows], lit)


def _surface(
    training: Training, pixels: np.ndarray, flags: np.ndarray, light: Tensor, view: Tensor, lit: Tensor
) -> Surface:
    source = training.btf
    decoder = Decoder(pixels.dtype, "linear", 1.0)
    btf = Btf(summarise(pixels, flags), light, view, decoder, source.source, source.clipped_weight)
    used = torch.ones(len(btf), dtype=torch.bool)
    # Lights are sorted as in the source, but those without a training sample are gone.
    kept = torch.tensor([int((source.lights - one).square().sum(dim=1).argmin()) for one in btf.lights])
    return Surface(training, replace(training, btf=btf, used=used), pixels, flags, lit[kept])


def ambient(surface: Surface) -> Tensor:
    """Return the mean [3, H, W] of what each texel shows in shadow.

    Texels that are hardly ever in shadow take what is usual for their colour: the mean of all shadowed samples over
    that of all lit ones, times their own.
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
    with one_thread():
        shadowed, exposed = dark.sum() / dark_weight.sum().clamp(min=1e-6), bright.sum() / bright_weight.sum().clamp(min=1e-6)
        usual = shadowed / exposed.clamp(min=1e-12)
    return (dark + usual.clamp(0, 1) * own) / (dark_weight + 1)


def without_shadow(surface: Surface, ambient: Tensor) -> Training:
    """Return training samples ``(value - ambient) / lit`` of what is lit; the rest has no weight.

    The surface's own pixels are rewritten, so it can be used for nothing else afterwards.
    """
    btf = surface.training.btf
    for block in btf.blocks(None, surface.training.dtype):
        rows = slice(block.samples.start, block.samples.stop)
        lit = surface.shadow(block.samples)
        direct = (block.images - ambient) / lit.clamp(min=_LIT)
        surface.pixels[rows] = direct.numpy()
        flags = surface.flags[rows]
        flags[(lit[:, 0] < _LIT).numpy()] = INVALID
    store = summarise(surface.pixels, surface.flags)
    decoder = Decoder(surface.pixels.dtype, "linear", 1.0)
    bare = Btf(store, btf.light, btf.view, decoder, btf.source, btf.clipped_weight)
    return replace(surface.training, btf=bare)
