"""What samples tell of each texel's ways, and the covariance that their noise leaves them with.

Least squares solve ``sum of G^T (J x - y) = 0``, with G = J but for maps that are found from luminance alone. Noise of covariance
N between the colours then gives x the covariance ``B^-1 M B^-T`` with ``B = sum of G^T J`` and ``M = sum of G^T N G``: for maps of
one colour, s^2 (sum of J^T J)^-1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat.fitting.certainty.jacobian import Jacobian
from torchmat.fitting.certainty.observed import Observed
from torchmat.repeatable import one_thread

_LUMINANCE = (0.2126, 0.7152, 0.0722)  # Rec. 709, as `colour.luminance`
_VALUES = 6_000_000  # of derivatives at a time


@dataclass(frozen=True)
class Noise:
    """Residuals at each texel: `covariance` [texel, 3, 3] of the colours, `freedom` [texel, 3], `squares` and `count` in sum."""

    covariance: Tensor
    freedom: Tensor
    squares: Tensor
    count: Tensor


def noise_of(observed: Observed, rows: Tensor, jacobian: Jacobian, whole: float) -> Noise:
    """Return the noise that the residuals of samples `rows` show, of which the fit saw `whole` times as many."""
    texels = observed.btf.height * observed.btf.width
    products = torch.zeros(3, 3, texels, dtype=torch.float64)
    count = torch.zeros(texels, dtype=torch.float64)
    for part in rows.split(max(1, _VALUES // (3 * texels))):
        some = observed.some(part)
        with torch.no_grad():
            gap = observed.residual(dict(observed.flat.maps.items()), some).double().flatten(2)
        products += torch.einsum("nat,nbt->abt", gap, gap)
        count += some.weight.double().sum(dim=0).flatten()
    known = torch.tensor([sum(1 / len(each) for each in jacobian.colours if colour in each) for colour in range(3)]).double()
    freedom = (whole * count[:, None] - known).clamp(min=1)
    root = freedom.sqrt()
    covariance = whole * products.permute(2, 0, 1) / (root[:, :, None] * root[:, None, :])
    return Noise(covariance, freedom, whole * products.diagonal().sum(dim=0), freedom.sum(dim=0))


def covariance_of(
    observed: Observed, rows: Tensor, jacobian: Jacobian, noise: Noise, whole: float, by_luminance: Sequence[str] = ()
) -> list[tuple[list[int], Tensor]]:
    """Return the covariance [texel, k, k] of each block of ways, with their numbers; no variance exceeds the square of a span."""
    blocks = [_Block(numbers, colours, jacobian, noise, by_luminance) for numbers, colours in blocks_of(jacobian, by_luminance)]
    texels = observed.btf.height * observed.btf.width
    for part in rows.split(max(1, _VALUES // (3 * len(jacobian.ways) * texels))):
        slope = jacobian.of(observed, observed.some(part)).flatten(3)  # [n, 3, way, texel]
        for block in blocks:
            block.add(slope)
    return [(block.numbers, block.covariance(whole)) for block in blocks]


def blocks_of(jacobian: Jacobian, by_luminance: Sequence[str] = ()) -> list[tuple[list[int], list[int]]]:
    """Return ways that share colours, by their numbers, and those colours: each block is solved by itself."""
    every = list(range(len(jacobian.ways)))
    if any(len(each) != 1 for each in jacobian.colours) or any(jacobian.ways[number].name in by_luminance for number in every):
        return [(every, [0, 1, 2])]
    blocks = [([number for number in every if jacobian.colours[number] == (colour,)], [colour]) for colour in range(3)]
    return [block for block in blocks if block[0]]


class _Block:
    """The sums of G^T J, G^T N G and J^T J over samples, [texel, k, k] each, of ways that share colours."""

    def __init__(
        self, numbers: list[int], colours: list[int], jacobian: Jacobian, noise: Noise, by_luminance: Sequence[str]
    ) -> None:
        self.numbers, self.colours = numbers, colours
        self._span = torch.tensor([jacobian.ways[number].span for number in numbers], dtype=torch.float64)
        self._few = torch.tensor([jacobian.ways[number].name in by_luminance for number in numbers])
        self._root = _root(noise.covariance[:, colours][:, :, colours])
        self._sums = torch.zeros(3, len(self._root), len(numbers), len(numbers), dtype=torch.float64)

    def add(self, slope: Tensor) -> None:
        """Add some samples, whose derivatives after all ways are [n, 3, way, texel]."""
        slope = slope[:, self.colours][:, :, self.numbers].double().permute(3, 0, 1, 2)  # [texel, n, colour, k]
        asked = slope
        if bool(self._few.any()):
            weights = torch.tensor(_LUMINANCE, dtype=torch.float64)[:, None]
            asked = torch.where(self._few, weights * (weights * slope).sum(dim=2, keepdim=True), slope)
        noisy = self._root.transpose(1, 2)[:, None] @ asked
        flat, asked, noisy = (one.flatten(1, 2) for one in (slope, asked, noisy))
        with one_thread():
            for total, left, right in zip(self._sums, (asked, noisy, flat), (flat, noisy, flat), strict=True):
                total += left.transpose(1, 2) @ right

    def covariance(self, whole: float) -> Tensor:
        """Return the covariance [texel, k, k] for `whole` times as many samples."""
        scale = self._span[:, None] * self._span
        return _covariance(*(whole * part * scale for part in self._sums)) * scale


def _root(covariance: Tensor) -> Tensor:
    """Return L [t, c, c] with L L^T the covariance: of residuals that are 0, or always of one colour, too."""
    values, vectors = torch.linalg.eigh(covariance)
    return vectors * values.clamp(min=0).sqrt()[:, None]


def _covariance(bread: Tensor, meat: Tensor, plain: Tensor) -> Tensor:
    """Return B^-1 M B^-T in spans [t, k, k]; where samples leave a direction open its variance is 1.

    `plain` is the sum of J^T J: where directions are open, what they are told from.
    """
    with one_thread():
        inverse, failed = torch.linalg.inv_ex(bread)
        found = inverse @ meat @ inverse.transpose(1, 2)
        sure = (failed == 0) & (found.diagonal(dim1=1, dim2=2).sum(dim=1) < 1)  # then no direction has more than 1
        sure &= torch.isfinite(found).flatten(1).all(dim=1)
        open_ones = ~sure
        if bool(open_ones.any()):
            found[open_ones] = _capped(plain[open_ones], meat[open_ones])
    return found


def _capped(plain: Tensor, meat: Tensor) -> Tensor:
    """Return the covariance with the directions that noise leaves wider than a span at just that."""
    values, vectors = torch.linalg.eigh(plain)
    level = (vectors.transpose(1, 2) @ meat @ vectors).diagonal(dim1=1, dim2=2).clamp(min=0)
    floor = torch.finfo(torch.float64).eps * len(plain[0]) * values.amax(dim=1, keepdim=True)
    known = (values > floor) & (level < values.square())
    inverse = torch.where(known, 1 / torch.where(known, values, 1.0), 0.0)
    half = vectors * inverse[:, None] @ vectors.transpose(1, 2)
    left = vectors * (~known)[:, None].double()
    return half @ meat @ half + left @ left.transpose(1, 2)
