"""Elementary functions whose value and gradient stay finite wherever the true ones fit in the dtype.

A masked-out branch still back-propagates ``0 * inf = nan``, so each function replaces the dangerous input
before the operation, not the result after it. At a point where the true gradient is infinite or undefined
the gradient returned is 0. Denormal divisors, lengths and bases count as 0: their reciprocal overflows. What
overflows for a normal input (1e30 / 1e-30) still does. NaN stays NaN, so that no missing number turns into a dark texel.
"""

from __future__ import annotations

import torch
from torch import Tensor

# The vector maths library that torch calls sets itself up on first use. When the first use comes from two threads at
# once, one of them now and then computes with 12 bits (one process in four, torch 2.13 with MKL): so a single thread goes first.
torch.sqrt(torch.ones(16))
torch.sqrt(torch.ones(16, dtype=torch.float64))


def sqrt(x: Tensor) -> Tensor:
    """Return the square root of `x`; 0 with gradient 0 for x <= 0."""
    blocked = x <= 0
    return torch.where(blocked, torch.zeros_like(x), torch.sqrt(torch.where(blocked, torch.ones_like(x), x)))


def divide(numerator: Tensor, denominator: Tensor) -> Tensor:
    """Return numerator / denominator; 0 with gradient 0 where the denominator is 0."""
    numerator, denominator = torch.broadcast_tensors(numerator, denominator)
    blocked = denominator.abs() < torch.finfo(denominator.dtype).tiny
    quotient = numerator / torch.where(blocked, torch.ones_like(denominator), denominator)
    return torch.where(blocked, torch.zeros_like(quotient), quotient)


def normalise(vector: Tensor, dim: int = -3) -> Tensor:
    """Scale `vector` to unit length along `dim`; a zero vector stays zero, with gradient 0.

    The largest component is divided out first, so that neither 1e-30 nor 1e30 under- or overflows when squared.
    """
    largest = vector.detach().abs().amax(dim=dim, keepdim=True)
    scaled = divide(vector, largest)
    length = sqrt((scaled * scaled).sum(dim=dim, keepdim=True))
    return divide(scaled, length)


def acos(x: Tensor) -> Tensor:
    """Return the arc cosine in radians; inputs outside [-1, 1] count as the nearer end, with gradient 0 there."""
    x = x.clamp(-1, 1)
    return torch.atan2(sqrt((1 - x) * (1 + x)), x)


def power(base: Tensor, exponent: Tensor) -> Tensor:
    """Return base ** exponent for base >= 0; ``0 ** 0 = 1``, ``0 ** n = 0``; the gradient at base 0 is 0.

    Negative bases count as 0, as clamped cosines do.
    """
    base, exponent = torch.broadcast_tensors(base, exponent)
    blocked = base < torch.finfo(base.dtype).tiny
    logarithm = torch.log(torch.where(blocked, torch.ones_like(base), base))
    # exp underflows to 0 for large exponents, where the exact value is below the smallest float anyway.
    value = torch.exp(exponent * logarithm)
    at_zero = torch.where(exponent == 0, torch.ones_like(value), torch.zeros_like(value))
    return torch.where(blocked, at_zero, value)
