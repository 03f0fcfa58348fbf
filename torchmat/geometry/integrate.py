"""Slopes to height: in one step by Fourier transform, or by weighted least squares where data is missing or doubtful."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torchmat.errors import RangeError, ShapeError, check_finite, message
from torchmat.geometry.mask import check_mask, flat_outside, neighbours, piece_means, pieces

TOLERANCE = 1e-5  # of the right-hand side's norm: far below what any slope is known to
_MOST_STEPS = 200
_MOST_INSIDE = 1000  # within a mask, whose form costs some more: a cat takes 180
_TRACE = 1e-3  # of the largest weight, kept everywhere: it is what makes holes smooth, and the system solvable


def _check(where: str, slopes: Tensor) -> None:
    if slopes.ndim != 3 or slopes.shape[0] != 2 or 0 in slopes.shape:
        raise ShapeError(message(where, "slopes", "be [2, H, W]", f"they are {tuple(slopes.shape)}"))
    check_finite(where, "slopes", slopes, "Give those texels weight 0 and a slope of 0.")


def _frequencies(height: int, width: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Return angular frequencies a texel along x (right) and y (up)."""
    across = torch.fft.fftfreq(width, dtype=dtype) * 2 * math.pi
    down = torch.fft.fftfreq(height, dtype=dtype) * 2 * math.pi
    return across[None, :].expand(height, width), -down[:, None].expand(height, width)


def frankot_chellappa(slopes: Tensor, tiles: bool = True) -> Tensor:
    """Return the height [1, H, W], in texture widths and with mean 0, whose slopes are nearest to `slopes` [2, H, W].

    Frankot and Chellappa 1988: a division in the Fourier domain. A map that does not tile is mirrored first, which
    makes it periodic without a step at its borders.
    """
    _check("frankot_chellappa", slopes)
    height, width = slopes.shape[-2:]
    x, y = slopes.double() / width  # rise a texel
    if not tiles:
        x = torch.cat((x, -x.flip(1)), dim=1)
        x = torch.cat((x, x.flip(0)), dim=0)
        y = torch.cat((y, y.flip(1)), dim=1)
        y = torch.cat((y, -y.flip(0)), dim=0)
    across, up = _frequencies(x.shape[0], x.shape[1], x.dtype)
    power = across**2 + up**2
    power[0, 0] = 1
    spectrum = -1j * (across * torch.fft.fft2(x) + up * torch.fft.fft2(y)) / power
    spectrum[0, 0] = 0
    found = torch.fft.ifft2(spectrum).real[:height, :width]
    return (found - found.mean())[None].to(slopes.dtype)


def _differences(height: Tensor, tiles: bool) -> Tensor:
    """Return the rise from each texel to its right and to its upper neighbour, [2, H, W]; 0 across an open border."""
    right = height.roll(-1, 1) - height
    up = height.roll(1, 0) - height
    if not tiles:
        right[:, -1], up[0, :] = 0, 0
    return torch.stack((right, up))


def _adjoint(edges: Tensor, tiles: bool) -> Tensor:
    right, up = edges[0].clone(), edges[1].clone()
    if not tiles:
        right[:, -1], up[0, :] = 0, 0
    return right.roll(1, 1) - right + up.roll(-1, 0) - up


def poisson(
    slopes: Tensor, weight: Tensor | None = None, tiles: bool = True, anchor: Tensor | None = None,
    anchor_weight: Tensor | None = None, mask: Tensor | None = None,
) -> Tensor:
    """Return the height [1, H, W], in texture widths, of weighted least-squares distance to `slopes`.

    `weight` [1, H, W] >= 0 says how far each texel's slopes are trusted: 0 for holes, which are bridged as
    smoothly as the rest allows. Slopes leave the mean open: it is 0, unless `anchor` [1, H, W] gives heights known from
    elsewhere, of `anchor_weight` [1, H, W] >= 0; both weights are inverse variances, of a slope and of a height.
    Conjugate gradients, preconditioned by the solution for equal weights (Frankot-Chellappa's).

    Of a `mask`, bool [H, W], only what is inside is integrated, and its border is free. Pieces that do not touch have a mean
    of their own: no slope says how they stand to each other. Outside the height is that of the border's lowest texel.
    """
    _check("poisson", slopes)
    inside = None if mask is None else check_mask("poisson", mask, (slopes.shape[-2], slopes.shape[-1]))
    trust = _weight("weight", weight, slopes.shape[-2:], inside)
    most = trust.max()
    share, edge = _edges(slopes, trust, most)
    # An edge that leaves the object is no equation: the border is free.
    share = share if inside is None else share * torch.stack(neighbours(inside, tiles))
    known = pull = None
    if anchor is not None:
        known = _map("anchor", anchor, slopes.shape[-2:])
        # A slope is a rise a texel times the width: its inverse variance shrinks by the width squared.
        pull = _weight("anchor_weight", anchor_weight, slopes.shape[-2:], inside) / (most * slopes.shape[-1] ** 2)
    if inside is None:
        return _whole(share, edge, tiles, known, pull)[None].to(slopes.dtype)
    return flat_outside(_inside(share, edge, tiles, known, pull, inside), inside, tiles)[None].to(slopes.dtype)


def _edges(slopes: Tensor, trust: Tensor, most: Tensor) -> tuple[Tensor, Tensor]:
    """Return what each edge to the right and upward counts, and the rise over it, [2, H, W] both."""
    # What a hole holds is no slope: there the surface is to be as flat as the rest allows.
    rise = torch.where(trust > 0, slopes.double() / slopes.shape[-1], torch.zeros((), dtype=torch.float64))
    trust = trust / most + _TRACE
    # Each edge takes the mean of its two texels' slopes, and the smaller trust.
    edge = torch.stack((rise[0] + rise[0].roll(-1, 1), rise[1] + rise[1].roll(1, 0))) / 2
    return torch.stack((torch.minimum(trust, trust.roll(-1, 1)), torch.minimum(trust, trust.roll(1, 0)))), edge


def _whole(share: Tensor, edge: Tensor, tiles: bool, known: Tensor | None, pull: Tensor | None) -> Tensor:
    """Return the height [H, W] whose rises [2, H, W] over edges that count their `share` are nearest to those of `edge`."""
    right = _adjoint(share * edge, tiles)
    size = right.shape
    if known is None or pull is None:
        precondition = _laplace_inverse(tiles, *size)
        found = _conjugate_gradients(
            lambda h: _adjoint(share * _differences(h, tiles), tiles), right - right.mean(), precondition
        )
        return found - found.mean()
    total = pull.sum()
    known = torch.where(pull > 0, known, (pull * known).sum() / total)

    def apply(height: Tensor) -> Tensor:
        return _adjoint(share * _differences(height, tiles), tiles) + pull * height

    precondition = _laplace_inverse(tiles, size[0], size[1], float(pull.mean() / share.mean()))
    found = known + _conjugate_gradients(apply, right + pull * known - apply(known), precondition)
    # The mean costs no slope: where the anchor is weak it hardly shows in the residual, so it is solved for by itself.
    return found + (pull * (known - found)).sum() / total


def _inside(
    share: Tensor, edge: Tensor, tiles: bool, known: Tensor | None, pull: Tensor | None, inside: Tensor
) -> Tensor:
    """Return what `_whole` does for the texels inside a mask alone, 0 outside.

    The inverse for the whole rectangle preconditions that of the part: its values inside are the inverse of the least energy
    that any continuation has, and that is at most a constant, of the mask's form alone, times the energy inside.
    """
    size, piece = inside.shape, pieces(inside, tiles)
    zero = torch.zeros((), dtype=torch.float64)
    pull = torch.zeros(size, dtype=torch.float64) if pull is None else pull
    start = torch.zeros(size, dtype=torch.float64)
    if known is not None:
        start[inside] = piece_means(known[inside], piece, pull[inside])
        start = torch.where(inside & (pull > 0), known, start)

    def apply(height: Tensor) -> Tensor:
        return _adjoint(share * _differences(height, tiles), tiles) + pull * height

    right = _adjoint(share * edge, tiles) + pull * start - apply(start)
    inverse = _laplace_inverse if tiles else _cosine_inverse
    whole = inverse(tiles, size[0], size[1], float(pull[inside].mean() / share.mean()))
    found = start + _conjugate_gradients(apply, right, lambda values: torch.where(inside, whole(values), zero), _MOST_INSIDE)
    found[inside] += piece_means(start[inside] - found[inside], piece, None if known is None else pull[inside])
    return found


def _map(name: str, values: Tensor, size: torch.Size) -> Tensor:
    if values.shape not in (size, (1, *size)):
        raise ShapeError(message("poisson", name, f"be [1, {size[0]}, {size[1]}]", f"it is {tuple(values.shape)}"))
    check_finite("poisson", name, values)
    return values.double().reshape(size)


def _weight(name: str, weight: Tensor | None, size: torch.Size, inside: Tensor | None) -> Tensor:
    trust = torch.ones(size, dtype=torch.float64) if weight is None else _map(name, weight, size)
    trust = trust if inside is None else trust * inside
    if bool((trust < 0).any()) or not bool((trust > 0).any()):
        fact = "some are negative" if bool((trust < 0).any()) else "all are 0"
        raise RangeError(message("poisson", name, "be >= 0 and somewhere positive", fact))
    return trust


def _laplace_inverse(tiles: bool, height: int, width: int, pull: float = 0.0) -> Callable[[Tensor], Tensor]:
    """Return a function that solves the problem of equal weights with the edges of `_differences`."""
    rows, columns = (height, width) if tiles else (2 * height, 2 * width)
    across, up = _frequencies(rows, columns, torch.float64)
    power = (2 - 2 * torch.cos(across)) + (2 - 2 * torch.cos(up)) + pull
    if pull == 0:
        power[0, 0] = torch.inf  # the mean stays 0

    def solve(right: Tensor) -> Tensor:
        if not tiles:
            right = torch.cat((right, right.flip(1)), dim=1)
            right = torch.cat((right, right.flip(0)), dim=0)
        return torch.fft.ifft2(torch.fft.fft2(right) / power).real[:height, :width]

    return solve


def _cosine_inverse(tiles: bool, height: int, width: int, pull: float = 0.0) -> Callable[[Tensor], Tensor]:
    """Return what `_laplace_inverse` does for what does not tile, by a cosine transform: a fifth of the mirrored one's time."""
    from scipy.fft import dctn, idctn

    down, across = (2 - 2 * torch.cos(math.pi * torch.arange(n, dtype=torch.float64) / n) for n in (height, width))
    power = down[:, None] + across + pull
    if pull == 0:
        power[0, 0] = torch.inf
    known = power.numpy()
    return lambda right: torch.from_numpy(idctn(dctn(right.numpy()) / known))


def _conjugate_gradients(
    apply: Callable[[Tensor], Tensor], right: Tensor, precondition: Callable[[Tensor], Tensor], most: int = _MOST_STEPS
) -> Tensor:
    found = torch.zeros_like(right)
    residual = right.clone()
    step = precondition(residual)
    energy = (residual * step).sum()
    for _ in range(most):
        if float(residual.norm()) <= TOLERANCE * float(right.norm()) or float(energy) <= 0:
            break
        moved = apply(step)
        length = energy / (step * moved).sum().clamp(min=1e-300)
        found = found + length * step
        residual = residual - length * moved
        turned = precondition(residual)
        fresh = (residual * turned).sum()
        step = turned + (fresh / energy) * step
        energy = fresh
    return found
