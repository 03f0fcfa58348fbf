"""The distribution material's value of the compiled part against plain torch, in value and all gradients."""

from __future__ import annotations

import pytest
import torch
from tests.fast.conftest import on_both_roads, with_threads
from tests.hard_cases.hard_directions import half_pairs, hard_grid, rows_of

from torchmat.models import Distribution

pytestmark = pytest.mark.usefixtures("compiled")
EVERY = ("normal", "specular_mask", "fresnel", "rotation", "masking")
# Lobes, parts, channels of the mask, spacing, texels on a side of the specular maps; each part there and not there.
CASES = [
    (1, EVERY, 1, "dense", 6), (1, ("masking",), 1, "even", 6), (3, EVERY, 3, "even", 5), (2, ("specular_mask", "masking"), 1, "dense", 1),
    (1, ("normal", "masking"), 1, "even", 48), (1, ("rotation", "fresnel", "masking"), 1, "even", 6),
]


def maps_for(lobes, parts, channels, size, dtype, rows=9, columns=15):
    """Return random maps, with black, mirrors and normals that lean beyond the directions among them."""
    slopes = torch.randn(2, rows, columns, dtype=dtype)
    slopes[:, 0] *= 20
    normal = torch.cat((slopes, torch.ones(1, rows, columns, dtype=dtype)))
    angle = torch.rand(rows, columns, dtype=dtype) * 7
    mask, fresnel = torch.rand(channels, rows, columns, dtype=dtype), torch.rand(1, rows, columns, dtype=dtype)
    mask[:, :, 0], fresnel[:, 1], fresnel[:, 2] = 0, 0, 1
    every = {
        "normal": normal / normal.norm(dim=0, keepdim=True), "rotation": torch.stack((angle.cos(), angle.sin())), "specular_mask": mask,
        "fresnel": fresnel, "masking": torch.tensor([0.3, 0.002], dtype=dtype),
    }
    found = {"diffuse": torch.rand(3, rows, columns, dtype=dtype), "specular": torch.rand(3 * lobes, size, size, dtype=dtype) * 100}
    found["diffuse"][:, :, 1] = 0
    if lobes > 1:
        found["index"] = torch.rand(lobes, rows, columns, dtype=dtype) / lobes
    return found | {part: every[part] for part in parts}


def directions(dtype):
    """Return plain directions, one below the horizon, and those where formulas break, [n, 3, 1, 1] each."""
    some = torch.randn(2, 6, 3, 1, 1, dtype=dtype)
    some[:, :5, 2] = some[:, :5, 2].abs() + 0.02
    some = some / some.norm(dim=2, keepdim=True)
    hard = [rows_of(half_pairs(), dtype), hard_grid(dtype)]
    light, view = (torch.cat([some[side], *(pair[side] for pair in hard)]) for side in (0, 1))
    opposite = (light + view)[:, :, 0, 0].norm(dim=1) < 1e-3  # no half vector: its direction is rounding's
    return light[~opposite], view[~opposite]


def value_and_pulls(material, maps, light, view, above, exponent=None):
    leaves = {name: value.clone().requires_grad_() for name, value in maps.items()}
    rise = None if exponent is None else torch.tensor([exponent], dtype=light.dtype, requires_grad=True)
    own = material.sharing(leaves)
    found = (own if rise is None else own.with_rise(rise)).value(light, view)
    found.backward(above)
    pulls = {name: leaf.grad for name, leaf in leaves.items()}
    return {"value": found.detach(), **pulls, **({} if rise is None else {"exponent": rise.grad})}


def agree(plain, found, tolerance):
    for name, expected in plain.items():
        assert (expected is None) == (found[name] is None), name
        if expected is not None:
            assert torch.isfinite(found[name]).all(), name
            assert float((expected - found[name]).abs().max()) <= tolerance * float(expected.abs().max()), name


@pytest.mark.parametrize("lobes, parts, channels, spacing, size", CASES)
def test_value_and_gradients_are_those_of_plain_torch(lobes, parts, channels, spacing, size, dtype):
    maps = maps_for(lobes, parts, channels, size, dtype)
    material = Distribution(maps, lobes=lobes, parts=parts, mask_channels=channels, specular_spacing=spacing)
    light, view = directions(dtype)
    if dtype == torch.float32:  # where a half vector lies on a texel's very edge, rounding says on which side
        light, view = light[:6], view[:6]
    above = torch.randn(len(light), 3, *material.size, dtype=dtype)
    exponent = 4.2 if "fresnel" in parts else None
    plain, found = on_both_roads(lambda: value_and_pulls(material, maps, light, view, above, exponent))
    # Sums over a hundred texels and samples that cancel: measured 5e-6 and 5e-15.
    agree(plain, found, 3e-5 if dtype == torch.float32 else 1e-12)


def test_hard_directions_in_single_precision():
    maps = maps_for(1, EVERY, 1, 6, torch.float32)
    material, (light, view) = Distribution(maps, parts=EVERY, specular_spacing="dense"), directions(torch.float32)
    plain, found = on_both_roads(lambda: material.value(light, view).detach())
    assert float((plain - found).abs().max()) < 1e-4 * float(plain.abs().max()) and torch.isfinite(found).all()


def test_a_given_exponent_and_a_second_derivative():
    maps = maps_for(1, EVERY, 1, 6, torch.float64, 3, 3)
    material, (light, view) = Distribution(maps, parts=EVERY, fresnel_exponent=3.0), directions(torch.float64)
    light, view = light[:4], view[:4]

    def twice():
        leaf = maps["fresnel"].clone().requires_grad_()
        value = material.sharing({**maps, "fresnel": leaf}).value(light, view)
        (slope,) = torch.autograd.grad(value.square().sum(), leaf, create_graph=True)
        return torch.stack((slope, torch.autograd.grad(slope.sum(), leaf)[0]))

    plain, found = on_both_roads(twice)
    plain, found = plain.detach(), found.detach()
    assert float((plain - found).abs().max()) < 1e-10 * float(plain.abs().max())


def test_a_map_that_is_not_finite_shows_in_the_value():
    for name in ("diffuse", "fresnel", "specular_mask", "specular", "masking", "normal"):
        maps = maps_for(1, EVERY, 1, 6, torch.float32, 3, 2)
        material, (light, view) = Distribution(maps, parts=EVERY), directions(torch.float32)
        wrong = {**maps, name: torch.full_like(maps[name], torch.nan)}
        assert bool(material.sharing(wrong).value(light[:3], view[:3]).isnan().any()), name


def test_bits_do_not_depend_on_threads():
    maps = maps_for(2, EVERY, 1, 8, torch.float32, 40, 50)
    material, (light, view) = Distribution(maps, lobes=2, parts=EVERY), directions(torch.float32)
    above = torch.randn(len(light), 3, 40, 50)
    found = [with_threads(count, lambda: value_and_pulls(material, maps, light, view, above, 4.0)) for count in (1, 2, 4)]
    for one in found[1:]:
        assert all(torch.equal(one[name], found[0][name]) for name in one)


@pytest.mark.parametrize("light, view", [((3, 3, 9, 15), (3, 3, 9, 15)), ((3, 1, 1), (3, 1, 1)), ((4, 3, 1, 1), (1, 3, 1, 1))])
def test_other_shapes_of_directions_go_by_plain_torch(light, view):
    maps = maps_for(1, EVERY, 1, 6, torch.float64)
    material = Distribution(maps, parts=EVERY)
    light, view = torch.randn(light, dtype=torch.float64), torch.randn(view, dtype=torch.float64)
    plain, found = on_both_roads(lambda: material.value(light, view).detach())
    assert float((plain - found).abs().max()) <= 1e-12 * float(plain.abs().max())  # of frames that are compiled
