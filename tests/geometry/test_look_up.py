"""Looking maps up between texels, against loops over the texels that count."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.support import assert_close

from torchmat.geometry.rays import look_up, texel_centres

SIZES = [(5, 7), (8, 3), (1, 6), (6, 1), (1, 1), (2, 2)]
MODES = ["bilinear", "bicubic", "nearest"]


def kernel(mode: str, distance: float) -> float:
    """The weight of a texel at a distance, in texels: a tent, or cubic convolution (Keys 1981) with a = -0.75."""
    a, d = -0.75, abs(distance)
    if mode == "bilinear":
        return max(0.0, 1 - d)
    if d <= 1:
        return (a + 2) * d**3 - (a + 3) * d**2 + 1
    return a * d**3 - 5 * a * d**2 + 8 * a * d - 4 * a if d < 2 else 0.0


def expected_at(planes: np.ndarray, u: float, v: float, tiles: bool, mode: str) -> np.ndarray:
    rows, columns = planes.shape[1:]
    x, y = u * columns - 0.5, (1 - v) * rows - 0.5

    def texel(row: int, column: int) -> np.ndarray:
        if tiles:
            return planes[:, row % rows, column % columns]
        return planes[:, min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)]

    if mode == "nearest":
        return texel(math.floor(y + 0.5), math.floor(x + 0.5))
    total = np.zeros(len(planes))
    for row in range(math.floor(y) - 1, math.floor(y) + 3):
        for column in range(math.floor(x) - 1, math.floor(x) + 3):
            total += kernel(mode, x - column) * kernel(mode, y - row) * texel(row, column)
    return total


def expected(maps: torch.Tensor, uv: torch.Tensor, tiles: bool, mode: str) -> torch.Tensor:
    found = np.zeros((len(uv), maps.shape[1], *uv.shape[-2:]))
    for n, row, column in np.ndindex(len(uv), *uv.shape[-2:]):
        planes = maps[n if len(maps) > 1 else 0].double().numpy()
        found[n, :, row, column] = expected_at(planes, *uv[n, :, row, column].double().tolist(), tiles, mode)
    return torch.from_numpy(found)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("tiles", [True, False])
@pytest.mark.parametrize("size", SIZES)
def test_near_and_far_places_match_the_loop(size, tiles, mode):
    maps = torch.randn(1, 2, *size, dtype=torch.float64)
    for spread, centre in ((1.0, 0.5), (3.0, 0.5), (1.0, 1000.3), (1.0, -1000.3)):
        uv = (torch.rand(2, 2, 3, 4, dtype=torch.float64) - 0.5) * spread + centre
        found = look_up(maps, uv, tiles, mode)
        # Far away u itself is known to 1e-13 of a texture, and the slope of the map goes with it.
        assert_close(found, expected(maps, uv, tiles, mode), 1e-12 if abs(centre) < 1 else 1e-10)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("tiles", [True, False])
def test_single_precision_loses_a_few_ulp(tiles, mode):
    maps, uv = torch.randn(1, 3, 5, 7), torch.rand(1, 2, 6, 6) * 3 - 1
    # u of up to 2 has a step of 2.4e-7, 7 texels across: measured 1e-6 of the largest value.
    assert_close(look_up(maps, uv, tiles, mode), expected(maps, uv, tiles, mode).float(), 1e-5)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("tiles", [True, False])
@pytest.mark.parametrize("size", SIZES)
def test_texel_centres_give_the_texels(size, tiles, mode, dtype):
    maps = torch.randn(1, 2, *size, dtype=dtype)
    assert_close(look_up(maps, texel_centres(*size, dtype)[None], tiles, mode), maps, 1e-5 if dtype == torch.float32 else None)


@pytest.mark.parametrize("mode", MODES)
def test_a_map_for_each_place_or_one_for_all(mode):
    uv = torch.rand(3, 2, 4, 5, dtype=torch.float64) * 2 - 0.5
    many = torch.randn(3, 2, 5, 6, dtype=torch.float64)
    for tiles in (True, False):
        found = look_up(many, uv, tiles, mode)
        for n in range(3):
            assert_close(found[n], look_up(many[n : n + 1], uv[n : n + 1], tiles, mode)[0])
        one = look_up(many[:1], uv, tiles, mode)
        assert_close(one[2], look_up(many[:1], uv[2:], tiles, mode)[0])


@pytest.mark.parametrize("mode", MODES)
def test_u_runs_right_and_v_up(mode):
    maps = torch.arange(12, dtype=torch.float64).reshape(1, 1, 3, 4)
    corner = torch.tensor([0.125, 5 / 6], dtype=torch.float64)[None, :, None, None]  # centre of the upper left texel
    for step, texel in (((0.0, 0.0), 0.0), ((0.25, 0.0), 1.0), ((0.0, -1 / 3), 4.0), ((0.75, -2 / 3), 11.0)):
        moved = corner + torch.tensor(step, dtype=torch.float64)[None, :, None, None]
        assert float(look_up(maps, moved, True, mode)) == pytest.approx(texel, abs=1e-12)


@pytest.mark.parametrize("mode", ["bilinear", "bicubic"])
def test_tiling_has_no_seam_and_a_border_goes_on(mode):
    maps = torch.randn(1, 1, 4, 6, dtype=torch.float64)
    u = torch.tensor([-1e-9, 1e-9, 1 - 1e-9, 1 + 1e-9], dtype=torch.float64)
    uv = torch.stack((u, torch.full_like(u, 0.4)))[None, :, None]
    seam = look_up(maps, uv, True, mode).flatten()
    assert float(seam.max() - seam.min()) < 1e-6
    border = look_up(maps, torch.tensor([[[[-40.0, 1.9, 1.9]], [[0.375, 0.375, 40.0]]]], dtype=torch.float64), False, mode)
    assert_close(border.flatten(), torch.stack((maps[0, 0, 2, 0], maps[0, 0, 2, -1], maps[0, 0, 0, -1])))


@pytest.mark.parametrize("mode", ["bilinear", "bicubic"])
@pytest.mark.parametrize("tiles", [True, False])
def test_gradcheck(mode, tiles):
    maps = torch.randn(1, 2, 3, 4, dtype=torch.float64, requires_grad=True)
    uv = (torch.rand(1, 2, 2, 3, dtype=torch.float64) * 2 - 0.5).requires_grad_()
    assert torch.autograd.gradcheck(lambda maps, uv: look_up(maps, uv, tiles, mode), (maps, uv))
