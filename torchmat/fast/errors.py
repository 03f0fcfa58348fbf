"""Sums of errors of pictures by the compiled part: one pass over what is measured."""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat.fast.call import call, fits, wants_gradient
from torchmat.fast.switch import library

_SUMS, _STRIPS = 5, 8  # as in errors.h


def sums(prediction: Tensor, target: Tensor, valid: Tensor, clipped: Tensor) -> Tensor | None:
    """Return squared error, energy, squared display and log error, and count, [5, k] float64; None where that is for plain torch.

    Planes [k, 3, H, W]; masks, bool [k, 1 or 3, H, W], say which values count, and which of them are at least as bright as their target.
    """
    found = library()
    if found is None or not fits(prediction, target) or wants_gradient(prediction, target):
        return None
    count, _, rows, columns = target.shape
    strips, out = (torch.empty(count, size, dtype=torch.float64) for size in (_STRIPS * _SUMS, _SUMS))
    planes = (one.contiguous() for one in (prediction, target, valid, clipped))
    call(found, "errors", *planes, count, rows * columns, valid.shape[1], clipped.shape[1], strips, out)
    return out.T
