"""Products that do not depend on the number of threads."""

from __future__ import annotations

import pytest
import torch
from tests.support import assert_close

from torchmat.repeatable import add_product, one_thread, product, spread, wide_product

SHAPES = [(7, 2000, 3), (3, 25000, 48), (9, 2000, 4000), (15, 600, 12288), (4, 130, 60001), (1, 5, 1)]


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_one_and_two_threads_agree_to_the_bit(shape, dtype):
    rank, rows, columns = shape
    left, right = torch.randn(rows, rank, dtype=dtype), torch.randn(rows, columns, dtype=dtype)
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            total = torch.ones(rank, columns, dtype=dtype)
            add_product(total, left, right)
            found.append((total, product(left.T, right)))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(found[0][0], found[1][0]) and torch.equal(found[0][1], found[1][1])
    assert_close(found[0][0] - 1, left.double().T @ right.double(), 1e-4 if dtype == torch.float32 else 1e-12)


def test_an_error_gives_the_threads_back():
    before = torch.get_num_threads()
    with pytest.raises(RuntimeError, match="shape"), one_thread():
        assert torch.get_num_threads() == 1
        torch.ones(2, 3) @ torch.ones(2, 3)
    assert torch.get_num_threads() == before


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("rows", [1, 2, 3, 5, 6, 7, 9, 11, 13])
def test_wide_products_round_alike_on_any_number_of_threads(rows, dtype):
    torch.manual_seed(rows)
    first, second = torch.randn(rows, 100, dtype=dtype), torch.randn(100, 5555, dtype=dtype)
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            total = torch.ones(rows, 5555, dtype=dtype)
            add_product(total, first.T.contiguous(), second)
            found.append((wide_product(first, second), total))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(one, two) for one, two in zip(*found, strict=True))
    expected = (first.double() @ second.double()).to(dtype)
    for value in (found[0][0], found[0][1] - 1):
        assert float((value - expected).abs().max()) < (1e-4 if dtype == torch.float32 else 1e-12)


def test_small_wide_products_are_products():
    first, second = torch.randn(3, 4), torch.randn(4, 5)
    assert torch.allclose(wide_product(first, second), first @ second)


@pytest.mark.parametrize("size", [(1, 1), (300, 401)])
def test_numbers_for_all_texels_have_a_gradient_that_threads_do_not_change(size):
    weight = torch.rand(2, *size, generator=torch.Generator().manual_seed(0)) ** 8
    found, before = [], torch.get_num_threads()
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            numbers = torch.tensor([0.3, 0.7]).requires_grad_()
            planes = spread(numbers, *size)
            assert planes.shape == weight.shape and bool((planes[1] == numbers[1]).all())
            (planes[:1] * weight[:1] + planes[1:] * weight[1:]).sum().backward()
            found.append(numbers.grad)
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(found[0], other) for other in found[1:])
    assert torch.allclose(found[0], weight.double().sum(dim=(1, 2)).float(), rtol=1e-5)
