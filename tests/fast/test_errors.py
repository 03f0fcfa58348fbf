"""Sums of errors of the compiled part against plain torch."""

from __future__ import annotations

import math

import pytest
import torch
from tests.fast.conftest import on_both_roads, with_threads

from torchmat.metrics import SampleErrors

pytestmark = pytest.mark.usefixtures("compiled")
NAMES = ("squared", "energy", "display", "log", "count")


def pictures(count, rows, columns, dtype):
    """Return prediction and target, black, dark, negative and blinding values among them."""
    target = torch.rand(count, 3, rows, columns, dtype=dtype) ** 3
    target[:, :, ::3], target[:, 0] = target[:, :, ::3] * 1e-5, target[:, 0] * 40
    target[0] = 0
    prediction = target * (1 + 0.1 * torch.randn_like(target)) - 1e-4
    return prediction, target


def sums_of(prediction, target, valid, clipped):
    errors = SampleErrors()
    errors.add(prediction, target, valid, clipped, torch.zeros(len(target), dtype=torch.bool))
    return torch.stack([torch.cat(getattr(errors, name)) for name in NAMES])


def agree(plain, found, dtype):
    assert found.dtype == plain.dtype == torch.float64 and found.shape == plain.shape
    assert torch.equal(found[4], plain[4])
    gap, size = (found - plain).abs(), plain.abs().amax(dim=1, keepdim=True)
    assert float((gap / size.clamp(min=1e-300)).max()) < (1e-5 if dtype == torch.float32 else 1e-12)


@pytest.mark.parametrize("channels", [(1, 1), (3, 1), (1, 3), (3, 3)])
@pytest.mark.parametrize("shape", [(5, 13, 11), (1, 1, 1), (2, 40, 1), (1, 70, 65)])
def test_sums_are_those_of_plain_torch(shape, channels, dtype):
    prediction, target = pictures(*shape, dtype)
    valid, clipped = (torch.rand(shape[0], number, *shape[1:]) > low for number, low in zip(channels, (0.2, 0.6), strict=True))
    plain, found = on_both_roads(lambda: sums_of(prediction, target, valid, clipped))
    agree(plain, found, dtype)


def test_what_does_not_count_may_be_anything():
    prediction, target = pictures(2, 9, 9, torch.float32)
    valid, never = torch.rand(2, 1, 9, 9) > 0.5, torch.zeros(2, 1, 9, 9, dtype=torch.bool)
    clean = sums_of(prediction, target, valid, never)
    hidden = ~valid.expand_as(target)
    prediction[hidden], target[hidden] = torch.nan, torch.inf
    assert torch.equal(sums_of(prediction, target, valid, never), clean)


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_what_is_not_finite_shows_where_it_does_in_plain_torch(wrong):
    prediction, target = pictures(3, 9, 9, torch.float32)
    prediction[1, 2, 3, 4] = wrong
    every, never = torch.ones(3, 1, 9, 9, dtype=torch.bool), torch.zeros(3, 1, 9, 9, dtype=torch.bool)
    plain, found = on_both_roads(lambda: sums_of(prediction, target, every, never))
    assert torch.equal(torch.isfinite(plain), torch.isfinite(found)) and not torch.isfinite(found[0, 1])
    agree(plain[:, ::2], found[:, ::2], torch.float32)


def test_alike_is_no_error_at_all(dtype):
    _, target = pictures(4, 17, 9, dtype)
    every, never = torch.ones(4, 1, 17, 9, dtype=torch.bool), torch.zeros(4, 1, 17, 9, dtype=torch.bool)
    found = sums_of(target, target, every, never)
    assert float(found[[0, 2, 3]].abs().max()) == 0


def test_small_differences_in_the_dark_are_told():
    target = torch.full((1, 3, 8, 8), 1e-7)
    every, never = torch.ones(1, 1, 8, 8, dtype=torch.bool), torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    plain, found = on_both_roads(lambda: sums_of(target * 1.01, target, every, never))
    assert float((found / plain - 1)[[0, 2, 3]].abs().max()) < 1e-3


def test_bits_do_not_depend_on_threads_nor_on_order_in_memory():
    prediction, target = pictures(3, 50, 41, torch.float32)
    every, never = torch.ones(3, 1, 50, 41, dtype=torch.bool), torch.zeros(3, 1, 50, 41, dtype=torch.bool)
    one, four = (with_threads(count, lambda: sums_of(prediction, target, every, never)) for count in (1, 4))
    turned = sums_of(prediction.mT.contiguous().mT, target.to(memory_format=torch.channels_last), every, never)
    assert torch.equal(one, four) and torch.equal(one, turned)
