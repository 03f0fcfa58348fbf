"""Look-ups of the compiled part, against loops over the texels that count and against plain torch."""

from __future__ import annotations

import math

import pytest
import torch
from tests.fast.conftest import on_both_roads, with_threads
from tests.geometry.test_look_up import expected
from tests.support import assert_close

from torchmat import fast
from torchmat.fast import look_up as compiled_look_up
from torchmat.geometry.rays import look_up

pytestmark = pytest.mark.usefixtures("compiled")
MODES = ["bilinear", "bicubic"]
TILES = [True, False]
# Maps for all places or for each, channels alone, in a group of four, beyond; maps smaller than what a look-up reads.
CASES = [(3, 3, 3, 5, 7), (3, 1, 1, 8, 3), (9, 1, 6, 2, 2), (2, 2, 9, 1, 6), (2, 1, 2, 1, 1), (1, 1, 4, 6, 1)]


def look_up_and_pull(maps, uv, above, tiles, mode):
    maps, uv = maps.clone().requires_grad_(), uv.clone().requires_grad_()
    found = look_up(maps, uv, tiles, mode)
    found.backward(above)
    return found.detach(), maps.grad, uv.grad


def inputs(count, many, channels, rows, columns, dtype):
    uv = torch.rand(count, 2, 5, 4, dtype=dtype) * 3 - 1
    return torch.randn(many, channels, rows, columns, dtype=dtype), uv, torch.randn(count, channels, 5, 4, dtype=dtype)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("tiles", TILES)
def test_values_are_those_of_the_loop_near_and_far(tiles, mode):
    for size in ((5, 7), (1, 6), (1, 1), (2, 2)):
        maps = torch.randn(1, 2, *size, dtype=torch.float64)
        for spread, centre in ((1.0, 0.5), (3.0, 0.5), (1.0, -1000.3)):
            uv = (torch.rand(2, 2, 2, 3, dtype=torch.float64) - 0.5) * spread + centre
            assert_close(look_up(maps, uv, tiles, mode), expected(maps, uv, tiles, mode), 1e-12 if centre == 0.5 else 1e-10)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("tiles", TILES)
@pytest.mark.parametrize("case", CASES)
def test_values_and_gradients_are_those_of_plain_torch(case, tiles, mode, dtype):
    given = inputs(*case, dtype)
    plain, fast_ones = on_both_roads(lambda: look_up_and_pull(*given, tiles, mode))
    # Single precision: plain torch goes by way of [-1, 1], which loses a few of the last places of where a texel is.
    tolerance = 2e-5 if dtype == torch.float32 else 1e-12
    for first, second in zip(plain, fast_ones, strict=True):
        assert float((first - second).abs().max()) <= tolerance * max(float(first.abs().max()), 1.0)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("tiles", TILES)
def test_gradients_are_those_of_differences(tiles, mode):
    maps = torch.randn(1, 5, 3, 4, dtype=torch.float64, requires_grad=True)
    uv = (torch.rand(2, 2, 1, 2, dtype=torch.float64) * 2 - 0.5).requires_grad_()
    assert torch.autograd.gradcheck(lambda maps, uv: look_up(maps, uv, tiles, mode), (maps, uv))
    assert torch.autograd.gradgradcheck(lambda maps, uv: look_up(maps, uv, tiles, mode), (maps[:, :1].detach().requires_grad_(), uv))


def test_arrays_in_any_order_and_shared_memory():
    maps = torch.randn(5, 7, 3, dtype=torch.float64).permute(2, 0, 1)[None].expand(4, -1, -1, -1)
    uv = torch.rand(4, 5, 6, 2, dtype=torch.float64).movedim(-1, 1)
    once = uv[:1].expand(4, -1, -1, -1)
    for places in (uv, once):
        plain, found = on_both_roads(lambda: look_up_and_pull(maps, places, torch.ones(4, 3, 5, 6).double(), True, "bicubic"))
        for first, second in zip(plain, found, strict=True):
            assert_close(second, first, 1e-12)
    shared = maps[:1].clone().requires_grad_()
    plain, found = on_both_roads(lambda: torch.autograd.grad(look_up(shared.expand(4, -1, -1, -1), uv).square().sum(), shared)[0])
    assert_close(found, plain, 1e-12)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e30])
@pytest.mark.parametrize("tiles", TILES)
def test_places_that_are_none_harm_no_others(bad, tiles):
    maps = torch.randn(1, 3, 5, 7)
    uv = torch.rand(1, 2, 3, 3)
    wrong = uv.clone()
    wrong[0, 0, 1, 1] = bad
    for mode in MODES:
        right, found = look_up(maps, uv, tiles, mode), look_up_and_pull(maps, wrong, torch.ones(1, 3, 3, 3), tiles, mode)[0]
        right[..., 1, 1] = found[..., 1, 1] = 0
        assert torch.equal(right, found)


@pytest.mark.parametrize("many", [1, 20])
def test_bits_do_not_depend_on_threads(many):
    maps, uv = torch.randn(many, 3, 16, 16), torch.rand(20, 2, 60, 60) * 2
    above = torch.randn(20, 3, 60, 60)
    found = [with_threads(count, lambda: look_up_and_pull(maps, uv, above, True, "bicubic")) for count in (1, 2, 4)]
    for one in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], one, strict=True))


def test_what_is_not_for_the_compiled_part_is_for_plain_torch(monkeypatch):
    maps, uv = torch.randn(1, 2, 4, 4), torch.rand(3, 2, 2, 2)
    plain = lambda *_: pytest.fail("plain")  # noqa: E731
    assert compiled_look_up.look_up(maps, uv, True, "bilinear", plain) is not None
    assert compiled_look_up.look_up(maps, uv, True, "nearest", plain) is None
    assert compiled_look_up.look_up(maps, uv.double(), True, "bilinear", plain) is None
    assert compiled_look_up.look_up(maps, uv[:0], True, "bilinear", plain) is None
    assert compiled_look_up.look_up(maps.half(), uv.half(), True, "bilinear", plain) is None
    monkeypatch.setattr(compiled_look_up, "_MOST_VALUES", 10)
    assert compiled_look_up.look_up(maps, uv, True, "bilinear", plain) is None
    fast.use(False)
    monkeypatch.undo()
    assert compiled_look_up.look_up(maps, uv, True, "bilinear", plain) is None
