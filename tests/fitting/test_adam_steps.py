"""Adam's steps are those of torch, without what torch loads for them."""

from __future__ import annotations

import subprocess
import sys

import torch

from torchmat.solvers.adam_steps import AdamSteps


def test_steps_are_those_of_torch_to_the_bit(dtype):
    generator = torch.Generator().manual_seed(0)
    starts, rates, betas = [torch.randn(5, 7, generator=generator, dtype=dtype), torch.randn(3, generator=generator, dtype=dtype)], (0.06, 0.003), (0.9, 0.99)
    ours, theirs = ([one.clone().requires_grad_() for one in starts] for _ in range(2))
    steps = AdamSteps(ours, betas)
    torchs = torch.optim.Adam([{"params": [one], "lr": rate} for one, rate in zip(theirs, rates, strict=True)], betas=betas)
    for number in range(60):
        for one, other in zip(ours, theirs, strict=True):
            size = 10 ** float(3 * torch.randn(1, generator=generator))
            gradient = None if number % 7 == 3 and one.ndim == 1 else size * torch.randn(one.shape, generator=generator, dtype=dtype)
            one.grad, other.grad = gradient, gradient
        steps.step(rates)
        torchs.step()
    assert all(torch.equal(one, other) for one, other in zip(ours, theirs, strict=True))
    assert not any(torch.equal(one, start) for one, start in zip(ours, starts, strict=True))


def test_no_fit_loads_a_compiler():
    code = (
        "import sys, numpy, torch, torchmat as tm\n"
        "light = torch.nn.functional.normalize(torch.tensor([[.1 * k, .2, 1.] for k in range(9)]), dim=1).numpy()\n"
        "btf = tm.Btf.from_tensors(numpy.random.default_rng(0).random((9, 3, 4, 4), numpy.float32), light, light)\n"
        "tm.fit(btf, 'distribution', geometry='flat', lobes=1, fresnel=False, rotation=False, effort=0.01, measure=False)\n"
        "print('torch._dynamo' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["False"]
