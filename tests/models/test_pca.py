"""Pca and LocalPca: values at measured pairs by hand, tables that do not fit, options."""

from __future__ import annotations

import pytest
import torch
from tests.models.examples import assert_same, known_directions, make, make_maps

from torchmat.errors import RangeError, ShapeError
from torchmat.models import LocalPca, Pca


def _measured(dtype=torch.float64):
    known = known_directions()[:, 0].T
    found = []
    for part in (known[:, :2], known[:, 2:]):
        z = (1 - part.square().sum(dim=1, keepdim=True)).clamp(min=0).sqrt()
        found.append(torch.cat((part, z), dim=1)[:, :, None, None].to(dtype))
    return found


def test_pca_reproduces_the_factors_at_measured_directions(dtype):
    maps = make_maps("pca", {"components": 3}, 2, 3, dtype)
    value = Pca(maps, components=3).shade(*_measured(dtype))
    weight, component = maps["weight"][:, 0], maps["component"].unflatten(0, (3, 3))
    expected = torch.einsum("kn,kchw->nchw", weight, component).clamp(min=0)
    assert_same(value, expected, 1e-5)  # interpolation leaves 1e-6 of the neighbours


def test_local_pca_reproduces_the_factors_at_measured_directions(dtype):
    options = {"clusters": 3, "components": 2}
    maps = make_maps("local_pca", options, 2, 3, dtype)
    value = LocalPca(maps, **options).shade(*_measured(dtype))
    table = maps["reflectance"].unflatten(0, (3, 3))  # [mean and components, channel, cluster, sample]
    for row in range(2):
        for column in range(3):
            curves = table[:, :, int(maps["cluster"][0, row, column])]
            expected = curves[0] + sum(maps["weight"][k, row, column] * curves[1 + k] for k in range(2))
            assert_same(value[:, :, row, column], expected.T.clamp(min=0), 1e-5)


def test_a_cluster_without_texels():
    options = {"clusters": 3, "components": 2}
    maps = make_maps("local_pca", options, 2, 3)
    maps["cluster"] = torch.full_like(maps["cluster"], 2)
    light, view = _measured()
    assert bool(torch.isfinite(LocalPca(maps, **options).shade(light, view)).all())
    planes = [d[0].expand(3, 2, 3).contiguous() for d in (light, view)]
    assert_same(LocalPca(maps, **options).shade(*planes), LocalPca(maps, **options).shade(light[0], view[0]))


@pytest.mark.parametrize("name, table", [("pca", "weight"), ("local_pca", "reflectance")])
def test_tables_must_fit_the_directions(name, table):
    options = {"components": 2} | ({"clusters": 3} if name == "local_pca" else {})
    kind = {"pca": Pca, "local_pca": LocalPca}[name]
    maps = make_maps(name, options)
    with pytest.raises(ShapeError, match=f"{table} must have . rows and a column per row of directions; it is"):
        kind({**maps, table: maps[table][:, :, 1:]}, **options)
    with pytest.raises(ShapeError, match=f"{table} must have"):
        kind({**maps, table: torch.cat((maps[table], maps[table]), dim=1)}, **options)
    with pytest.raises(ShapeError, match=f"{table} must have"):
        kind({**maps, "directions": maps["directions"].repeat(1, 2, 1)}, **options)


def test_a_cluster_must_be_a_whole_number():
    maps = make_maps("local_pca", {"clusters": 3, "components": 2})
    maps["cluster"][0, 1, 2] = 0.5
    with pytest.raises(RangeError, match=r"cluster must hold whole numbers; the first that is not is 0\.5"):
        LocalPca(maps, clusters=3, components=2)


def test_one_cluster_has_the_range_zero_to_zero():
    maps = make_maps("local_pca", {"clusters": 1, "components": 2})
    maps["cluster"] += 1
    with pytest.raises(RangeError, match=r"cluster must lie in \[0\.0, 0\.0\]; 6 of 6 values are not, the first is 1"):
        LocalPca(maps, clusters=1, components=2)


@pytest.mark.parametrize("bad", [0, -1, 2.5, "8"])
def test_counts_are_whole_and_positive(bad):
    with pytest.raises(RangeError, match="components must be a whole number of at least 1; it is"):
        Pca({}, components=bad)
    with pytest.raises(RangeError, match="clusters must be a whole number of at least 1; it is"):
        LocalPca({}, clusters=bad)
    with pytest.raises(RangeError, match="clusters must be at most 256; it is 257"):
        LocalPca({}, clusters=257)


def test_shared_tables_stay_precise_when_texels_take_one_byte():
    storages = {name: kind for _, name, _, kind, _ in make("pca", {"components": 2}, storage="png8").textures()}
    assert storages == {"component_000": "png8", "component_001": "png8", "weight": "half", "directions": "float"}
