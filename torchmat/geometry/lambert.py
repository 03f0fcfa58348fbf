"""How far Lambert's law explains photographs of one view: a residual that shows wrong lights, and how bright the lights
were where nobody wrote it down."""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat.geometry.photometric_stereo import Stereo, shading_weights

_DARK = 0.1  # of the bright texels: below it a texel says nothing but noise
_TEXELS = 512  # are enough for one number a light
_TURNS = 4  # of weights and intensities


def lambert_residual(images: Tensor, light: Tensor, found: Stereo) -> float:
    """Return the median over texels of the median over photographs of what Lambert's law leaves, in parts of the mean value.

    `images` [n, 3, H, W] and `light` [n, 3], or [n, 3, H, W] of near lights, are those that photometric stereo `found` normals and albedo of. 0 is a matte
    surface; medians leave shadow and highlight aside, so that cloth, leather and stone give 0.01 to 0.1, and lights dealt
    out wrongly 0.3 to 0.6. Dark texels, where there is but noise, do not count.
    """
    grey = images.mean(dim=1)
    light, normal = light.to(images.dtype), found.normal.to(images.dtype)
    shading = (light * normal).sum(dim=1) if light.ndim == 4 else torch.einsum("nk,khw->nhw", light, normal)
    shading = shading.clamp(min=0)
    gaps = (grey - found.albedo.to(images.dtype).mean(dim=0) * shading).abs().median(dim=0).values.flatten()
    mean = grey.mean(dim=0).flatten()
    bright = (mean > 0) & (mean >= _DARK * _ninetieth(mean))
    return float((gaps[bright] / mean[bright]).median()) if bool(bright.any()) else 0.0


def _ninetieth(values: Tensor) -> Tensor:
    return values.sort().values[int(0.9 * (len(values) - 1))]


def estimate_intensities(images: Tensor, light: Tensor, weight: Tensor | None = None) -> Tensor | None:
    """Return the relative intensities [n, 3] of the lights, of mean 1 in each channel, that fit a matte surface best.

    For images [n, 3, H, W] under lights [n, 3], or [n, 3, H, W] of near ones, of unknown brightness. With q = 1 / intensity, ``q_i I_ti = light_i . g_t``
    is linear in q and the scaled normals g: g is eliminated texel by texel, and q is the eigenvector of the least
    eigenvalue. Robust photometric stereo says which samples count, in turn with q. Needs at least 4 lights in general
    position; None where no positive intensities fit. The brightness of all together is not determined.
    """
    values = images.flatten(2).permute(2, 0, 1).double()  # [t, n, 3]
    given = torch.ones_like(values[..., 0]) if weight is None else weight.flatten(1).T.double()
    typical = values.mean(dim=(1, 2))
    chosen = ((typical > 0) & (typical >= _DARK * _ninetieth(typical))).nonzero()[:, 0]
    if not len(chosen):
        return None
    chosen = chosen[torch.linspace(0, len(chosen) - 1, min(len(chosen), _TEXELS)).round().long()]
    light = light.flatten(2).permute(2, 0, 1)[chosen] if light.ndim == 4 else light
    values, given, light = values[chosen] / typical[chosen, None, None], given[chosen], light.double()
    grey = values.mean(dim=2)
    intensity = torch.ones(len(images), dtype=torch.float64)
    for _ in range(_TURNS):
        trust = shading_weights(grey / intensity, light, given)
        found = _fitting(grey, light, trust)
        if found is None:
            return None
        intensity = found
    channels = [one for one in (_fitting(values[..., c], light, trust) for c in range(3)) if one is not None]
    return torch.stack(channels, dim=1) if len(channels) == 3 else None


def _fitting(values: Tensor, light: Tensor, trust: Tensor) -> Tensor | None:
    """Return intensities [n] of mean 1 whose inverse q minimises the sum over texels of trust (q I - light . g)^2 over all g."""
    root, count = trust.sqrt(), trust.shape[1]
    total = torch.zeros(count, count, dtype=torch.float64)
    for part in torch.arange(len(values)).split(max(1, 4_000_000 // count)):
        basis, _ = torch.linalg.qr(root[part][:, :, None] * (light[part] if light.ndim == 3 else light))  # [t, n, 3]
        scaled = root[part] * values[part]
        along = (scaled[:, :, None] * basis).permute(1, 0, 2).flatten(1)
        total += torch.diag(scaled.square().sum(dim=0)) - along @ along.T
    # In parts of each light's own energy, or a light that is mostly shadow would take all.
    energy = (trust * values.square()).sum(dim=0).sqrt()
    if not bool((energy > 0).all()):
        return None
    _, vectors = torch.linalg.eigh(total / energy[:, None] / energy)
    inverse = vectors[:, 0] / energy
    inverse = inverse * inverse.sum().sign()
    if not bool((inverse > 0).all()):
        return None
    return (1 / inverse) / (1 / inverse).mean()
