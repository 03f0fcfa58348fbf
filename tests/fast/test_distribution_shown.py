"""What is shown of the distribution material under directions of each texel by the compiled part, against plain torch."""

from __future__ import annotations

import math

import pytest
import torch
from tests.fast.conftest import on_both_roads, same_values, with_threads
from tests.fast.test_distribution import CASES, EVERY, maps_for
from tests.fast.test_sums import directions, shown

from torchmat.models import Distribution

pytestmark = pytest.mark.usefixtures("compiled")
TOLERANCE = {torch.float32: 5e-6, torch.float64: 1e-13}


def material_of(case, dtype, rows=9, columns=15, exponent=5.0):
    lobes, parts, channels, spacing, size = case
    maps = maps_for(lobes, parts, channels, size, dtype, rows, columns)
    return Distribution(maps, lobes=lobes, parts=parts, mask_channels=channels, specular_spacing=spacing, fresnel_exponent=exponent)


@pytest.mark.parametrize("exponent", [5.0, 1.0, 0.3])
@pytest.mark.parametrize("case", CASES)
def test_values_are_those_of_plain_torch(case, exponent, dtype):
    material, (light, view) = material_of(case, dtype, exponent=exponent), directions(dtype, 9, 15)
    if dtype == torch.float32:  # Where neighbours on a map differ by 100, a place is rounded by a hundred thousandth of that
        maps = {name: value.detach().clone() for name, value in material.maps.items()}
        maps["specular"] = 0.9 + 0.002 * maps["specular"] / 100
        material = material.with_maps(**maps)
    with torch.no_grad():
        assert material.in_one_pass(light, view) is not None
    plain, found = on_both_roads(lambda: shown(material, light, view))
    assert found.shape == (3, 9, 15) and float(found.max()) > 0
    same_values(plain, found, TOLERANCE[dtype])


@pytest.mark.parametrize("case", CASES)
def test_steep_maps_in_single_precision(case):
    material, (light, view) = material_of(case, torch.float32), directions(torch.float32, 9, 15)
    plain, found = on_both_roads(lambda: shown(material, light, view))
    same_values(plain, found, 1e-4)


@pytest.mark.parametrize("light, view", [
    ((3, 9, 15), (3, 1, 1)), ((4, 1, 3, 9, 15), (1, 2, 3, 1, 1)), ((2, 3, 1, 1), (3, 9, 15)), ((0, 3, 9, 15), (3, 9, 15)),
])
def test_shapes_that_broadcast(light, view):
    light, view = torch.randn(light, dtype=torch.float64), torch.randn(view, dtype=torch.float64)
    light[..., 2, :, :], view[..., 2, :, :] = light[..., 2, :, :].abs(), view[..., 2, :, :].abs()
    light, view = (one / one.norm(dim=-3, keepdim=True) for one in (light, view))
    material = material_of(CASES[2], torch.float64)
    plain, found = on_both_roads(lambda: shown(material, light, view))
    same_values(plain, found, 1e-13)


@pytest.mark.parametrize("rows, columns", [(3, 3), (3, 43), (8, 16)])
def test_sizes_about_a_block(rows, columns):
    material = material_of(CASES[0], torch.float64, rows, columns)
    light, view = (torch.rand(2, 3, rows, columns, dtype=torch.float64) for _ in range(2))
    light, view = (one / one.norm(dim=-3, keepdim=True) for one in (light, view))
    plain, found = on_both_roads(lambda: shown(material, light, view))
    same_values(plain, found, 1e-13)


def test_maps_and_directions_that_are_no_numbers():
    material, (light, view) = material_of(CASES[2], torch.float64), directions(torch.float64, 9, 15)
    for name in material.maps:
        maps = {key: value.detach().clone() for key, value in material.maps.items()}
        maps[name].flatten()[:] = math.nan
        wrong = material.sharing(maps)
        plain, found = on_both_roads(lambda wrong=wrong: shown(wrong, light, view))
        assert torch.equal(plain.isnan(), found.isnan()) and bool(found.isnan().any()), name
    for axis in range(3):
        turned = light.clone()
        turned[axis, 4, 4:8] = math.nan
        plain, found = on_both_roads(lambda turned=turned: shown(material, turned, view))
        # Where no place is looked up, plain torch takes one of the corners.
        same_values(*(torch.where(plain.isnan() | found.isnan(), 0, one) for one in (plain, found)), 1e-13)
        assert torch.equal(plain.isnan(), found.isnan())


def test_bits_do_not_depend_on_threads():
    material, (light, view) = material_of(CASES[2], torch.float32, 61, 37), directions(torch.float32, 61, 37)
    found = [with_threads(count, lambda: shown(material, light, view)) for count in (1, 2, 4)]
    assert torch.equal(found[0], found[1]) and torch.equal(found[0], found[2])


def test_what_is_not_for_the_compiled_part_is_for_plain_torch():
    material, (light, view) = material_of(CASES[0], torch.float32), directions(torch.float32, 9, 15)
    assert material.in_one_pass(light, view) is None, "with gradients"
    with torch.no_grad():
        assert material.in_one_pass(light[:, :1, :1], view[:, :1, :1]) is None
        printed = {name: value for name, value in material.maps.items() if name != "masking"}
        parts = [part for part in EVERY if part != "masking"]
        other = Distribution(printed, parts=parts)
        assert other.in_one_pass(light, view) is None
        rise = material.with_rise(torch.tensor([4.0]))
        assert rise.in_one_pass(light, view) is None
