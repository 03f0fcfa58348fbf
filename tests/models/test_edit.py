"""Editing: another map, another size, a part more or less."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
import torch
from tests.models.distributions import ALL_PARTS, distribution, shaded, unit
from tests.models.examples import make
from tests.support import assert_close

from torchmat import RangeError, ShapeError
from torchmat.models.edit import (
    FILTERS, add_part, drop_part, neutral_part, replace_map, resample, resized,
)

SIZES = [(1, 1), (1, 7), (3, 2), (9, 5), (16, 16)]


def by_hand(value, size, tiles):
    """Bilinear with a triangle that widens when it shrinks, one dimension after the other, as sums over all texels."""
    for dim, new in ((1, size[0]), (2, size[1])):
        old = value.shape[dim]
        scale = Fraction(old, new)
        wide = max(scale, Fraction(1))
        weights = torch.zeros(new, old, dtype=torch.float64)
        for target in range(new):
            centre = (Fraction(2 * target + 1, 2)) * scale
            for source in range(-2 * old, 3 * old):
                if not tiles and not 0 <= source < old:
                    continue
                share = float(max(Fraction(0), 1 - abs(Fraction(2 * source + 1, 2) - centre) / wide))
                weights[target, source % old] += share
        weights /= weights.sum(dim=1, keepdim=True)
        value = torch.tensordot(weights, value, dims=([1], [dim])).movedim(0, dim)
    return value


@pytest.mark.parametrize("tiles", [True, False])
@pytest.mark.parametrize(
    ("old", "new"), [((4, 6), (2, 3)), ((3, 5), (7, 4)), ((1, 1), (3, 2)), ((5, 1), (1, 4)), ((9, 2), (2, 9))]
)
def test_bilinear_is_the_widened_triangle(old, new, tiles):
    value = torch.rand(2, *old, dtype=torch.float64)
    assert_close(resample(value, new, "bilinear", tiles), by_hand(value, new, tiles))


def test_shrinking_a_stripe_by_two_by_hand():
    stripe = torch.tensor([[[8.0, 0, 0, 0, 0, 0]]])
    # the triangle reaches 2 texels to each side of a border between two: weights 1, 3, 3, 1 of 8
    assert resample(stripe, (1, 3)).tolist() == [[[3.0, 0.0, 1.0]]]
    found = resample(stripe, (1, 3), tiles=False)
    assert_close(found, torch.tensor([[[8 * 3 / 7, 0.0, 0.0]]]))


def test_area_is_the_mean_and_nearest_takes_what_is_there():
    value = torch.arange(16.0).reshape(1, 4, 4)
    assert resample(value, (2, 2), "area").tolist() == [[[2.5, 4.5], [10.5, 12.5]]]
    assert resample(value, (8, 8), "nearest").tolist() == value.repeat_interleave(2, 1).repeat_interleave(2, 2).tolist()


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("size", SIZES)
def test_a_constant_stays_constant(size, filter):
    for tiles in (True, False):
        assert_close(resample(torch.full((3, 4, 5), 0.3), size, filter, tiles), torch.full((3, *size), 0.3))


@pytest.mark.parametrize("filter", FILTERS)
def test_a_mean_never_leaves_its_range(filter):
    for rows in range(1, 14):
        for columns in range(1, 14):
            found = resample(torch.ones(1, rows, 7), (5, columns), filter)
            assert float(found.max()) <= 1, (rows, columns)
    material = distribution(5, 9, 2, ("fresnel",))
    for side in range(1, 14):
        replace_map(material, "fresnel", torch.ones(1, side, side), filter)


def test_wrapping_commutes_with_rolling():
    value = torch.rand(1, 8, 6, dtype=torch.float64)
    assert_close(resample(value.roll((4, 2), (1, 2)), (4, 3)), resample(value, (4, 3)).roll((2, 1), (1, 2)))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", ["diffuse", "normal", "specular_mask", "fresnel", "rotation", "index", "height", "ambient"])
def test_any_size_is_brought_to_the_material(name, size):
    material = distribution(4, 5, 3, ALL_PARTS, relief=True)
    value = distribution(*size, 3, ALL_PARTS, relief=True, seed=1).maps[name].detach()
    for filter in FILTERS:
        edited = replace_map(material, name, value, filter)
        assert edited.maps[name].shape == material.maps[name].shape
        for other in set(material.maps) - {name}:
            assert torch.equal(edited.maps[other], material.maps[other])
        assert bool(torch.isfinite(shaded(edited)).all())


@pytest.mark.parametrize("name", ["diffuse", *ALL_PARTS, "index", "height", "specular"])
def test_the_same_map_has_the_same_bits(name, dtype):
    material = distribution(4, 5, 2, ALL_PARTS, relief=True, dtype=dtype)
    edited = replace_map(material, name, material.maps[name])
    assert torch.equal(edited.maps[name], material.maps[name])
    assert edited.options == material.options and edited.tiles == material.tiles


def test_directions_stay_unit_vectors():
    material = distribution(4, 5, 1, ALL_PARTS)
    for name, channels in (("normal", 3), ("rotation", 2)):
        value = unit(torch.rand(channels, 9, 7) - 0.5)
        length = replace_map(material, name, value).maps[name].norm(dim=0)
        assert_close(length, torch.ones(4, 5))
    twice = 0.5 * unit(torch.rand(3, 4, 5))
    assert_close(replace_map(material, "normal", twice).maps["normal"], 2 * twice)


def test_opposite_rotations_leave_one_of_them_not_nothing():
    material = distribution(1, 1, 1, ("rotation",))
    value = torch.tensor([[[1.0, -1.0]], [[0.0, 0.0]]])
    assert replace_map(material, "rotation", value).maps["rotation"][0].abs().tolist() == [[1.0]]


def test_rotations_are_filtered_as_vectors():
    angle = torch.tensor([math.radians(170), math.radians(-170)])
    value = torch.stack((torch.cos(angle), torch.sin(angle)))[:, None]
    found = replace_map(distribution(1, 1, 1, ("rotation",)), "rotation", value).maps["rotation"]
    assert_close(found, torch.tensor([[[-1.0]], [[0.0]]]))  # 180 degrees, not 0


def test_painted_weights_sum_to_one_unless_asked():
    material = distribution(2, 2, 2)
    painted = torch.tensor([1.0, 0.6])[:, None, None].expand(2, 2, 2)
    assert_close(replace_map(material, "index", painted).maps["index"], painted / 1.6)
    assert torch.equal(replace_map(material, "index", painted, normalise_index=False).maps["index"], painted)
    with pytest.raises(RangeError, match="index must give each texel a weight; 4 of 4 texels have none"):
        replace_map(material, "index", torch.zeros(2, 2, 2))


def test_specular_maps_may_have_another_side_and_tables_not():
    material = distribution(2, 3, 2, ALL_PARTS)
    assert replace_map(material, "specular", torch.rand(6, 9, 9)).maps["specular"].shape == (6, 9, 9)
    with pytest.raises(ShapeError, match="specular must be square"):
        replace_map(material, "specular", torch.rand(6, 9, 8))
    with pytest.raises(ShapeError, match=r"tilt must be \[1, 1, 91\]"):
        replace_map(material, "tilt", torch.rand(1, 1, 90))


def test_other_models_are_edited_too():
    material = make("ptm", {}, 3, 4)
    value = material.maps["polynomial"].detach()
    assert replace_map(material, "polynomial", value[:, :1]).maps["polynomial"].shape == value.shape
    phong = make("phong_srf", {"residual": "half", "base": "phong"}, 3, 4)
    name = next(spec.name for spec in phong.specs() if spec.constant)
    assert torch.equal(replace_map(phong, name, phong.maps[name]).maps[name], phong.maps[name])
    with pytest.raises(ShapeError, match=name):
        replace_map(phong, name, torch.rand(1, 3, 4))


WRONG = {
    "channels": ("diffuse", torch.rand(1, 4, 5), ShapeError, r"diffuse must be \[3, h, w\]; it is \(1, 4, 5\)"),
    "no channels": ("diffuse", torch.rand(4, 5), ShapeError, "diffuse must be"),
    "empty": ("diffuse", torch.rand(3, 0, 5), ShapeError, "diffuse must be"),
    "codes": ("diffuse", torch.ones(3, 4, 5, dtype=torch.uint8), RangeError, "floating-point tensor; it is torch.uint8"),
    "no tensor": ("diffuse", [1.0], RangeError, "it is list"),
    "negative": ("diffuse", -torch.ones(3, 4, 5), RangeError, r"diffuse must lie in \[0.0, inf\]; 60 of 60"),
    "above": ("fresnel", torch.full((1, 4, 5), 1.5), RangeError, "fresnel must lie in"),
    "negative where it would be averaged": ("diffuse", torch.rand(3, 40, 50) - 0.01, RangeError, "diffuse must lie"),
    "NaN": ("diffuse", torch.full((3, 4, 5), math.nan), RangeError, "diffuse must be finite; 60 of 60 .* Repair"),
    "no direction": ("rotation", torch.zeros(2, 4, 5), RangeError, "rotation must be directions; 20 of 20"),
    "absent height": ("height", torch.zeros(1, 4, 5), RangeError, "it has no height. Use material.on_relief"),
    "absent part": ("tilt", torch.zeros(1, 1, 91), RangeError, "it has no tilt. Use add_part"),
    "typing error": ("difuse", torch.rand(3, 4, 5), RangeError, "Did you mean 'diffuse'"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_maps_are_refused(case):
    name, value, error, text = WRONG[case]
    with pytest.raises(error, match=text):
        replace_map(distribution(4, 5, 1, ("normal", "specular_mask", "fresnel", "rotation")), name, value)


def test_wrong_filter_and_size():
    with pytest.raises(RangeError, match="Did you mean 'bilinear'"):
        replace_map(distribution(), "diffuse", torch.rand(3, 1, 1), "bilinaer")
    with pytest.raises(RangeError, match="size must be two positive numbers"):
        resized(distribution(), (0, 3))


@pytest.mark.parametrize("size", SIZES)
def test_a_resized_material_shades(size):
    material = distribution(4, 5, 3, ALL_PARTS, relief=True)
    found = resized(material, size)
    assert found.size == size and torch.equal(found.maps["specular"], material.maps["specular"])
    assert bool(torch.isfinite(shaded(found)).all())
    assert_close(found.maps["index"].sum(dim=0), torch.ones(size))


@pytest.mark.parametrize("relief", [False, True])
@pytest.mark.parametrize("name", ALL_PARTS)
def test_a_neutral_part_changes_nothing(name, relief, dtype):
    material = distribution(3, 4, 2, tuple(part for part in ALL_PARTS if part != name), relief=relief, dtype=dtype)
    added = add_part(material, name)
    assert name in added.options["parts"] and name in added.maps
    # the tilt's 91 samples are filtered linearly: (1 degree)^2 / 8 = 3.8e-5 off the cosine, and D doubles that at grazing
    assert_close(shaded(added), shaded(material), 2e-3 if name == "tilt" else None)
    back = drop_part(added, name)
    assert back.options["parts"] == material.options["parts"] and torch.equal(shaded(back), shaded(material))


def test_a_part_is_added_with_its_value():
    material = distribution(3, 4, parts=())
    mask = torch.rand(3, 6, 8)
    added = add_part(material, "specular_mask", mask, "area")
    assert added.options["mask_channels"] == 3
    assert_close(added.maps["specular_mask"], mask.reshape(3, 3, 2, 4, 2).mean(dim=(2, 4)))
    assert neutral_part(material, "specular_mask", 3).shape == (3, 3, 4)


def test_whole_numbers_take_the_nearest():
    material = make("local_pca", {"clusters": 3, "components": 2}, 6, 6)
    clusters = torch.tensor([[[0.0, 2.0]]], dtype=torch.float64)
    for filter in FILTERS:
        found = replace_map(material, "cluster", clusters, filter).maps["cluster"][0]
        assert found.tolist() == [[0.0] * 3 + [2.0] * 3] * 6
    assert set(resized(material, (4, 5)).maps["cluster"].flatten().tolist()) <= {0.0, 1.0, 2.0}


def test_wrong_parts_are_refused():
    material = distribution()
    with pytest.raises(RangeError, match="specular_mask is. Use replace_map"):
        add_part(material, "specular_mask")
    with pytest.raises(RangeError, match="tilt is not; the material has specular_mask"):
        drop_part(material, "tilt")
    with pytest.raises(RangeError, match="Did you mean 'fresnel'"):
        add_part(material, "frensel")
    with pytest.raises(RangeError, match="be a distribution material; it is ptm"):
        drop_part(make("ptm", {}, 2, 2), "tilt")
