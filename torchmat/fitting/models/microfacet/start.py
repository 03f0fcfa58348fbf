"""Lobes to begin with: over a grid of roughness, diffuse and F0 of each texel in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat.fitting.models.distribution.start import find_starts
from torchmat.fitting.objective import DISPLAY_POWER, power
from torchmat.fitting.relief.surface import Surface, ambient_and_usual
from torchmat.frames import tangent_frame
from torchmat.geometry import normals_from_slopes
from torchmat.models.base import combine
from torchmat.models.ggx import ggx_share, schlick_rise, squared_alpha
from torchmat.repeatable import one_thread

ROUGHNESS = (0.16, 0.25, 0.35, 0.45, 0.56, 0.7, 0.85)  # roots of alpha that are tried
_SHARPER = (0.05, 0.08, 0.11)  # where samples lie dense enough to say so
_RATIOS = (1.0, 1.5, 2.2)  # of the roughness along over that across, where a surface may be brushed
_SEEN = 400  # samples that say which fits
_VALUES = 400_000
_TOGETHER = 0.5  # what the error of all texels counts beside a texel's own: few samples do not tell how rough one is
_GRAZING = 1e-4
_UNSEEN, _FEW = 0.05, 0.4  # of a lobe's share: F0 that only smaller ones speak of, or one sample, is drawn to 0


@dataclass(frozen=True)
class Start:
    """What each texel begins with, [C, H, W]: the normal is the whole one, of `roughness` there are two, along and across."""

    diffuse: Tensor
    specular_f0: Tensor
    roughness: Tensor
    rotation: Tensor
    normal: Tensor
    ambient: Tensor


def find_start(surface: Surface, level: float, on_relief: bool, turned: bool) -> Start:
    """Return the lobes that fit best of a grid of roughness, round or, `turned`, stretched along each texel's direction.

    Errors are weighed by the slope of the display root, as the fit sees them.
    """
    known = find_starts(surface, level)
    normal, angle = normals_from_slopes(known["slopes"]), known["rotation"]
    rotation = torch.cat((torch.cos(angle), torch.sin(angle)))
    ambient = ambient_and_usual(surface)[0] if on_relief else torch.zeros_like(known["mean"])
    roots = ROUGHNESS if surface.training.btf.height * surface.training.btf.width > 1 else (*_SHARPER, *ROUGHNESS)
    pairs = torch.tensor(
        [(min(1.0, r * k**0.5), r / k**0.5) for r in roots for k in (_RATIOS if turned else (1.0,))], dtype=normal.dtype
    )
    columns, products, squares = _sums(surface, level, _frame(normal, rotation), ambient, pairs)
    with one_thread():
        diffuse, f0, errors = _solved(columns, products, squares)
        best = (errors + _TOGETHER * errors.mean(dim=(1, 2), keepdim=True)).argmin(dim=0, keepdim=True)
    chosen = best[:, None].expand(1, 3, *best.shape[1:])
    diffuse, f0 = (maps.gather(0, chosen)[0].clamp(min=1e-3 * level) for maps in (diffuse, f0))
    roughness = pairs[best[0]].movedim(-1, 0).contiguous()
    return Start(diffuse, f0, roughness, rotation, normal, ambient.clamp(min=1e-4 * level))


def _frame(normal: Tensor, rotation: Tensor) -> Tensor:
    tangent, bitangent = tangent_frame(normal)
    cosine, sine = rotation.split(1)
    return torch.stack((cosine * tangent + sine * bitangent, cosine * bitangent - sine * tangent, normal), dim=1)


def _sums(surface: Surface, level: float, frame: Tensor, ambient: Tensor, pairs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the weighed sums of normal equations in diffuse and F0, for each pair of roughness.

    Products of the two columns [pair, 3, H, W] (of the first, both, the second), of columns with what Fresnel's rise
    leaves of the values [2, pair, 3, H, W], and that squared, [pair, H, W].
    """
    btf, dtype = surface.training.btf, surface.training.dtype
    size, count = (btf.height, btf.width), len(pairs)
    columns, products = torch.zeros(count, 3, *size, dtype=dtype), torch.zeros(2, count, 3, *size, dtype=dtype)
    squares = torch.zeros(count, *size, dtype=dtype)
    alphas, grazing = squared_alpha(pairs)[:, :, None, None], min(1.0, 50 * level)  # of dim data F90 is less too
    rows = torch.linspace(0, len(btf) - 1, min(_SEEN, len(btf))).round().long()
    unseen = _UNSEEN**2 + _FEW**2 / len(rows)
    for some in rows.split(max(1, _VALUES // (3 * btf.height * btf.width))):
        values, weight = surface.values(some)
        light, view = btf.directions(some, dtype)
        total = light + view
        squared = (total * total).sum(dim=1, keepdim=True).clamp(min=1e-12)
        rise = schlick_rise((1 - squared.sqrt() / 2).clamp(min=0))
        light, view = combine(light, frame), combine(view, frame)
        half, lit = (light + view) * squared.rsqrt(), surface.lit[btf.light_index[some]]
        weight = weight * power(values.mean(dim=1, keepdim=True).clamp(min=0) + 0.01 * level, 2 * (DISPLAY_POWER - 1))
        first = lit * light[:, 2:3].clamp(min=0)
        for number in range(count):
            share = lit * ggx_share(light, view, half, alphas[number], _GRAZING)
            second, left = share * (1 - rise), values - ambient - share * (grazing * rise)
            seen = second * second + unseen  # a lobe that is hardly looked into says nothing of its height
            columns[number] += (weight * torch.cat((first * first, first * second, seen), dim=1)).sum(dim=0)
            products[0, number] += (weight * first * left).sum(dim=0)
            products[1, number] += (weight * second * left).sum(dim=0)
            squares[number] += (weight * left * left).sum(dim=(0, 1))
    return columns, products, squares


def _solved(columns: Tensor, products: Tensor, squares: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return diffuse and F0 [pair, 3, H, W], neither negative, and what is left of the squares, [pair, H, W]."""
    one, both, other = (columns[:, k : k + 1] for k in range(3))
    one, other = (c * (1 + 1e-4) + 1e-12 for c in (one, other))
    first, second = products
    determinant = (one * other - both * both).clamp(min=1e-20)
    diffuse, f0 = (first * other - second * both) / determinant, (second * one - first * both) / determinant
    # Of two unknowns that may not be negative, the one that is stays at 0 and the other is solved alone.
    none, alone = (diffuse < 0), (f0 < 0)
    diffuse = torch.where(alone, (first / one).clamp(min=0), diffuse.clamp(min=0))
    f0 = torch.where(none, (second / other).clamp(min=0), f0.clamp(min=0))
    left = one * diffuse**2 + 2 * both * diffuse * f0 + other * f0**2 - 2 * (diffuse * first + f0 * second)
    return diffuse, f0, (squares + left.sum(dim=1)).clamp(min=0)
