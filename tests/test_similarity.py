"""Structural similarity beside kornia's."""

from __future__ import annotations

import pytest
import torch

from torchmat.similarity import moments, similarity


@pytest.mark.parametrize(("height", "width"), [(40, 31), (6, 6), (7, 200)])
def test_similarity_is_that_of_kornia(height, width):
    from kornia.metrics import ssim

    first = torch.rand(2, 3, height, width, generator=torch.Generator().manual_seed(0))
    second = (first + 0.1 * torch.rand(first.shape, generator=torch.Generator().manual_seed(1))).clamp(0, 1)
    with torch.no_grad():
        known, found = ssim(first, second, 11), similarity(moments(first), moments(second))
    assert found.shape == known.shape and float((found - known).abs().max()) < 2e-6  # equal where both have oneDNN
    assert torch.equal(similarity(moments(first), moments(first)) > 0.999, torch.ones(first.shape, dtype=torch.bool))


def test_moments_are_left_as_they_were():
    first, second = moments(torch.rand(1, 3, 9, 9)), moments(torch.rand(1, 3, 9, 9))
    before = [part.clone() for part in (*first, *second)]
    assert torch.equal(similarity(first, second), similarity(first, second))
    assert all(torch.equal(one, other) for one, other in zip(before, (*first, *second), strict=True))
