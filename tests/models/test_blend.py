"""Blending: exact at both ends, linear where the value is, directions that turn."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.distributions import ALL_PARTS, distribution, shaded, unit
from tests.models.examples import make
from tests.support import assert_close

from torchmat import RangeError, ShapeError
from torchmat.geometry import slopes_from_normals
from torchmat.models.blend import blend, mix
from torchmat.models.edit import add_part

LINEAR = ("specular_mask",)
# What two materials may differ in, with what is exact.
PAIRS = {
    "one lobe each": (dict(lobes=1), dict(lobes=1)),
    "lobes differ": (dict(lobes=2), dict(lobes=3)),
    "one without specular": (dict(lobes=0, parts=()), dict(lobes=2)),
    "the other without specular": (dict(lobes=1), dict(lobes=0, parts=())),
    "no mask in one": (dict(lobes=1, parts=()), dict(lobes=2)),
    "no mask in either": (dict(lobes=1, parts=()), dict(lobes=2, parts=())),
    "coloured mask": (dict(lobes=2, mask_channels=3), dict(lobes=1)),
    "no specular at all": (dict(lobes=0, parts=()), dict(lobes=0, parts=())),
    "all parts in one": (dict(lobes=2, parts=("normal", "specular_mask", "fresnel", "rotation")), dict(lobes=1, parts=())),
    "other parts": (dict(lobes=2, parts=("normal", "fresnel")), dict(lobes=1, parts=("specular_mask", "rotation"))),
}


def pair(case, **settings):
    first, second = PAIRS[case]
    return distribution(3, 4, seed=1, **first, **settings), distribution(3, 4, seed=2, **second, **settings)


@pytest.mark.parametrize("case", PAIRS)
def test_the_ends_of_a_number_are_the_materials(case):
    first, second = pair(case, relief=True)
    for weight, end in ((0, first), (1.0, second), (torch.tensor(1.0), second)):
        found = blend(first, second, weight)
        assert set(found.maps) == set(end.maps) and found.options == end.options
        assert all(torch.equal(found.maps[name], end.maps[name]) for name in end.maps)
        assert torch.equal(shaded(found), shaded(end))


@pytest.mark.parametrize("case", PAIRS)
def test_texels_of_weight_0_and_1_shade_as_their_material(case, dtype):
    first, second = pair(case, dtype=dtype)
    weight = (torch.arange(12).reshape(1, 3, 4) % 2).to(dtype)
    expected = torch.where(weight == 0, shaded(first), shaded(second))
    found = shaded(blend(first, second, weight))
    # The same products; only a normal or rotation that is there as a neutral map goes through a frame.
    assert_close(found, expected)
    if case in ("one lobe each", "lobes differ", "no mask in one", "no mask in either", "no specular at all"):
        assert torch.equal(found, expected)


@pytest.mark.parametrize("case", [case for case in PAIRS if "parts" not in case and "coloured" not in case])
def test_what_is_linear_mixes_as_the_pictures_do(case):
    first, second = pair(case, dtype=torch.float64)
    for weight in (0.25, torch.rand(1, 3, 4, dtype=torch.float64)):
        expected = torch.lerp(shaded(first), shaded(second), torch.as_tensor(weight, dtype=torch.float64))
        assert_close(shaded(blend(first, second, weight)), expected)


def test_equal_specular_maps_are_not_doubled():
    first = distribution(3, 4, 2, dtype=torch.float64)
    second = distribution(3, 4, 2, dtype=torch.float64, seed=1).with_maps(specular=first.maps["specular"])
    found = blend(first, second, 0.3)
    assert found.options["lobes"] == 2
    assert_close(shaded(found), torch.lerp(shaded(first), shaded(second), 0.3))
    itself = blend(first, first, 0.3)
    assert_close(shaded(itself), shaded(first))


def test_maps_by_hand():
    first = distribution(1, 1, 1, ("normal", "fresnel", "rotation"))
    turn = [torch.tensor([math.cos(a), math.sin(a)])[:, None, None] for a in (math.radians(170), math.radians(-170))]
    normals = [unit(torch.tensor([x, 0.0, 1.0])[:, None, None]) for x in (-0.4, 0.8)]  # slopes 0.4 and -0.8
    one = first.with_maps(rotation=turn[0], normal=normals[0], fresnel=torch.full((1, 1, 1), 0.2))
    other = first.with_maps(rotation=turn[1], normal=normals[1], fresnel=torch.full((1, 1, 1), 0.6))
    found = blend(one, other, 0.5)
    assert_close(found.maps["rotation"], torch.tensor([-1.0, 0.0])[:, None, None])
    assert_close(found.maps["fresnel"], torch.full((1, 1, 1), 0.4))
    assert_close(slopes_from_normals(found.maps["normal"]), torch.tensor([-0.2, 0.0])[:, None, None])
    quarter = blend(one, other, 0.25)
    assert_close(slopes_from_normals(quarter.maps["normal"]), torch.tensor([0.1, 0.0])[:, None, None])


def test_a_missing_part_is_neutral():
    with_fresnel = distribution(3, 4, 1, ("fresnel",))
    without = distribution(3, 4, 1, (), seed=1)
    found = blend(with_fresnel, without, 0.5).maps["fresnel"]
    assert_close(found, (with_fresnel.maps["fresnel"] + 1) / 2)


def test_a_mix_never_leaves_what_it_is_of():
    one, other = torch.rand(2, 1, 300, 300)
    near = one + 1e-7 * (other - 0.5)
    for end in (other, near, torch.ones_like(one)):
        found = mix(one, end, torch.rand(1, 300, 300))
        assert bool((found >= torch.minimum(one, end)).all()) and bool((found <= torch.maximum(one, end)).all())


def test_opposite_rotations_take_the_nearer_end():
    east = torch.tensor([1.0, 0.0])[:, None, None].expand(2, 2, 2)
    first = distribution(2, 2, 1, ("rotation",)).with_maps(rotation=east)
    second = first.with_maps(rotation=-east)
    assert torch.equal(blend(first, second, 0.5).maps["rotation"], -east)
    assert torch.equal(blend(first, second, 0.49).maps["rotation"], east)


def test_heights_blend_linearly_and_absent_is_0():
    first, second = distribution(3, 4, relief=True), distribution(3, 4, seed=1)
    found = blend(first, second, 0.25)
    assert_close(found.maps["height"], 0.75 * first.maps["height"])
    assert_close(found.maps["ambient"], 0.75 * first.maps["ambient"])
    back = blend(second, first, 0.25)
    assert_close(back.maps["height"], 0.25 * first.maps["height"])
    # slopes of the heights add up, so blended normals and heights tell one story
    both = blend(distribution(3, 4, 1, ("normal",), relief=True), distribution(3, 4, 1, (), relief=True, seed=1), 0.5)
    assert bool(torch.isfinite(shaded(both)).all())


@pytest.mark.parametrize("size", [(1, 1), (7, 3), (2, 9)])
def test_the_second_takes_the_size_of_the_first(size):
    first = distribution(3, 5, 2, ALL_PARTS, relief=True, tiles=False, storage="png8")
    second = distribution(*size, 1, ("specular_mask", "tilt"), seed=1, side=9, dtype=torch.float64)
    found = blend(first, second, 0.5)
    assert found.size == (3, 5) and found.dtype == torch.float32
    assert found.tiles is False and found.storage == "png8"
    assert found.maps["specular"].shape == (9, 9, 9)
    assert bool(torch.isfinite(shaded(found)).all())
    assert blend(first, second, 1).size == (3, 5)


@pytest.mark.parametrize("name", ["texture", "lambert", "ptm", "hsh"])
def test_other_models_blend_map_by_map(name):
    options = {"terms": 4} if name == "hsh" else {}
    first, second = make(name, options, 3, 4), make(name, options, 3, 4, seed=1)
    found = blend(first, second, 0.5)
    assert type(found) is type(first)
    for weight, end in ((0.0, first), (1.0, second)):
        ends = blend(first, second, torch.full((1, 3, 4), weight))
        assert all(torch.equal(ends.maps[key], end.maps[key]) for key in end.maps)
    if name == "ptm":
        assert_close(found.maps["polynomial"], (first.maps["polynomial"] + second.maps["polynomial"]) / 2)


def test_what_texels_share_needs_a_number():
    options = {"residual": "half", "base": "phong"}
    first, second = make("phong_srf", options, 3, 4), make("phong_srf", options, 3, 4, seed=1)
    name = next(spec.name for spec in first.specs() if spec.constant)
    second = second.with_maps(**{name: 0.5 * first.maps[name]})
    assert_close(blend(first, second, 0.5).maps[name], 0.75 * first.maps[name])
    with pytest.raises(RangeError, match="weight must be a number; it is a map"):
        blend(first, second, torch.rand(1, 3, 4))
    tilted = distribution(3, 4, 1, ("tilt",))
    with pytest.raises(RangeError, match="and tilt differs"):
        blend(tilted, distribution(3, 4, 1), torch.rand(1, 3, 4))
    assert_close(blend(tilted, add_part(distribution(3, 4), "tilt"), 0.5).maps["tilt"][0, 0, 0], torch.tensor(0.025))


def test_wrong_inputs_are_refused():
    first = distribution(3, 4, 2)
    with pytest.raises(RangeError, match="be of one model; they are distribution and ptm"):
        blend(first, make("ptm", {}, 3, 4), 0.5)
    with pytest.raises(RangeError, match="fresnel_exponent is 5.0 and 1.0"):
        five, one = (distribution(3, 4, 1, ("fresnel",), fresnel_exponent=exponent) for exponent in (5.0, 1.0))
        blend(five, one, torch.full((1, 3, 4), 0.5, dtype=first.dtype))
    assert blend(five, one, 0.25).options["fresnel_exponent"] == 4.0
    with pytest.raises(RangeError, match="share what cannot be mixed"):
        blend(make("pca", {"components": 3}, 3, 4), make("pca", {"components": 3}, 3, 4, seed=1), 0.5)
    with pytest.raises(RangeError, match=r"lie in \[0, 1\]; 1 of 1 values are not, the first is 1.5"):
        blend(first, first, 1.5)
    with pytest.raises(RangeError, match="weight must be finite"):
        blend(first, first, math.nan)
    with pytest.raises(RangeError, match="weight must be a number or a map"):
        blend(first, first, "half")
    with pytest.raises(ShapeError, match=r"a map \[1, 3, 4\]; it is \(3, 4\)"):
        blend(first, first, torch.rand(3, 4))
    with pytest.raises(RangeError, match="at most 12 specular maps together; they have 14"):
        blend(distribution(2, 2, 7), distribution(2, 2, 7, seed=1), 0.5)
