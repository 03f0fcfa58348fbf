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
        for number, (parameter, rate) in enumerate(zip(self.parameters, rates, strict=True)):
            if parameter.grad is None:
                continue
            self._steps[number] += 1
            taken, mean, square = self._steps[number], self._means[number], self._squares[number]
            mean.lerp_(parameter.grad, 1 - first)
            square.mul_(second).addcmul_(parameter.grad, parameter.grad, value=1 - second)
            size = square.sqrt().div_(math.sqrt(1 - second**taken)).add_(self.eps)
            parameter.addcdiv_(mean, size, value=-rate / (1 - first**taken))
