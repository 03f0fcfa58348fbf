"""Colour: sRGB against linear, and the colour difference CIEDE2000.

Planes `[..., 3, H, W]`, linear RGB with Rec. 709 primaries and D65 white, as sRGB has.
"""

from __future__ import annotations

import torch
from torch import Tensor


def srgb_to_linear(image: Tensor) -> Tensor:
    """Return linear RGB of sRGB-encoded `image` [..., 3, H, W] (IEC 61966-2-1, through kornia)."""
    from kornia.color import rgb_to_linear_rgb

    return rgb_to_linear_rgb(image)


def linear_to_srgb(image: Tensor) -> Tensor:
    """Return the sRGB encoding of linear `image` [..., 3, H, W] (IEC 61966-2-1, through kornia)."""
    from kornia.color import linear_rgb_to_rgb

    return linear_rgb_to_rgb(image)


def luminance(image: Tensor, dim: int = -3) -> Tensor:
    """Return the Rec. 709 luminance of linear RGB that lies on dimension `dim`, without that dimension."""
    return image.movedim(dim, -1) @ torch.tensor((0.2126, 0.7152, 0.0722), dtype=image.dtype)


def display(image: Tensor) -> Tensor:
    """Clamp linear `image` [..., 3, H, W] to [0, 1] and encode it as sRGB, the form in which people see it."""
    return linear_to_srgb(image.clamp(0, 1))


def srgb_to_lab(image: Tensor) -> Tensor:
    """Return CIE L*a*b* (D65) of sRGB-encoded `image` in [0, 1], planes [..., 3, H, W] (through kornia)."""
    from kornia.color import rgb_to_lab

    return rgb_to_lab(image)


def _hue(a: Tensor, b: Tensor) -> Tensor:
    return torch.rad2deg(torch.atan2(b, a)) % 360.0


def ciede2000(first: Tensor, second: Tensor) -> Tensor:
    """Return the colour difference CIEDE2000 of two Lab images [..., 3, H, W] as [..., H, W].

    Sharma, Wu, Dalal 2005, "The CIEDE2000 color-difference formula", with kL = kC = kH = 1; the tests hold it
    to the 34 pairs that the article tabulates. No dependency of the package has it.
    """
    lightness_1, a_1, b_1 = first.unbind(-3)
    lightness_2, a_2, b_2 = second.unbind(-3)
    mean_chroma = (torch.hypot(a_1, b_1) + torch.hypot(a_2, b_2)) / 2
    seventh = mean_chroma**7
    stretch = 1.5 - 0.5 * torch.sqrt(seventh / (seventh + 25.0**7))
    a_1, a_2 = a_1 * stretch, a_2 * stretch
    chroma_1, chroma_2 = torch.hypot(a_1, b_1), torch.hypot(a_2, b_2)
    grey = chroma_1 * chroma_2 == 0
    hue_1, hue_2 = _hue(a_1, b_1), _hue(a_2, b_2)

    turn = hue_2 - hue_1
    turn = torch.where(turn > 180, turn - 360, torch.where(turn < -180, turn + 360, turn))
    turn = torch.where(grey, torch.zeros_like(turn), turn)
    hue_term = 2 * torch.sqrt(chroma_1 * chroma_2) * torch.sin(torch.deg2rad(turn) / 2)

    total, apart = hue_1 + hue_2, (hue_1 - hue_2).abs() > 180
    mean_hue = torch.where(apart, torch.where(total < 360, total + 360, total - 360), total) / 2
    mean_hue = torch.where(grey, total, mean_hue)
    return _weighted_difference(
        (lightness_1 + lightness_2) / 2, (chroma_1 + chroma_2) / 2, mean_hue,
        lightness_2 - lightness_1, chroma_2 - chroma_1, hue_term,
    )


def _weighted_difference(
    lightness: Tensor, chroma: Tensor, hue: Tensor, d_lightness: Tensor, d_chroma: Tensor, d_hue: Tensor
) -> Tensor:
    def cosine(degrees: Tensor) -> Tensor:
        return torch.cos(torch.deg2rad(degrees))

    t = (
        1
        - 0.17 * cosine(hue - 30)
        + 0.24 * cosine(2 * hue)
        + 0.32 * cosine(3 * hue + 6)
        - 0.20 * cosine(4 * hue - 63)
    )
    squared = (lightness - 50) ** 2
    lightness_weight = 1 + 0.015 * squared / torch.sqrt(20 + squared)
    chroma_weight = 1 + 0.045 * chroma
    hue_weight = 1 + 0.015 * chroma * t
    seventh = chroma**7
    turn = torch.sin(torch.deg2rad(60 * torch.exp(-(((hue - 275) / 25) ** 2))))
    rotation = -2 * torch.sqrt(seventh / (seventh + 25.0**7)) * turn
    l_term, c_term, h_term = d_lightness / lightness_weight, d_chroma / chroma_weight, d_hue / hue_weight
    total = l_term**2 + c_term**2 + h_term**2 + rotation * c_term * h_term
    return torch.sqrt(total.clamp(min=0))
