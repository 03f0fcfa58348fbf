"""The shading map: the chapter's formulas by hand, the stack against loops, overflow, sectors, other BRDFs."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.models.examples import assert_same, directions, make, per_image, per_texel
from tests.support import assert_close

from torchmat.brdf.analytic_brdf import AnalyticBrdf
from torchmat.brdf.base import Brdf
from torchmat.errors import RangeError, ShapeError
from torchmat.models import ShadingMap
from torchmat.models.shading_map import assemble, layer_place, layer_weights, look_up_layer, sector_weights

UP = (0.0, 0.0, 1.0)


def plane(direction, dtype=torch.float64) -> torch.Tensor:
    return torch.tensor(direction, dtype=dtype)[:, None, None]


def grey(values, height=1, width=1, dtype=torch.float64) -> torch.Tensor:
    """Return flat grey images [k, 3, H, W] of the given values."""
    return torch.tensor(values, dtype=dtype)[:, None, None, None].expand(-1, 3, height, width).contiguous()


def lambert_map(slices, brightest=1.0, dtype=torch.float64, **options) -> ShadingMap:
    """Return a 1 x 1 grey map under a white Lambert BRDF, whose r is the cosine of the light."""
    maps = {
        "slices": grey(slices, dtype=dtype).flatten(0, 1), "lobe": torch.ones(3, dtype=dtype),
        "brightest": torch.tensor([brightest], dtype=dtype),
    }
    return ShadingMap(maps, slices=len(slices), brdf="lambert", **options)


def lit(material, cosine) -> float:
    """Return the red value under a light of that cosine, seen from above."""
    light = plane((math.sqrt(1 - cosine * cosine), 0.0, cosine), material.dtype)
    return float(material.shade(light, plane(UP, material.dtype))[0, 0, 0].detach())


def test_assemble_equation_1_by_hand():
    # a_max = 1, r = 0, .25, .5, .75, 1. Between .1 and .4 at a half; between .4 and 1 at 1/6 and 7/12.
    slices, brightest = assemble(grey([0.1, 0.4, 1.0]), 5)
    assert slices.shape == (15, 1, 1) and brightest.tolist() == [1.0]
    assert_same(slices[::3, 0, 0], torch.tensor([0, 0.25, 0.5, 0.75, 1], dtype=torch.float64))


def test_assemble_blends_are_of_the_two_bracketing_images():
    images = torch.tensor([[0.2, 0.0], [0.0, 0.8], [1.0, 0.6]], dtype=torch.float64)  # means .1, .4, .8
    slices, brightest = assemble(images[:, None, None].expand(-1, 3, -1, -1).contiguous(), 5)
    stack = slices.unflatten(0, (5, 3))[:, 1, 0]
    assert float(brightest) == pytest.approx(0.8, rel=1e-14)
    expected = torch.tensor([[0, 0], [0.4 / 3, 0.8 / 3], [0, 0.8], [0.5, 0.7], [1.0, 0.6]], dtype=torch.float64)
    assert_same(stack, expected)  # r = .2: a third of the way from .1 to .4


def test_assemble_below_the_darkest_image_black_takes_part():
    slices, _ = assemble(grey([0.8, 1.0]), 5)
    images = torch.tensor([[0.0, 1.6], [2.0, 0.0]], dtype=torch.float64)[:, None, None].expand(-1, 3, -1, -1)
    stack = assemble(images, 5)[0].unflatten(0, (5, 3))[:, 0, 0]
    assert_same(slices[::3, 0, 0], torch.tensor([0, 0.25, 0.5, 0.75, 1], dtype=torch.float64))
    assert_same(stack[:4, 1], torch.tensor([0, 0.5, 1.0, 1.5], dtype=torch.float64))  # the darker image alone
    assert not bool(stack[:4, 0].any())


def test_assemble_against_a_loop():
    random = np.random.default_rng(0)
    images = random.random((7, 3, 3, 4)) * random.random((7, 1, 1, 1))
    order = sorted(range(7), key=lambda k: images[k].mean())
    known = [(0.0, np.zeros((3, 3, 4))), *((images[k].mean(), images[k]) for k in order)]
    expected = []
    for i in range(9):
        r = known[-1][0] * i / 8
        for (low, dark), (high, bright) in zip(known, known[1:], strict=False):
            if low <= r <= high:
                blend = dark + (bright - dark) * (r - low) / (high - low)
        expected.append(blend)
    slices, brightest = assemble(torch.from_numpy(images), 9)
    assert_close(slices.unflatten(0, (9, 3)), torch.from_numpy(np.stack(expected)))
    assert float(brightest) == pytest.approx(known[-1][0], rel=1e-14)


def test_assemble_means_grow_linearly_from_black(dtype):
    slices, brightest = assemble(torch.rand(10, 3, 8, 9, dtype=dtype) * torch.rand(10, 1, 1, 1, dtype=dtype), 8)
    means = slices.unflatten(0, (8, 3)).mean(dim=(1, 2, 3))
    assert slices.dtype == brightest.dtype == dtype
    assert_close(means, brightest * torch.arange(8, dtype=dtype) / 7, 1e-5 if dtype == torch.float32 else 1e-12)
    assert not bool(slices[:3].any())


def test_assemble_order_of_the_images_does_not_matter():
    images = torch.rand(6, 3, 4, 4, dtype=torch.float64) * torch.rand(6, 1, 1, 1, dtype=torch.float64)
    shuffled = images[torch.tensor([3, 0, 5, 1, 4, 2])]
    assert torch.equal(assemble(images, 8)[0], assemble(shuffled, 8)[0])


def test_assemble_images_of_one_mean():
    # Two of mean .5: slices above start at the second, slices up to it end at the first.
    images = grey([0.5, 0.5, 1.0], width=2)
    images[0, :, :, 0], images[0, :, :, 1] = 0.25, 0.75
    stack = assemble(images, 5)[0].unflatten(0, (5, 3))[:, 0, 0]
    expected = torch.tensor([[0, 0], [0.125, 0.375], [0.25, 0.75], [0.75, 0.75], [1, 1]], dtype=torch.float64)
    assert_same(stack, expected)


def test_assemble_identical_images():
    slices, _ = assemble(grey([0.6, 0.6, 0.6]), 4)
    assert_same(slices[::3, 0, 0], 0.6 * torch.arange(4, dtype=torch.float64) / 3)


@pytest.mark.parametrize("values", [[0.7], [0.0, 0.7], [0.0, 0.0, 0.7]])
def test_assemble_one_image_and_black_ones(values):
    slices, brightest = assemble(grey(values), 4)
    assert_same(slices[::3, 0, 0], 0.7 * torch.arange(4, dtype=torch.float64) / 3)
    assert float(brightest) == pytest.approx(0.7, rel=1e-14)


def test_assemble_two_slices_are_black_and_the_brightest_image():
    images = torch.rand(4, 3, 2, 2)
    slices, _ = assemble(images, 2)
    assert torch.equal(slices[3:], images[images.mean(dim=(1, 2, 3)).argmax()])
    assert not bool(slices[:3].any())


@pytest.mark.parametrize("scale", [1e-8, 1e4])
def test_assemble_extreme_values(scale, dtype):
    slices, brightest = assemble(grey([0.1, 0.4, 1.0], dtype=dtype) * scale, 5)
    assert_close(slices[::3, 0, 0] / scale, torch.arange(5, dtype=dtype) / 4, 1e-6)
    assert float(brightest) == pytest.approx(scale, rel=1e-6)


@pytest.mark.parametrize("count", [1, 0, -3, 65, 2.0, True])
def test_assemble_number_of_slices_is_checked(count):
    with pytest.raises(RangeError, match="assemble: slices must be a whole number from 2 to 64.*Slice 0 is black"):
        assemble(grey([1.0]), count)


def test_assemble_bad_images_by_name():
    for bad in (torch.rand(3, 4, 4), torch.rand(2, 4, 4, 4), torch.rand(0, 3, 4, 4), torch.ones(2, 3, 4, 4).long()):
        with pytest.raises(ShapeError, match="assemble: images must be floating point"):
            assemble(bad)
    with pytest.raises(RangeError, match="images must be finite; 1 of 12 values"):
        assemble(torch.tensor([1.0, float("nan"), *[1.0] * 10]).reshape(1, 3, 2, 2))
    with pytest.raises(RangeError, match="images must be at least 0; the least value is -0.5"):
        assemble(grey([-0.5, 1.0]))
    with pytest.raises(RangeError, match="hold one that is not black; all 2 are"):
        assemble(grey([0.0, 0.0]))


def test_the_chapters_phong_by_hand():
    # L = (.6, 0, .8), V = +z, R = +z: R.L = .8. k_d = .3, k_s = .1, n = 2: pi (.3 / pi + .1 * 4 / (2 pi) .64) .8
    r = (0.3 + 0.1 * 4 / 2 * 0.64) * 0.8
    maps = {
        "slices": grey([0.0, 1.0, 10.0]).flatten(0, 1), "brightest": torch.tensor([0.5], dtype=torch.float64),
        "lobe": torch.tensor([0.3] * 3 + [0.1] * 3 + [math.log(2)], dtype=torch.float64),
    }
    material = ShadingMap(maps, slices=3)
    light, view = plane((0.6, 0.0, 0.8)), plane(UP)
    assert float(material.brightness(light, view).detach()) == pytest.approx(r, rel=1e-14)
    place = r / 0.5 * 2  # 1.37: between the second and the third slice
    assert float(material.shade(light, view)[0, 0, 0].detach()) == pytest.approx(1 + 9 * (place - 1), rel=1e-14)


def test_r_is_the_mean_over_the_channels():
    material = lambert_map([0.0, 1.0]).with_maps(lobe=torch.tensor([0.9, 0.3, 0.0], dtype=torch.float64))
    assert lit(material, 0.5) == pytest.approx(0.2)


@pytest.mark.parametrize("cosine, expected", [(0.2, 0.2), (0.4, 0.4), (0.5, 0.55), (0.8, 1.0), (1.0, 1.0)])
def test_clamp_shows_the_last_slice(cosine, expected):
    # Slices 0, .4, 1 at r = 0, .4, .8.
    assert lit(lambert_map([0.0, 0.4, 1.0], 0.8), cosine) == pytest.approx(expected)


@pytest.mark.parametrize("cosine, expected", [(0.2, 0.2), (0.8, 1.0), (1.0, 1.25)])
def test_scale_brightens_the_last_slice(cosine, expected):
    assert lit(lambert_map([0.0, 0.4, 1.0], 0.8, overflow="scale"), cosine) == pytest.approx(expected)


def test_ambient_level_is_added_before_the_look_up():
    material = lambert_map([0.0, 0.4, 1.0], 0.8, ambient_level=0.1)
    assert lit(material, 0.2) == pytest.approx(0.3)
    assert lit(material, 0.75) == pytest.approx(1.0)
    below = material.shade(plane((1.0, 0.0, 0.0)), plane(UP))
    assert not bool(below.any())


@pytest.mark.parametrize("lobe", [(-0.5, 0.5, 0.5, 0, 0, 0, 1), (0.5, 0.5, 0.5, 0, 0, 0, -200)])
def test_a_brdf_beyond_its_formulas_bounds_is_refused(lobe):
    material = make("shading_map", {"slices": 3, "brdf": "ggx", "overflow": "scale", "azimuths": 4}, 1, 2)
    with pytest.raises(RangeError, match="diffuse_r|roughness"):
        material.with_maps(lobe=torch.tensor(lobe, dtype=torch.float64))


def test_filtering_is_trilinear():
    material = make("shading_map", {"slices": 4, "brdf": "phong"}, 1, 2)
    light, view = per_image(directions(1))[0], per_image(directions(1, seed=2))[0]
    place = float((material.brightness(light, view) / material.maps["brightest"]).detach() * 3)
    layer = min(int(place), 2)
    stack = material.maps["slices"].detach().unflatten(0, (4, 3))[:, :, 0]
    sliced = stack[layer] + (stack[layer + 1] - stack[layer]) * (min(place, 3) - layer)
    uv = torch.tensor([0.25 + 0.3 * 0.5, 0.5], dtype=torch.float64)[:, None, None]  # .3 of the way between texels
    assert_same(material.shade_at(uv, light, view)[:, 0, 0], sliced[:, 0] + 0.3 * (sliced[:, 1] - sliced[:, 0]))


@pytest.mark.parametrize("count", [2, 3, 8])
def test_the_three_ways_agree(count, dtype):
    stack = torch.rand(count, 3, 2, 3, dtype=dtype)
    places = torch.cat((torch.rand(9, dtype=dtype) * (count - 1), torch.arange(count).to(dtype)))[:, None, None, None]
    batch = look_up_layer(stack, places)
    for number, place in enumerate(places):
        low = min(int(place), count - 2)
        expected = stack[low] + (stack[low + 1] - stack[low]) * (place - low)
        assert_same(batch[number], expected)
        assert_same(look_up_layer(stack, place), expected)
        assert_same(look_up_layer(stack, place.expand(1, 2, 3).contiguous()), expected)
    assert_same(look_up_layer(stack, places.expand(-1, 1, 2, 3).contiguous()), batch)


def test_weights_sum_to_one(dtype):
    place = torch.linspace(0, 7, 50, dtype=dtype)[:, None, None, None]
    weights = layer_weights(place, 8)
    assert_same(weights.sum(dim=1, keepdim=True), torch.ones_like(place))
    assert int((weights > 0).sum(dim=1).max()) <= 2


@pytest.mark.parametrize("r", [0.0, 1e-30, 0.3, 1.0, 1e30])
@pytest.mark.parametrize("brightest", [0.0, 1e-30, 1.0, 1e30])
def test_the_place_is_finite_at_extremes(r, brightest, dtype):
    leaves = [torch.full((1, 1, 1), x, dtype=dtype, requires_grad=True) for x in (r, brightest)]
    place = layer_place(*leaves, 8)
    place.sum().backward()
    assert 0 <= float(place.detach()) <= 7
    assert all(bool(torch.isfinite(leaf.grad).all()) for leaf in leaves)
    assert float(place.detach()) == pytest.approx(0 if brightest == 0 else 7 * min(1, r / brightest))


def test_a_black_stack_is_black(dtype):
    material = lambert_map([0.0, 0.0], 0.0, dtype=dtype, overflow="scale")
    value = material.shade(plane(UP, dtype), plane(UP, dtype))
    value.sum().backward()
    assert not bool(value.any())
    assert all(bool(torch.isfinite(p.grad).all()) for p in material.parameters() if p.grad is not None)


def test_highlight_gradients_reach_slices_brdf_and_scale():
    material = lambert_map([0.0, 0.4, 1.0], 0.8)
    material.shade(plane((0.8, 0.0, 0.6)), plane(UP)).sum().backward()
    # r = .6 lies halfway between .4 and .8: each slice gets half; d value / d r = .6 / .4 a channel.
    assert_same(material.maps["slices"].grad[3:].flatten(), torch.full((6,), 0.5, dtype=torch.float64))
    assert_same(material.maps["lobe"].grad, torch.full((3,), 3 * 1.5 * 0.6 / 3, dtype=torch.float64))
    assert_same(material.maps["brightest"].grad, torch.tensor([-3 * 1.5 * 0.6 / 0.8], dtype=torch.float64))


def test_sectors_one_sector_is_the_chapters():
    assert torch.equal(sector_weights(per_texel(2, 3), 1), torch.ones(1, 2, 3, dtype=torch.float64))


@pytest.mark.parametrize("count", [2, 3, 4, 8])
def test_sectors_weights_sum_to_one_and_are_not_negative(count, dtype):
    weights = sector_weights(per_image(directions(200, dtype)), count)
    assert weights.shape == (200, count, 1, 1) and float(weights.min()) >= 0
    assert_same(weights.sum(dim=1), torch.ones(200, 1, 1, dtype=dtype))


@pytest.mark.parametrize("count", [2, 4, 5])
def test_sectors_at_a_sectors_azimuth_it_has_all_but_the_poles_share(count):
    for sector in range(count):
        azimuth = 2 * math.pi * sector / count
        light = plane((0.6 * math.cos(azimuth), 0.6 * math.sin(azimuth), 0.8))
        weights = sector_weights(light, count)[:, 0, 0]
        expected = torch.full((count,), 0.4 / count, dtype=torch.float64)
        expected[sector] += 0.6
        assert_same(weights, expected, 1e-10)


def test_sectors_last_and_first_sector_are_neighbours():
    azimuth = 2 * math.pi * 3.5 / 4
    weights = sector_weights(plane((math.cos(azimuth), math.sin(azimuth), 0.0)), 4)[:, 0, 0]
    assert_same(weights, torch.tensor([0.5, 0, 0, 0.5], dtype=torch.float64), 1e-10)


def test_sectors_equal_at_the_normal_with_finite_gradients(dtype):
    for direction in (UP, (1e-20, -1e-20, 1.0), (-0.0, 0.0, 1.0), (1e-30, 0.0, 1.0)):
        light = plane(direction, dtype).requires_grad_()
        weights = sector_weights(light, 4)
        assert_same(weights.flatten(), torch.full((4,), 0.25, dtype=dtype))
        (weights * torch.arange(4, dtype=dtype)[:, None, None]).sum().backward()
        assert bool(torch.isfinite(light.grad).all())


def test_sectors_gradcheck():
    light = per_image(directions(5, seed=3)).requires_grad_()
    assert torch.autograd.gradcheck(lambda d: sector_weights(d, 5), [light])


def test_sectors_equal_stacks_are_one_stack():
    one = make("shading_map", {"slices": 4, "brdf": "phong"})
    maps = {**one.maps, "slices": one.maps["slices"].repeat(3, 1, 1)}
    three = ShadingMap(maps, slices=4, azimuths=3)
    light, view = per_image(directions(6)), per_image(directions(6, seed=2))
    assert_same(three.shade(light, view), one.shade(light, view))


def test_isotropic_says_what_turning_changes():
    assert lambert_map([0.0, 1.0]).isotropic
    assert lambert_map([0.0, 1.0]).with_brdf(AnalyticBrdf("ggx", dtype=torch.float64)).isotropic
    assert not lambert_map([0.0, 1.0]).with_brdf(AnalyticBrdf("ward", dtype=torch.float64)).isotropic
    assert not make("shading_map", {"slices": 3, "brdf": "ggx", "azimuths": 4}).isotropic


def test_with_brdf_takes_a_formulas_parameters():
    brdf = AnalyticBrdf("phong", diffuse=0.3, specular=0.1, exponent=20, dtype=torch.float64)
    material = lambert_map([0.0, 1.0], 100.0, overflow="scale", tiles=False, storage="png8").with_brdf(brdf)
    light, view = per_image(directions(6)), per_image(directions(6, seed=2))
    assert_same(material.brightness(light, view), brdf.shade(light, view).mean(dim=1, keepdim=True))
    assert (material.options["brdf"], material.options["overflow"], material.tiles) == ("phong", "scale", False)
    assert material.storage == "png8" and material.parameters_by_name["diffuse_r"] == 0.3


def test_any_isotropic_brdf_becomes_a_table():
    class Tilted(Brdf):
        name = "tilted"
        reciprocal = True
        dtype = torch.float64

        def value(self, light, view):
            cosine = (light * view).sum(dim=-3, keepdim=True)
            return (0.2 + 0.3 * cosine) * light[..., 2:3, :, :] * torch.ones_like(light)

    material = lambert_map([0.0, 1.0]).with_brdf(Tilted())
    assert material.options["brdf"] == "table" and "lobe" not in material.maps
    assert material.maps["reflectance"].shape == (1, 90, 45 * 36) and material.parameters_by_name == {}
    light, view = per_image(directions(40, lowest=0.3)), per_image(directions(40, seed=2, lowest=0.3))
    expected = Tilted().shade(light, view).mean(dim=1, keepdim=True)
    assert_same(material.brightness(light, view), expected, 2e-3)  # the bins are 2 degrees wide


def test_an_anisotropic_brdf_that_is_no_formula_is_refused():
    class Brushed(Brdf):
        name = "brushed"
        isotropic = False

    with pytest.raises(RangeError, match="brdf must be isotropic"):
        lambert_map([0.0, 1.0]).with_brdf(Brushed())


def test_a_table_of_another_shape_is_refused():
    maps = {**lambert_map([0.0, 1.0]).maps, "reflectance": torch.ones(1, 4, 37, dtype=torch.float64)}
    del maps["lobe"]
    with pytest.raises(ShapeError, match=r"reflectance must be \[1, half, 36 \* difference\]; it is \(1, 4, 37\)"):
        ShadingMap(maps, slices=2, brdf="table")


def test_a_table_that_a_half_cannot_hold_is_exported():
    material = make("shading_map", {"slices": 2, "brdf": "table"}, dtype=torch.float32)
    material = material.with_maps(reflectance=torch.full((1, 2, 36), 1e6))
    assert torch.equal(material.as_exported().maps["reflectance"], material.maps["reflectance"])


@pytest.mark.parametrize("options, words", [
    ({"slices": 1}, "slices must be a whole number from 2 to 64"), ({"slices": True}, "slices must be"),
    ({"azimuths": 0}, "azimuths must be a whole number from 1 to 36"), ({"azimuths": 2.0}, "azimuths must be"),
    ({"brdf": "fong"}, r"brdf must be one of .*Did you mean 'phong'\?"),
    ({"overflow": "clip"}, "overflow must be one of 'clamp', 'scale'"),
    ({"ambient_level": -0.1}, "ambient_level must be at least 0"),
    ({"ambient_level": math.nan}, "ambient_level must be at least 0"),
])
def test_bad_options_by_name(options, words):
    maps = dict(lambert_map([0.0, 1.0]).maps)
    with pytest.raises(RangeError, match=words):
        ShadingMap(maps, **{"slices": 2, "brdf": "lambert", **options})


def test_textures_are_named_by_slice_and_sector():
    one = make("shading_map", {"slices": 4, "brdf": "phong"})
    assert [name for _, name, *_ in one.textures()] == ["slices_0", "slices_1", "slices_2", "slices_3"]
    four = make("shading_map", {"slices": 3, "brdf": "ggx", "azimuths": 4})
    assert [name for _, name, *_ in four.textures()][2:4] == ["slices_0_2", "slices_1_0"]
    assert (one.bytes_per_texel, four.bytes_per_texel) == (2 * 3 * 4, 2 * 3 * 3 * 4)
