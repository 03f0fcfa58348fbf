"""Colour: sRGB against linear, and the colour difference CIEDE2000.

Planes `[..., 3, H, W]`, linear RGB with Rec. 709 primaries and D65 white, as sRGB has.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd import forward_ad

from torchmat import safe
from torchmat.parts_of import part_of

_VIVID = 1e4  # times 25: from there on colours are as vivid as can be, and powers would overflow


def srgb_to_linear(image: Tensor) -> Tensor:
    """Return linear RGB of sRGB-encoded `image` [..., 3, H, W] (IEC 61966-2-1, through kornia)."""
    return part_of("kornia.color", "rgb_to_linear_rgb")(image)


def linear_to_srgb(image: Tensor) -> Tensor:
    """Return the sRGB encoding of linear `image` [..., 3, H, W] (IEC 61966-2-1, through kornia)."""
    return part_of("kornia.color", "linear_rgb_to_rgb")(image)


def luminance(image: Tensor, dim: int = -3) -> Tensor:
    """Return the Rec. 709 luminance of linear RGB that lies on dimension `dim`, without that dimension."""
    return image.movedim(dim, -1) @ torch.tensor((0.2126, 0.7152, 0.0722), dtype=image.dtype)


def display(image: Tensor) -> Tensor:
    """Clamp linear `image` [..., 3, H, W] to [0, 1] and encode it as sRGB, the form in which people see it."""
    return linear_to_srgb(image.clamp(0, 1))


def srgb_to_lab(image: Tensor) -> Tensor:
    """Return CIE L*a*b* (D65) of sRGB-encoded `image` in [0, 1], planes [..., 3, H, W] (through kornia)."""
    return part_of("kornia.color", "rgb_to_lab")(image)


def _differentiated(*tensors: Tensor) -> bool:
    """Return whether gradients or tangents may be asked of what is made of tensors."""
    recorded = torch.is_grad_enabled() and any(one.requires_grad for one in tensors)
    return recorded or torch._C._are_functorch_transforms_active() or any(forward_ad.unpack_dual(one).tangent is not None for one in tensors)


def _hue(a: Tensor, b: Tensor, differentiated: bool) -> Tensor:
    """Return the hue in degrees, [0, 360); 0 with gradient 0 where there is none."""
    if not differentiated:
        return torch.rad2deg(torch.atan2(b, a + 0.0)).remainder_(360.0)  # + 0.0 turns -0.0 into 0.0, which is no direction
    size = torch.maximum(a.abs(), b.abs()).detach()
    a, b = safe.divide(a, size), safe.divide(b, size)  # the derivative divides by a^2 + b^2, which underflows
    grey = (a == 0) & (b == 0)
    return torch.rad2deg(torch.atan2(b, torch.where(grey, torch.ones_like(a), a))) % 360.0


def _chroma(a: Tensor, b: Tensor, differentiated: bool) -> Tensor:
    """Return the distance from grey, with gradient 0 at grey."""
    if not differentiated:
        return torch.hypot(a, b)
    size = torch.maximum(a.abs(), b.abs()).detach()
    a, b = safe.divide(a, size), safe.divide(b, size)
    return size * safe.sqrt(a * a + b * b)


def _vivid(chroma: Tensor, differentiated: bool) -> Tensor:
    """Return sqrt(C^7 / (C^7 + 25^7)) with powers of at most 1, which cannot overflow."""
    if not differentiated:
        share = (chroma / 25).clamp_(max=_VIVID)
        square = share * share
        power = share.mul_(square).mul_(square.mul_(square))  # a power of 7 by itself takes as long as all the rest
        return power.div_(1 + power).sqrt_()
    low, high = (chroma / 25).clamp(max=1), safe.divide(25 * torch.ones_like(chroma), chroma.clamp(min=25))
    # The root is taken factor by factor: that of C^7 has an infinite derivative where C^7 underflows.
    return torch.where(chroma < 25, low**3 * safe.sqrt(low) / torch.sqrt(1 + low**7), 1 / torch.sqrt(1 + high**7))


def _root(x: Tensor) -> Tensor:
    return x.clamp(min=0).sqrt_()


def ciede2000(first: Tensor, second: Tensor) -> Tensor:
    """Return the colour difference CIEDE2000 of two Lab images [..., 3, H, W] as [..., H, W].

    Sharma, Wu, Dalal 2005, "The CIEDE2000 color-difference formula", with kL = kC = kH = 1; the tests hold it
    to the 34 pairs that the article tabulates. No dependency of the package has it.
    """
    differentiated = _differentiated(first, second)
    root = safe.sqrt if differentiated else _root
    lightness_1, a_1, b_1 = first.unbind(-3)
    lightness_2, a_2, b_2 = second.unbind(-3)
    stretch = 1.5 - 0.5 * _vivid((_chroma(a_1, b_1, differentiated) + _chroma(a_2, b_2, differentiated)) / 2, differentiated)
    a_1, a_2 = a_1 * stretch, a_2 * stretch
    chroma_1, chroma_2 = _chroma(a_1, b_1, differentiated), _chroma(a_2, b_2, differentiated)
    grey = (chroma_1 == 0) | (chroma_2 == 0)  # their product would underflow to 0 where neither is
    hue_1, hue_2 = _hue(a_1, b_1, differentiated), _hue(a_2, b_2, differentiated)

    turn = hue_2 - hue_1
    turn = torch.where(turn > 180, turn - 360, torch.where(turn < -180, turn + 360, turn))
    turn = torch.where(grey, torch.zeros_like(turn), turn)
    hue_term = 2 * root(chroma_1) * root(chroma_2) * torch.sin(torch.deg2rad(turn) / 2)

    total, apart = hue_1 + hue_2, (hue_1 - hue_2).abs() > 180
    mean_hue = torch.where(apart, torch.where(total < 360, total + 360, total - 360), total) / 2
    mean_hue = torch.where(grey, total, mean_hue)
    return _weighted_difference(
        (lightness_1 + lightness_2) / 2, (chroma_1 + chroma_2) / 2, mean_hue,
        lightness_2 - lightness_1, chroma_2 - chroma_1, hue_term, differentiated,
    )


def _weighted_difference(
    lightness: Tensor, chroma: Tensor, hue: Tensor, d_lightness: Tensor, d_chroma: Tensor, d_hue: Tensor,
    differentiated: bool,
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
    turn = torch.sin(torch.deg2rad(60 * torch.exp(-(((hue - 275) / 25) ** 2))))
    rotation = -2 * _vivid(chroma, differentiated) * turn
    l_term, c_term, h_term = d_lightness / lightness_weight, d_chroma / chroma_weight, d_hue / hue_weight
    total = l_term**2 + c_term**2 + h_term**2 + rotation * c_term * h_term
    return safe.sqrt(total) if differentiated else _root(total)
