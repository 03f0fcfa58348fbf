"""Rays of the compiled part against those of plain torch."""

from __future__ import annotations

import pytest
import torch
from tests.fast.conftest import on_both_roads, with_threads

from torchmat.fast import rays
from torchmat.geometry.rays import clearance, find_obstacles, texel_centres, trace_view

pytestmark = pytest.mark.usefixtures("compiled")
TILES = [True, False]


def relief(rows: int, columns: int, dtype: torch.dtype) -> torch.Tensor:
    """A height with bumps, a pit, and nearly a plateau: rounding would decide where a ray that begins on a flat top meets it."""
    down, across = torch.meshgrid(torch.arange(rows, dtype=dtype) / rows, torch.arange(columns, dtype=dtype) / columns, indexing="ij")
    return (0.1 * torch.sin(9 * across + 4 * down) * torch.cos(7 * down) + 0.02).clamp(max=0.09)[None] + 0.003 * across


def directions(dtype: torch.dtype) -> torch.Tensor:
    """Upright, leaning, nearly flat, below the horizon and of no length, [n, 3, 1, 1]."""
    rows = [[0, 0, 1], [0.6, 0, 0.8], [-0.3, 0.9, 0.3], [1, 0, 1e-3], [0, -1, 0], [0.5, 0.5, -0.7], [0, 0, 0], [0.1, -0.7, 0.7]]
    return torch.tensor(rows, dtype=dtype)[:, :, None, None]


def tolerance(dtype: torch.dtype) -> float:
    return 1e-4 if dtype == torch.float32 else 1e-11


def near(plain: torch.Tensor, found: torch.Tensor, dtype: torch.dtype) -> None:
    """Hold two results together; where a ray only just touches, rounding may decide which point it meets."""
    apart = (plain - found).abs() / plain.abs().clamp(min=1)
    assert torch.isfinite(found).all() and float((apart > tolerance(dtype)).double().mean()) <= (2e-3 if dtype == torch.float32 else 0)


@pytest.mark.parametrize("tiles", TILES)
@pytest.mark.parametrize("size", [(12, 16), (9, 5), (1, 7), (1, 1)])
def test_rays_meet_and_miss_as_in_plain_torch(size, tiles, dtype):
    height, way = relief(*size, dtype), directions(dtype)
    places = texel_centres(*size, dtype) * 1.7 - 0.4
    for uv in (None, places):
        near(*on_both_roads(lambda: trace_view(height, way, uv, tiles).height), dtype)
        near(*on_both_roads(lambda: clearance(height, way, uv, tiles)), dtype)
    which = torch.arange(len(way))
    near(*on_both_roads(lambda: find_obstacles(height, way, tiles).clearance(height, tiles, which)), dtype)


def test_a_direction_for_each_pixel_or_row(dtype):
    height = relief(8, 6, dtype)
    for size in ((8, 6), (8, 1), (1, 6)):
        way = torch.randn(2, 3, *size, dtype=dtype)
        way[:, 2] = way[:, 2].abs() + 0.1
        near(*on_both_roads(lambda: trace_view(height, way).height), dtype)
        near(*on_both_roads(lambda: clearance(height, way)), dtype)


def test_a_large_map_which_plain_torch_moves_as_a_whole():
    height, way = relief(100, 104, torch.float32), directions(torch.float32)[:3]
    near(*on_both_roads(lambda: trace_view(height, way).height), torch.float32)
    near(*on_both_roads(lambda: clearance(height, way)), torch.float32)


def test_gradients_pass_as_in_plain_torch():
    height, way = relief(7, 9, torch.float64), directions(torch.float64)[[1, 2, 7]]

    def pulls():
        bent = height.clone().requires_grad_()
        hit = torch.autograd.grad(trace_view(bent, way).uv.square().sum(), bent)[0]
        return torch.cat((hit, torch.autograd.grad(clearance(bent, way).square().sum(), bent)[0]))

    plain, found = on_both_roads(pulls)
    assert float((plain - found).abs().max()) < 1e-9 * float(plain.abs().max())


def test_flat_heights_and_walls():
    for height in (torch.zeros(1, 4, 4), torch.full((1, 4, 4), 0.3), torch.tensor([0.0, 0.0, 1.0, 0.0]).expand(1, 3, 4)):
        near(*on_both_roads(lambda: trace_view(height, directions(torch.float32)).height), torch.float32)
        near(*on_both_roads(lambda: clearance(height, directions(torch.float32))), torch.float32)


def test_bits_do_not_depend_on_threads():
    height, way = relief(40, 40, torch.float32), directions(torch.float32)
    found = [with_threads(count, lambda: (trace_view(height, way).uv, clearance(height, way))) for count in (1, 2, 4)]
    for one in found[1:]:
        assert torch.equal(one[0], found[0][0]) and torch.equal(one[1], found[0][1])


def test_it_is_the_compiled_part_that_is_asked():
    height, way = relief(4, 4, torch.float32), directions(torch.float32)
    uv, slope = texel_centres(4, 4)[None].expand(len(way), -1, -1, -1), way[:, :2]
    assert rays.first_roots(height, uv, slope, 0.0, 0.1, 4, True) is not None
    assert rays.clearances(height, uv, slope, 0.1, 1e-6, True, False) is not None
    assert rays.clearances(height.clone().requires_grad_(), uv, slope, 0.1, 1e-6, True, False) is None
