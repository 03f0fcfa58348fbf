"""What is shown of sums and of Lambert's law by the compiled part, against plain torch."""

from __future__ import annotations

import math

import pytest
import torch
from tests.fast.conftest import on_both_roads, same_values, with_threads
from tests.hard_cases.hard_directions import half_pairs, hard_grid, rows_of
from tests.models.examples import LOBES

from torchmat import fast
from torchmat.fast import sums
from torchmat.models import MATERIALS, Lambert

pytestmark = pytest.mark.usefixtures("compiled")
# Models with their options, and how many numbers a texel has in each map.
CASES = [
    ("texture", {}, {"albedo": 3}), ("lambert", {}, {"albedo": 3, "normal": 3}), ("ptm", {}, {"polynomial": 18}),
    ("ptm", {"space": "srgb"}, {"polynomial": 18}), ("lptm", {}, {"chroma": 3, "luminance": 6}),
    ("lptm", {"space": "srgb"}, {"chroma": 3, "luminance": 6}), ("hsh", {"terms": 4}, {"harmonic": 12}),
    ("hsh", {"terms": 9}, {"harmonic": 27}), ("hsh", {"terms": 16, "space": "srgb"}, {"harmonic": 48}),
    *(("phong_srf", {"residual": name}, {"residual": 3 * terms}) for name, terms in
      (("half", 3), ("half_light", 7), ("quadratic", 15), ("cosine", 1))),
]
TOLERANCE = {torch.float32: 5e-6, torch.float64: 1e-13}


def material_of(model, options, channels, dtype, rows=7, columns=19):
    """Return a random material with black texels, some normals of no length and some of any."""
    maps = {name: torch.randn(count, rows, columns, dtype=dtype) for name, count in channels.items()}
    for name in ("albedo", "chroma"):
        if name in maps:
            maps[name] = maps[name].abs()
    if "normal" in maps:
        maps["normal"] = maps["normal"].clamp(-1, 1)
        maps["normal"][:, -1] *= 1e-30
    for value in maps.values():
        value[:, :, 0] = 0
    if model == "phong_srf":
        maps["lobe"] = torch.tensor(LOBES["phong"], dtype=dtype)
    return MATERIALS[model](maps, **options)


def directions(dtype, rows=7, columns=19):
    """Return light and view [3, rows, columns]: plain ones, some below the horizon, and those where formulas break."""
    hard = [rows_of(half_pairs(), dtype), hard_grid(dtype)]
    light, view = (torch.cat([pair[side][:, :, 0, 0] for pair in hard]) for side in (0, 1))
    some = torch.randn(2, rows * columns, 3, dtype=dtype)
    some[:, ::2, 2] = some[:, ::2, 2].abs()
    some = some / some.norm(dim=2, keepdim=True)
    some[0, : len(light)], some[1, : len(light)] = light, view
    some[0, len(light)], some[1, len(light)] = torch.tensor([0.6, 0, 0.8]), torch.tensor([-0.6, 0, 0.8])
    some[:, len(light) + 1] = 0
    return (one.T.reshape(3, rows, columns) for one in some)


def shown(material, light, view):
    with torch.no_grad():
        return material.shade(light, view)


@pytest.mark.parametrize("model, options, channels", CASES)
def test_values_are_those_of_plain_torch(model, options, channels, dtype):
    material, (light, view) = material_of(model, options, channels, dtype), directions(dtype)
    plain, found = on_both_roads(lambda: shown(material, light, view))
    assert found.shape == (3, 7, 19) and float(found.max()) > 0
    same_values(plain, found, TOLERANCE[dtype])


@pytest.mark.parametrize("model, options, channels", CASES)
def test_it_is_the_compiled_part_that_shows_them(model, options, channels):
    material, (light, view) = material_of(model, options, channels, torch.float32), directions(torch.float32)
    with torch.no_grad():
        found = material.in_one_pass(light, view)
    assert found is not None and torch.equal(found, shown(material, light, view))
    assert material.in_one_pass(light, view) is None, "its maps want gradients"


@pytest.mark.parametrize("light, view", [
    ((3, 7, 19), (3, 1, 1)), ((3, 1, 1), (3, 7, 19)), ((4, 1, 3, 7, 19), (1, 2, 3, 1, 1)), ((4, 1, 3, 1, 1), (2, 3, 7, 19)),
    ((1, 3, 7, 19), (5, 3, 7, 19)), ((2, 3, 1, 1), (3, 1, 1)), ((0, 3, 7, 19), (3, 7, 19)),
])
def test_shapes_that_broadcast(light, view):
    light, view = torch.randn(light, dtype=torch.float64), torch.randn(view, dtype=torch.float64)
    light[..., 2, :, :], view[..., 2, :, :] = light[..., 2, :, :].abs(), view[..., 2, :, :].abs()
    for case in (CASES[1], CASES[7], CASES[10]):
        material = material_of(*case, torch.float64)
        plain, found = on_both_roads(lambda material=material: shown(material, light, view))
        same_values(plain, found, 1e-13)


@pytest.mark.parametrize("rows, columns", [(1, 1), (1, 3), (127, 1), (8, 16), (3, 43)])
def test_sizes_of_one_texel_and_about_a_block(rows, columns):
    for case in (CASES[1], CASES[7], CASES[9]):
        material = material_of(*case, torch.float64, rows, columns)
        light, view = (torch.rand(2, 3, rows, columns, dtype=torch.float64) for _ in range(2))
        plain, found = on_both_roads(lambda material=material, light=light, view=view: shown(material, light, view))
        same_values(plain, found, 1e-13)


def test_planes_in_any_order():
    material = material_of(*CASES[1], torch.float64)
    light, view = (torch.rand(7, 19, 3, dtype=torch.float64).permute(2, 0, 1) for _ in range(2))
    plain, found = on_both_roads(lambda: shown(material, light, view))
    same_values(plain, found, 1e-13)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 3e38, -3e38])
@pytest.mark.parametrize("model, options, channels", CASES)
def test_maps_that_are_not_finite_or_huge(model, options, channels, bad):
    material, (light, view) = material_of(model, options, channels, torch.float32), directions(torch.float32)
    for name in channels:
        for channel in range(min(channels[name], 3)):
            maps = {key: value.detach().clone() for key, value in material.maps.items()}
            maps[name][channel, 3:, 4] = bad
            wrong = material.sharing(maps)
            plain, found = on_both_roads(lambda wrong=wrong: shown(wrong, light, view))
            if abs(bad) > 1e38:  # a sum may pass what numbers can be on the one road and not on the other
                plain, found = (torch.where(one.abs() < 1e36, one, 0) for one in (plain, found))
            same_values(plain, found, 5e-6)


@pytest.mark.parametrize("length", [3e38, 1e-30, 2e-38])
def test_normals_of_any_length(length):
    material, (light, view) = material_of(*CASES[1], torch.float32), directions(torch.float32)
    own = {name: value.detach() for name, value in material.maps.items()}
    right = shown(material, light, view)
    plain, found = on_both_roads(lambda: shown(material.sharing({**own, "normal": own["normal"] * length}), light, view))
    same_values(plain, found, 5e-6)
    if length > 2e-38:  # where some of them count as 0
        same_values(right[:, :-1], found[:, :-1], 5e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("model, options, channels", CASES)
def test_directions_that_are_no_numbers(model, options, channels, axis):
    material, (light, view) = material_of(model, options, channels, torch.float32), directions(torch.float32)
    light, view = light.clone(), view.clone()
    light[axis, 4, 4:8] = math.nan
    view[axis, 5, 4:8] = math.nan
    plain, found = on_both_roads(lambda: shown(material, light, view))
    same_values(plain, found, 5e-6)


@pytest.mark.parametrize("exponent", [1e-3, 1.0, 300.0, 1e5])
def test_exponents_from_least_to_most(exponent, dtype):
    material, (light, view) = material_of(*CASES[9], dtype), directions(dtype)
    maps = {name: value.detach().clone() for name, value in material.maps.items()}
    maps["residual"].zero_()
    maps["lobe"][6] = math.log(exponent)
    plain, found = on_both_roads(lambda: shown(material.with_maps(**maps), light, view))
    # A cosine's last place counts as often as the exponent says.
    same_values(plain, found, TOLERANCE[dtype] * max(1.0, exponent / 10))


def test_codes_along_the_whole_curve(dtype):
    codes = torch.cat((torch.linspace(-0.1, 3, 5000, dtype=dtype), torch.logspace(-12, 4, 1000, dtype=dtype)))
    maps = torch.zeros(18, 1, len(codes), dtype=dtype)
    maps[15:] = codes
    material = MATERIALS["ptm"]({"polynomial": maps}, space="srgb")
    up = torch.tensor([0.0, 0, 1], dtype=dtype)[:, None, None].expand(3, 1, len(codes))
    plain, found = on_both_roads(lambda: shown(material, up, up))
    apart = (plain - found).abs() / plain.clamp(min=1e-30)
    assert float(apart.max()) < TOLERANCE[dtype] and float(found[0, 0, 0]) == 0


@pytest.mark.parametrize("model, options, channels", CASES)
def test_bits_do_not_depend_on_threads(model, options, channels):
    material = material_of(model, options, channels, torch.float32, 61, 37)
    light, view = directions(torch.float32, 61, 37)
    found = [with_threads(count, lambda: shown(material, light, view)) for count in (1, 2, 4)]
    assert torch.equal(found[0], found[1]) and torch.equal(found[0], found[2])


def test_gradients_are_those_of_plain_torch():
    material, (light, view) = material_of(*CASES[1], torch.float64), directions(torch.float64)

    def pulled():
        leaf = light.clone().requires_grad_()
        return torch.autograd.grad(material.shade(leaf, view).sum(), [leaf, *material.maps.values()])

    plain, found = on_both_roads(pulled)
    assert all(torch.equal(a, b) for a, b in zip(plain, found, strict=True))


def test_a_class_that_changes_the_value_alone_keeps_it():
    class Doubled(Lambert):
        def value(self, light, view):
            return 2 * super().value(light, view)

    material, (light, view) = material_of(*CASES[1], torch.float64), directions(torch.float64)
    twice = Doubled(dict(material.maps))
    same_values(2 * shown(material, light, view), shown(twice, light, view), 1e-13)


def test_what_is_not_for_the_compiled_part_is_for_plain_torch():
    material = material_of(*CASES[2], torch.float32)
    layers, (light, view) = material.maps["polynomial"].detach(), directions(torch.float32)
    assert sums.weighed(light, view, "polynomial", layers) is not None
    assert sums.weighed(light.half(), view.half(), "polynomial", layers.half()) is None
    assert sums.weighed(light[:, :1, :1], view[:, :1, :1], "polynomial", layers) is None, "a product of matrices"
    assert sums.weighed(light.clone().requires_grad_(), view, "polynomial", layers) is None
    fast.use(False)
    assert sums.weighed(light, view, "polynomial", layers) is None
