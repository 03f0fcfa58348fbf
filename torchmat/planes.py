"""Shapes of planes, [..., 3, H, W]."""

from __future__ import annotations

import torch
from torch import Tensor


def common_lead(*planes: Tensor) -> torch.Size:
    """Return the leading shape [...] to which `planes` [..., C, h, w] broadcast.

    ``torch.broadcast_shapes`` would load sympy when it is first called: a third of a second, more than a whole fit.
    """
    return torch.broadcast_tensors(*(one.new_empty(one.shape[:-3]) for one in planes))[0].shape
