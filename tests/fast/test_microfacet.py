"""What is shown of the microfacet material by the compiled part, against plain torch."""

from __future__ import annotations

import math

import pytest
import torch
from tests.fast.conftest import on_both_roads, same_values, with_threads
from tests.fast.test_sums import directions, shown

from torchmat.fast import microfacet
from torchmat.models import Microfacet
from torchmat.models.microfacet import MICROFACET_PARTS

pytestmark = pytest.mark.usefixtures("compiled")
EVERY = list(MICROFACET_PARTS)
# Each part there and not there, and what two of them do to each other.
CASES = [
    [], ["normal"], ["anisotropy"], ["normal", "anisotropy", "f90"], ["layered"], ["normal", "layered", "rolloff"], ["coat"],
    ["coat", "layered", "normal"], ["sheen"], ["sheen", "normal", "f90"], EVERY,
]
TOLERANCE = {torch.float32: 5e-6, torch.float64: 1e-13}


def material_of(parts, dtype, rows=7, columns=19, least=0.35):
    """Return random maps, with black, normals that lean beyond the directions, and turns of no length; roughness from `least` on."""
    slopes = torch.randn(2, rows, columns, dtype=dtype)
    slopes[:, 0] *= 20
    rough = torch.rand(4, rows, columns, dtype=dtype) * (1 - least) + least
    every = {
        "normal": {"normal": torch.cat((slopes, torch.ones(1, rows, columns, dtype=dtype)))},
        "anisotropy": {"rotation": torch.randn(2, rows, columns, dtype=dtype).clamp(-1, 1)}, "f90": {"f90": rough[3:]},
        "coat": {"coat": torch.rand(1, rows, columns, dtype=dtype) * 0.05, "coat_roughness": rough[2:3]},
        "sheen": {"sheen": torch.rand(3, rows, columns, dtype=dtype), "sheen_roughness": torch.tensor([0.4], dtype=dtype)},
        "rolloff": {"rolloff": torch.tensor([-0.4, 1.5], dtype=dtype)}, "layered": {},
    }
    maps = {name: torch.rand(3, rows, columns, dtype=dtype) for name in ("diffuse", "specular_f0")}
    maps["specular_f0"][:, :, 1:2] *= 0.01
    maps["diffuse"][:, :, 0] = maps["specular_f0"][:, -1] = 0
    maps["roughness"] = rough[:2] if "anisotropy" in parts else rough[:1]
    for part in parts:
        maps |= every[part]
    if "rotation" in maps:
        maps["rotation"][:, 2:3] = 0
    if "normal" in maps:
        maps["normal"] = (maps["normal"] / maps["normal"].abs().amax(dim=0)).clone()
        maps["normal"][:, 3:4] = 0
    return Microfacet(maps, parts=parts)


@pytest.mark.parametrize("parts", CASES)
def test_values_are_those_of_plain_torch(parts, dtype):
    material, (light, view) = material_of(parts, dtype), directions(dtype)
    plain, found = on_both_roads(lambda: shown(material, light, view))
    assert found.shape == (3, 7, 19) and float(found.max()) > 0
    same_values(plain, found, TOLERANCE[dtype])


@pytest.mark.parametrize("parts", CASES)
def test_mirrors(parts, dtype):
    material, (light, view) = material_of(parts, dtype, least=0.0), directions(dtype)
    maps = {name: value.detach().clone() for name, value in material.maps.items()}
    maps["roughness"][:, 4:] = 0
    plain, found = on_both_roads(lambda: shown(material.with_maps(**maps), light, view))
    # Alpha is a thousandth there, and half vectors that are rounded otherwise lie elsewhere on the lobe.
    same_values(plain, found, 2e-4 if dtype == torch.float32 else 1e-12)


@pytest.mark.parametrize("light, view", [
    ((6, 3, 1, 1), (6, 3, 1, 1)), ((3, 1, 1), (3, 1, 1)), ((4, 1, 3, 7, 19), (1, 2, 3, 1, 1)), ((2, 3, 7, 19), (3, 1, 1)), ((0, 3, 1, 1), (3, 1, 1)),
])
def test_shapes_that_broadcast(light, view):
    light, view = torch.randn(light, dtype=torch.float64), torch.randn(view, dtype=torch.float64)
    light[..., 2, :, :], view[..., 2, :, :] = light[..., 2, :, :].abs(), view[..., 2, :, :].abs()
    light, view = (one / one.norm(dim=-3, keepdim=True) for one in (light, view))
    material = material_of(EVERY, torch.float64)
    plain, found = on_both_roads(lambda: shown(material, light, view))
    same_values(plain, found, 1e-13)


@pytest.mark.parametrize("rows, columns", [(1, 1), (1, 3), (127, 1), (8, 16)])
def test_sizes_of_one_texel_and_about_a_block(rows, columns):
    material = material_of(EVERY, torch.float64, rows, columns)
    light, view = (torch.rand(2, 3, rows, columns, dtype=torch.float64) for _ in range(2))
    light, view = (one / one.norm(dim=-3, keepdim=True) for one in (light, view))
    plain, found = on_both_roads(lambda: shown(material, light, view))
    same_values(plain, found, 1e-13)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("parts", [[], EVERY])
def test_maps_that_are_not_finite(parts, bad):
    material, (light, view) = material_of(parts, torch.float64), directions(torch.float64)
    for name in material.maps:
        maps = {key: value.detach().clone() for key, value in material.maps.items()}
        maps[name].flatten()[-1] = bad
        if maps[name].ndim == 3:
            maps[name][0, 3:, 4] = bad
        wrong = material.sharing(maps)
        plain, found = on_both_roads(lambda wrong=wrong: shown(wrong, light, view))
        if math.isinf(bad):  # what the roads make of 0 times infinity hangs on the order of their products
            plain, found = (one.where(torch.isfinite(plain) & torch.isfinite(found), 0) for one in (plain, found))
        else:
            assert not torch.isfinite(plain).all(), name
        assert material.maps[name].ndim == 1 or int((found != 0).sum()) > 100, name
        same_values(plain, found, 1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("parts", [[], EVERY])
def test_directions_that_are_no_numbers(parts, axis):
    material, (light, view) = material_of(parts, torch.float32), directions(torch.float32)
    light, view = light.clone(), view.clone()
    light[axis, 4, 4:8] = math.nan
    view[axis, 5, 4:8] = math.nan
    plain, found = on_both_roads(lambda: shown(material, light, view))
    same_values(plain, found, 5e-6)


def test_bits_do_not_depend_on_threads():
    material, (light, view) = material_of(EVERY, torch.float32, 61, 37), directions(torch.float32, 61, 37)
    found = [with_threads(count, lambda: shown(material, light, view)) for count in (1, 2, 4)]
    assert torch.equal(found[0], found[1]) and torch.equal(found[0], found[2])


def test_what_is_not_for_the_compiled_part_is_for_plain_torch():
    material, (light, view) = material_of(EVERY, torch.float32), directions(torch.float32)
    maps = {name: value.detach() for name, value in material.maps.items()}
    found = microfacet.shown(light, view, maps, True)
    assert found is not None and torch.equal(found, shown(material, light, view))
    assert microfacet.shown(light, view, dict(material.maps), True) is None, "its maps want gradients"
    assert microfacet.shown(light.clone().requires_grad_(), view, maps, True) is None
    assert microfacet.shown(light.half(), view.half(), {name: value.half() for name, value in maps.items()}, True) is None

    material = material_of([], torch.float32)

    def pulled():
        return torch.autograd.grad(material.shade(light, view).sum(), list(material.maps.values()))

    assert all(torch.equal(a, b) for a, b in zip(*on_both_roads(pulled), strict=True))
