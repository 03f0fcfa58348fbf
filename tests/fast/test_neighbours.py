"""Nearest measured directions, their weights, and PCA's value, by the compiled part: against all distances, and plain torch."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.fast.conftest import on_both_roads, same_values, with_threads
from tests.support import all_pairs, hemisphere

from torchmat import fast
from torchmat.fast import neighbours as compiled_neighbours
from torchmat.models import MATERIALS
from torchmat.models.angular import _whole, nearby, neighbour_weights, projected

pytestmark = pytest.mark.usefixtures("compiled")
RINGS = ((0, 1), (25, 6), (50, 8), (70, 12))
TOLERANCE = {torch.float32: 5e-6, torch.float64: 1e-13}
COUNT = 5000  # more than the fewest


def known_pairs(dtype, rings=RINGS, holes=0.2):
    """Return light and view [n, 3] of pairs of a few lights and views, some of which are missing, in any order."""
    light, view = (torch.tensor(one, dtype=dtype) for one in all_pairs(hemisphere(rings), hemisphere(rings[::-1])))
    kept = torch.randperm(len(light))[: max(1, int(len(light) * (1 - holes)))]
    return light[kept], view[kept]


def queries(dtype, count=COUNT):
    """Return light and view [count, 3]: anywhere, flat, and just where directions are measured."""
    found = torch.randn(2, count, 3, dtype=dtype)
    found[:, :, 2] = found[:, :, 2].abs()
    found[:, ::7, 2] *= 1e-3
    found = found / found.norm(dim=2, keepdim=True)
    light, view = (torch.tensor(one, dtype=dtype) for one in all_pairs(hemisphere(RINGS), hemisphere(RINGS[::-1])))
    found[0, : len(light)], found[1, : len(light)] = light, view
    return found[0], found[1]


def by_all_distances(known, asked, count):
    """Return the numbers of the nearest, of those as near the lower, by whole numbers of any size."""
    known, asked = (_whole(one).long() for one in (known, asked))
    squared = (asked[:, None] - known).square().sum(dim=2)
    return squared.sort(dim=1, stable=True).indices[:, :count]


@pytest.mark.parametrize("rings, holes", [(RINGS, 0.0), (RINGS, 0.2), (RINGS, 0.7), (((0, 1), (60, 4)), 0.0), (((30, 2),), 0.0), (((0, 1),), 0.0)])
def test_neighbours_are_the_nearest_and_ties_go_to_the_lower_number(rings, holes, dtype):
    light, view = known_pairs(dtype, rings, holes)
    known, asked = projected(light, view), queries(dtype)
    found = nearby(known, *asked)
    assert found is not None and found[0].dtype == torch.int32
    expected = by_all_distances(known, projected(*asked), min(12, len(known)))
    assert torch.equal(found[0].long().sort(dim=1).values, expected.sort(dim=1).values)
    fast.use(False)
    plain = neighbour_weights(known, *asked)
    assert torch.equal(plain[0].sort(dim=1).values, expected.sort(dim=1).values)


def test_weights_are_those_of_plain_torch(dtype):
    known, asked = projected(*known_pairs(dtype)), queries(dtype)
    table = torch.randn(len(known), 3, dtype=dtype)

    def interpolated():
        index, weight = neighbour_weights(known, *asked)
        return (table[index] * weight[..., None]).sum(dim=1)

    plain, found = on_both_roads(interpolated)
    same_values(plain, found, TOLERANCE[dtype])


def material_of(components, dtype, rows=80, columns=70):
    light, view = known_pairs(dtype)
    maps = {
        "component": torch.randn(3 * components, rows, columns, dtype=dtype), "directions": projected(light, view).T[:, None],
        "weight": torch.randn(components, 1, len(light), dtype=dtype),
    }
    return MATERIALS["pca"](maps, components=components)


def planes(dtype, rows=80, columns=70):
    return [one.T.reshape(3, rows, columns) for one in queries(dtype, rows * columns)]


def shown(material, light, view):
    with torch.no_grad():
        return material.shade(light, view)


@pytest.mark.parametrize("components", [1, 3, 16, 64, 65])
def test_pca_is_as_plain_torch_has_it(components, dtype):
    material, (light, view) = material_of(components, dtype), planes(dtype)
    light[2, 0, :5], view[2, 1, :5] = -0.3, 0
    plain, found = on_both_roads(lambda: shown(material, light, view))
    assert float(found.max()) > 0 and bool((found[:, 0, :5] == 0).all())
    same_values(plain, found, TOLERANCE[dtype])
    with torch.no_grad():
        assert (material.in_one_pass(light, view) is None) == (components > 64)


def test_lights_and_views_of_samples_and_of_texels():
    material, (light, view) = material_of(5, torch.float64), planes(torch.float64)
    for pair in ((light, view[:, :1, :1]), (torch.stack((light, view)), view), (light[:, :1, :1], torch.stack((light, view)))):
        plain, found = on_both_roads(lambda pair=pair: shown(material, *pair))
        same_values(plain, found, 1e-13)


def test_clusters_take_the_same_neighbours():
    light, view = known_pairs(torch.float64)
    maps = {
        "cluster": torch.randint(0, 3, (1, 80, 70)).double(), "weight": torch.randn(2, 80, 70, dtype=torch.float64),
        "reflectance": torch.randn(9, 3, len(light), dtype=torch.float64), "directions": projected(light, view).T[:, None],
    }
    material = MATERIALS["local_pca"](maps, clusters=3, components=2)
    pair = planes(torch.float64)
    plain, found = on_both_roads(lambda: shown(material, *pair))
    same_values(plain, found, 1e-13)


def test_a_map_that_is_not_finite_shows_in_the_value():
    for name, bad in (("component", math.nan), ("component", math.inf), ("weight", math.nan)):
        material, (light, view) = material_of(3, torch.float32), planes(torch.float32)
        maps = {key: value.detach().clone() for key, value in material.maps.items()}
        maps[name][0, 0, :30] = bad
        wrong = material.sharing(maps)
        plain, found = on_both_roads(lambda wrong=wrong: shown(wrong, light, view))
        assert not bool(torch.isfinite(found).all()) and torch.equal(plain.isnan(), found.isnan()), name


def test_directions_that_are_no_numbers_are_for_plain_torch_as_they_were():
    material, (light, view) = material_of(3, torch.float32), planes(torch.float32)
    light[0, 5, 5] = math.nan
    assert nearby(material.maps["directions"].detach()[:, 0].T, light.flatten(1).T, view.flatten(1).T) is None
    for road in (False, True):
        fast.use(road)
        with pytest.raises(ValueError, match="finite"):
            shown(material, light, view)


def test_bits_do_not_depend_on_threads():
    material, (light, view) = material_of(16, torch.float32), planes(torch.float32)
    found = [with_threads(count, lambda: shown(material, light, view)) for count in (1, 2, 4)]
    assert torch.equal(found[0], found[1]) and torch.equal(found[0], found[2])


def test_what_is_not_for_the_compiled_part_is_for_plain_torch():
    known, asked = projected(*known_pairs(torch.float32)), queries(torch.float32)
    assert nearby(known, *asked) is not None
    assert nearby(known, *(one[:100] for one in asked)) is None, "few"
    assert nearby(known.clone().requires_grad_(), *asked) is None
    assert nearby(torch.cat((known, known[:1])), *asked) is None, "one pair twice"
    scattered = projected(*(torch.from_numpy(np.random.default_rng(0).normal(size=(100, 3))).float() for _ in range(2)))
    assert compiled_neighbours.neighbours(scattered, projected(*asked), _whole(scattered), 2.0**24) is None, "no few lights by few views"
    fast.use(False)
    assert nearby(known, *asked) is None
