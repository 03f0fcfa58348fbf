"""Form factors of height fields against closed forms and against rays walked one by one."""

from __future__ import annotations

import math

import pytest
import torch
from tests.support import assert_close

from torchmat import ShapeError
from torchmat.geometry.form_factors import form_factors


def groove(slope: float, size: int = 32, rows: int = 4) -> torch.Tensor:
    """Return a height [1, rows, size] that falls and rises again by `slope` once across the texture."""
    x = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    return (slope * (x - 0.5).abs()).expand(1, rows, size).clone()


def test_a_flat_surface_sees_nothing_of_itself():
    assert form_factors(torch.full((1, 6, 5), 0.3))._nnz() == 0


@pytest.mark.parametrize("slope", [0.5, 1.0, 2.0])
def test_the_sides_of_a_groove_fill_the_share_of_each_other_that_is_known(slope):
    # Two long plates that meet at an angle a: F = 1 - sin(a / 2) (Siegel & Howell, configuration factor C-16).
    factors = form_factors(groove(slope, 48), directions=350 if slope >= 1 else 700).sum(dim=1).to_dense().reshape(4, 48)
    expected = 1 - math.sin(math.atan2(1, slope))
    # Slopes at the bottom and on the ridge are those of neither side: four of 48 texels, measured 6.5 % at most.
    assert float(factors.mean()) == pytest.approx(expected, rel=0.08)
    assert_close(factors, factors.flip(1), 0.05)


def test_each_texel_gives_as_much_as_it_takes():
    generator = torch.Generator().manual_seed(0)
    coarse = torch.rand(1, 1, 5, 5, generator=generator, dtype=torch.float64)
    height = 0.3 * torch.nn.functional.interpolate(coarse, size=(20, 20), mode="bicubic")[0]
    dense = form_factors(height, tiles=False, directions=800).to_dense()
    slopes = torch.stack(torch.gradient(height[0], spacing=1 / 20))
    area = (1 + slopes.square().sum(dim=0)).sqrt().flatten()
    given = area[:, None] * dense
    # Pairs of single texels are told by few rays: rows of all their partners are compared.
    off = (given.sum(dim=0) - given.sum(dim=1)).abs().mean() / given.sum(dim=1).mean()
    assert float(off) < 0.35
    assert float(dense.diagonal().abs().max()) == 0 and float(dense.sum(dim=1).max()) < 1.01




def test_a_relief_that_does_not_repeat_sees_nothing_beyond_its_border():
    wall = torch.zeros(1, 4, 16, dtype=torch.float64)
    wall[..., -1] = 0.5
    repeating, single = (form_factors(wall, tiles=tiles).to_dense() for tiles in (True, False))
    assert float(repeating[0, 15]) > 0  # the wall to its left, one texture away
    left = single[0].nonzero()[:, 0] % 16
    assert set(left.tolist()) == {15} and float(single[0].sum()) < float(repeating[0].sum())


def test_what_is_no_height_is_refused():
    with pytest.raises(ShapeError):
        form_factors(torch.zeros(4, 4))
