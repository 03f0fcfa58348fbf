"""The error figures, one definition each.

Predictions and targets are linear RGB planes [k, 3, H, W] in the package's value convention.

- `mse`: mean squared linear error.
- `relative_error`: sum (p - t)^2 / sum t^2, linear; `relative_error_interval` its 95 % interval over images drawn anew.
- `psnr_db`: peak 1, after clamping to [0, 1] and sRGB encoding; pooled over all samples; capped at 200 dB.
- `psnr_log_db`: peak 1, after the mu-law log(1 + mu v) / log(1 + mu), mu = 5000, usual for HDR images (Kalantari and
  Ramamoorthi 2017): sees dark texels beside highlights that `psnr_db` clamps.
- `ssim`: kornia's, window 11, on the sRGB-encoded images; None below 6 texels on a side, where it is not defined.
- `delta_e`: mean CIEDE2000.

Invalid samples count nowhere; windows of SSIM that reach over them see black in both images. Where a target is
clipped the truth is only known to be at least that bright, so a prediction above it is no error, one below is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchmat import colour
from torchmat.bootstrap import ratio_interval
from torchmat.fast import errors as fast_errors
from torchmat.parts_of import part_of

_MU = 5000.0
_CAP_DB = 200.0
_SSIM_WINDOW = 11
BAND_VALUES = 4_000_000  # of a picture are worked on at a time: a photograph's would take gigabytes in one


def psnr(mean_squared_error: float) -> float:
    """Return the peak signal-to-noise ratio in dB for peak 1, capped at 200."""
    if math.isnan(mean_squared_error):
        return math.nan  # max and min would make the cap of it
    return min(_CAP_DB, -10 * math.log10(max(mean_squared_error, 1e-300)))


def log_encode(image: Tensor) -> Tensor:
    """Return the mu-law encoding of linear `image`; 1 maps to 1, negative values count as 0."""
    return torch.log1p(_MU * image.clamp(min=0)) / math.log1p(_MU)


def relative(error: float, energy: float) -> float | None:
    """Return error / energy; 0 for 0 / 0, None where only the energy is 0."""
    if energy > 0:
        return error / energy
    return 0.0 if error == 0 else None


def _counting(prediction: Tensor, target: Tensor, valid: Tensor, clipped: Tensor) -> tuple[Tensor, Tensor]:
    """Return prediction and target where they count: equal above a clipped value, 0 where nothing was measured."""
    prediction = torch.where(clipped, torch.minimum(prediction, target), prediction)
    if not bool(valid.all()):
        # Chosen, not multiplied: what stands where nothing was measured may be NaN.
        prediction, target = (torch.where(valid, image, torch.zeros_like(image)) for image in (prediction, target))
    return prediction, target


def _sums(prediction: Tensor, target: Tensor, valid: Tensor, clipped: Tensor) -> Tensor:
    """Return squared error, energy, squared display and log error, and count, [5, k], of planes [k, 3, H, W]."""
    prediction, target = _counting(prediction, target, valid, clipped)
    differences = (
        lambda: prediction - target, lambda: target, lambda: colour.display(prediction) - colour.display(target),
        lambda: log_encode(prediction) - log_encode(target),
    )
    found = [difference().square().sum(dim=(1, 2, 3), dtype=torch.float64) for difference in differences]
    return torch.stack([*found, valid.sum(dim=(1, 2, 3), dtype=torch.float64)])


def _sums_by_bands(*planes: Tensor) -> Tensor:
    """Return what `_sums` does, of bands of rows, one after the other."""
    count, _, height, width = planes[0].shape
    rows = max(1, BAND_VALUES // (count * 3 * width))
    bands = [[part[..., top : top + rows, :] for part in planes] for top in range(0, height, rows)]
    return torch.stack([_sums(*band) for band in bands]).sum(dim=0) if len(bands) > 1 else _sums(*planes)


@dataclass
class SampleErrors:
    """Sums per sample, from which every pooled figure and every band is made. Lists grow by `add`."""

    squared: list[Tensor] = field(default_factory=list)
    energy: list[Tensor] = field(default_factory=list)
    display: list[Tensor] = field(default_factory=list)
    log: list[Tensor] = field(default_factory=list)
    count: list[Tensor] = field(default_factory=list)
    ssim: list[Tensor] = field(default_factory=list)
    delta_e: list[Tensor] = field(default_factory=list)

    def add(
        self, prediction: Tensor, target: Tensor, valid: Tensor, clipped: Tensor, perceptual: Tensor,
        window: tuple[slice, slice] = (slice(None), slice(None)),
    ) -> None:
        """Add samples: planes [k, 3, H, W], masks [k, 1 or 3, H, W], and which of the k get SSIM and CIEDE2000.

        Those two are measured in a `window` of rows and columns. What is worked on at a time is bounded, whatever the size.
        """
        planes = (prediction, target, valid.expand_as(target), clipped.expand_as(target))
        sums = fast_errors.sums(prediction, target, valid, clipped)
        sums = _sums_by_bands(*planes) if sums is None else sums
        for found, part in zip((self.squared, self.energy, self.display, self.log, self.count), sums, strict=True):
            found.append(part)
        if bool(perceptual.any()):
            self._add_perceptual(*(part[perceptual][..., window[0], window[1]] for part in planes))

    def _add_perceptual(self, prediction: Tensor, target: Tensor, valid: Tensor, clipped: Tensor) -> None:
        seen = valid.all(dim=1).flatten(1).any(dim=1)
        if not bool(seen.any()):
            return
        prediction, target = _counting(*(part[seen] for part in (prediction, target, valid, clipped)))
        shown, wanted, valid = colour.display(prediction), colour.display(target), valid[seen].all(dim=1)

        def mean(values: Tensor) -> Tensor:
            inside = torch.where(valid, values, torch.zeros_like(values))
            return inside.sum(dim=(1, 2), dtype=torch.float64) / valid.sum(dim=(1, 2))

        if min(shown.shape[-2:]) > _SSIM_WINDOW // 2:
            similarity = part_of("kornia.metrics", "ssim")(shown.float(), wanted.float(), _SSIM_WINDOW)
            self.ssim.append(mean(similarity.mean(dim=1)))
        # Picture by picture: of several at once the many terms of CIEDE2000 leave the processor's cache.
        apart = [colour.ciede2000(*map(colour.srgb_to_lab, pair)) for pair in zip(shown, wanted, strict=True)]
        self.delta_e.append(mean(torch.stack(apart)))

    def pooled(self, chosen: Tensor | None = None) -> dict[str, float | None]:
        """Return mse, relative_error, psnr_db, psnr_log_db over all samples or the `chosen` (bool)."""
        squared, energy, display, log, count = (
            float(torch.cat(part)[... if chosen is None else chosen].sum())
            for part in (self.squared, self.energy, self.display, self.log, self.count)
        )
        count = max(count, 1.0)
        return {
            "mse": squared / count, "relative_error": relative(squared, energy),
            "psnr_db": psnr(display / count), "psnr_log_db": psnr(log / count),
        }

    def relative_error_interval(self) -> list[float] | None:
        """Return the 95 % interval of the relative error over images drawn anew (`ratio_interval`), or None."""
        if not self.squared:
            return None
        found = ratio_interval(torch.cat(self.squared).numpy(), torch.cat(self.energy).numpy())
        return None if found is None else list(found)

    def report(self) -> dict[str, float | None]:
        """Return all six figures."""
        means = {
            name: float(torch.cat(part).mean()) if part else None
            for name, part in (("ssim", self.ssim), ("delta_e", self.delta_e))
        }
        return {**self.pooled(), **means}

    def per_sample_display(self) -> Tensor:
        """Return the mean squared display error of each sample, what `psnr_db` pools."""
        return torch.cat(self.display) / torch.cat(self.count).clamp(min=1)
