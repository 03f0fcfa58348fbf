"""Structural similarity (SSIM) of pictures, Wang et al. 2004: window 11, Gaussian of 1.5, reflected borders, peak 1."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import conv2d, pad

WINDOW = 11
_SIGMA = 1.5
_MEANS, _SPREADS = 0.01**2, 0.03**2  # what keeps dark and flat windows from dividing by nothing
_EPS = 1e-12  # kornia's, whose figures these are: the tests hold them to it


class Moments(NamedTuple):
    """Pictures [k, C, H, W], each value's mean within its window, the square of that, and the variance there."""

    image: Tensor
    mean: Tensor
    squared: Tensor
    variance: Tensor


def moments(image: Tensor) -> Moments:
    """Return what `similarity` needs of pictures [k, C, H, W], float32, of at least 6 texels on a side; no gradients."""
    image = image.detach().contiguous(memory_format=torch.channels_last)  # else each convolution copies it
    mean = _blurred(image)
    squared = mean**2
    return Moments(image, mean, squared, _blurred(image**2).sub_(squared))


def similarity(first: Moments, second: Moments) -> Tensor:
    """Return the similarity [k, C, H, W] of pictures, from -1 to 1, where they are alike."""
    product = first.mean * second.mean
    covariance = _blurred(first.image * second.image).sub_(product)
    apart = (first.squared + second.squared).add_(_MEANS).mul_((first.variance + second.variance).add_(_SPREADS))
    alike = product.mul_(2.0).add_(_MEANS).mul_(covariance.mul_(2.0).add_(_SPREADS))
    return alike.div_(apart.add_(_EPS)).contiguous()


def _blurred(image: Tensor) -> Tensor:
    channels, radius = image.shape[1], WINDOW // 2
    offset = torch.arange(WINDOW, dtype=image.dtype) - radius
    window = torch.exp(-(offset**2) / (2 * _SIGMA**2))
    window = window / window.sum()
    across = conv2d(pad(image, [radius, radius, 0, 0], mode="reflect"), window.view(1, 1, 1, -1).expand(channels, 1, 1, -1), groups=channels)
    return conv2d(pad(across, [0, 0, radius, radius], mode="reflect"), window.view(1, 1, -1, 1).expand(channels, 1, -1, 1), groups=channels)
