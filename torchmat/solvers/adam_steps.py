"""The steps of Adam (Kingma & Ba 2015), to the bit those of `torch.optim.Adam`.

torch's optimisers load its compiler before their first step, which takes two seconds of every short fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor


class AdamSteps:
    """Adam on some parameters, each at a rate of its own.

    Args:
        parameters: leaves whose `grad` the steps follow; one without a gradient stays.
        betas: how much of the running means of gradients and of their squares remains in a step.
        eps: what is added to the root of the mean square.
    """

    def __init__(self, parameters: Sequence[Tensor], betas: tuple[float, float], eps: float = 1e-8) -> None:
        self.parameters, self.betas, self.eps = list(parameters), betas, eps
        self._means = [torch.zeros_like(one) for one in self.parameters]
        self._squares = [torch.zeros_like(one) for one in self.parameters]
        self._steps = [0] * len(self.parameters)

    @torch.no_grad()
    def step(self, rates: Sequence[float]) -> None:
        """Change the parameters in place by one step at these rates."""
        first, second = self.betas
        found = {number: parameter.grad for number, parameter in enumerate(self.parameters) if parameter.grad is not None}
        if not found:
            return
        moved, gradients = list(found), list(found.values())
        for number in moved:
            self._steps[number] += 1
        parameters = [self.parameters[number] for number in moved]
        means, squares = ([every[number] for number in moved] for every in (self._means, self._squares))
        # Tensor by tensor the same operations as one by one, without Python between them.
        torch._foreach_lerp_(means, gradients, 1 - first)
        torch._foreach_mul_(squares, second)
        torch._foreach_addcmul_(squares, gradients, gradients, 1 - second)
        sizes = torch._foreach_sqrt(squares)
        torch._foreach_div_(sizes, [math.sqrt(1 - second ** self._steps[number]) for number in moved])
        torch._foreach_add_(sizes, self.eps)
        torch._foreach_addcdiv_(parameters, means, sizes, [-rates[number] / (1 - first ** self._steps[number]) for number in moved])
