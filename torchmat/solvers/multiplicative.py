"""Maps that only add light, brought to the brightness of the data in a few passes, whatever their scale at the start.

An additive map x >= 0 of a prediction p(x) that is linear in it goes to ``x * (J^T W y) / (J^T W p)`` (Daube-Witherspoon
& Muehllehner 1986): the weighted error never grows, nothing becomes negative, and a table that is a thousand times too
dark is right after one pass, where Adam walks for hundreds of steps. J is never made: both products are gradients.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

_DARKER, _BRIGHTER = -4.0, 8.0  # the most that one pass changes, as logarithms
# Of the mean pull of a map's entries: what both sides of a ratio have beside the samples. An entry that hardly any sample
# sees is left where it is; what the few say of it is noise, and other texels may see it in full.
_PRIOR = 0.01


def sweep(
    logarithms: Sequence[Tensor], predict: Callable[[Tensor], Tensor], observed: Callable[[Tensor], tuple[Tensor, Tensor]],
    batches: Sequence[Tensor],
) -> None:
    """Change `logarithms` of additive maps in place by one pass over `batches` of samples.

    `predict` gives the values of a batch, differentiable; `observed` the true ones and their weights. Entries that no
    sample sees, or only black ones, keep their value.
    """
    above, below = ([torch.zeros_like(one) for one in logarithms] for _ in range(2))
    for one in logarithms:
        one.requires_grad_()
    for batch in batches:
        values, weight = observed(batch)
        with torch.enable_grad():
            predicted = predict(batch)
        pull = torch.autograd.grad(predicted, logarithms, weight * values.clamp(min=0), retain_graph=True)
        push = torch.autograd.grad(predicted, logarithms, weight * predicted.detach())
        for sums, parts in ((above, pull), (below, push)):
            for total, part in zip(sums, parts, strict=True):
                total += part
    for one, up, down in zip(logarithms, above, below, strict=True):
        one.requires_grad_(False)
        known = (up > 0) & (down > 0)
        prior = _PRIOR * float(torch.minimum(up, down)[known].mean()) if bool(known.any()) else 0.0
        up, down = up + prior, down + prior
        ratio = torch.where(known, up, 1.0).log() - torch.where(known, down, 1.0).log()
        one += ratio.clamp(_DARKER, _BRIGHTER)
