"""Heights, slopes and normals."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.reference import relief as oracle
from tests.support import assert_close

from torchmat.errors import RangeError, ShapeError
from torchmat.geometry import normals_from_height, normals_from_slopes, slopes_from_height, slopes_from_normals
from torchmat.geometry.normals import flip_green, sobel


def ramp(rise_x: float, rise_y: float, size: int = 8) -> torch.Tensor:
    """A plane that rises by so much a texel to the right and up the texture."""
    row, column = torch.meshgrid(torch.arange(size), torch.arange(size), indexing="ij")
    return (rise_x * column.double() - rise_y * row.double())[None]


@pytest.mark.parametrize("tiles", [True, False])
@pytest.mark.parametrize("size", [(5, 7), (1, 6), (6, 1), (1, 1), (2, 2)])
def test_sobel_agrees_with_the_loop(dtype, tiles, size):
    height = torch.rand(1, *size, dtype=dtype)
    expected = oracle.sobel(height[0].double().numpy(), tiles)
    assert float((sobel(height, tiles).double() - torch.from_numpy(expected)).abs().max()) < 1e-5


def test_sobel_of_a_plane_is_eight_times_its_rise():
    inside = sobel(ramp(0.25, -0.5), tiles=False)[:, 1:-1, 1:-1]
    assert_close(inside, torch.tensor([2.0, -4.0], dtype=torch.float64)[:, None, None].expand_as(inside))


def test_a_left_flank_faces_left_and_an_upper_flank_up():
    bump = torch.exp(-(((torch.arange(9) - 4.0) / 2) ** 2))
    normal = normals_from_height((bump[:, None] * bump)[None], 4.0)
    assert normal[0, 4, 2] < -0.1 and normal[0, 4, 6] > 0.1
    assert normal[1, 2, 4] > 0.1 and normal[1, 6, 4] < -0.1


def test_strength_follows_the_formula():
    height = torch.rand(1, 6, 6, dtype=torch.float64)
    dx, dy = sobel(height)
    expected = torch.stack((-dx, -dy, torch.full_like(dx, 1 / 3.0)))
    assert_close(normals_from_height(height, 3.0), expected / expected.norm(dim=0))


def test_physical_slope_counts_texture_widths():
    slopes = slopes_from_height(ramp(0.01, 0.02), 0.5, tiles=False)[:, 2:-2, 2:-2]
    assert_close(slopes, torch.tensor([0.04, 0.08], dtype=torch.float64)[:, None, None].expand_as(slopes))


def test_slopes_and_normals_are_inverse():
    slopes = torch.randn(2, 5, 6, dtype=torch.float64)
    normal = normals_from_slopes(slopes)
    assert_close(normal.norm(dim=0), torch.ones(5, 6, dtype=torch.float64))
    assert_close(slopes_from_normals(normal), slopes)


def test_normals_beyond_the_horizon_give_finite_slopes():
    normal = torch.tensor([[1.0, 0.0, -0.1], [math.sin(1.57), 0.0, math.cos(1.57)]]).T.reshape(3, 1, 2)
    assert bool(torch.isfinite(slopes_from_normals(normal)).all())


def test_green_flips_and_flips_back():
    normal = torch.randn(3, 4, 4)
    assert torch.equal(flip_green(flip_green(normal)), normal)
    assert torch.equal(flip_green(normal)[1], -normal[1])


def test_gradient_reaches_the_height():
    height = torch.rand(1, 4, 5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda h: normals_from_height(h, 2.0), (height,))


@pytest.mark.parametrize("strength", [0.0, 0.5, 8.5, float("nan")])
def test_strength_outside_its_range_is_refused(strength):
    with pytest.raises(RangeError, match="normal_strength"):
        normals_from_height(torch.zeros(1, 3, 3), strength)


@pytest.mark.parametrize("scale", [0.0, -1.0, 10.0, float("nan")])
def test_a_height_scale_that_no_surface_has_is_refused(scale):
    with pytest.raises(RangeError, match="texture widths"):
        slopes_from_height(torch.zeros(1, 3, 3), scale)


def test_a_map_that_is_no_height_is_refused():
    with pytest.raises(ShapeError, match=r"\[1, H, W\]"):
        sobel(torch.zeros(3, 4, 4))
    with pytest.raises(RangeError, match="finite"):
        sobel(torch.full((1, 4, 4), float("nan")))


def test_the_oracle_itself_sees_a_wrong_sign():
    height = np.random.default_rng(0).random((4, 4))
    assert np.abs(oracle.sobel(height, True) - oracle.sobel(height[::-1], True)).max() > 0.1
