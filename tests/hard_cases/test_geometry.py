"""Hard cases 3 and 8 to 12 for surfaces with a height: rays, shadow, recovery, and fits over a relief; models are in the table."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.brdf.directions import graze
from tests.fitting.reference_scene import centres, relief_scene
from tests.hard_cases.cases_fitting import left_over
from tests.hard_cases.cases_shading import bumps, shaded
from tests.models.examples import PLAIN, make
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, FitError, RangeError, ShapeError
from torchmat.fitting import RECIPES, predict, recover_geometry
from torchmat.geometry import normals_from_slopes, poisson, slopes_from_height, soft_shadow, trace_view, visible
from torchmat.geometry.rays import texel_centres

OPTIONS = {
    "pca": {"components": 2}, "local_pca": {"clusters": 2, "components": 2}, "rbf": {"components": 2},
    "distribution": {"lobes": 1, "fresnel": True, "rotation": True, "specular_size": 8, "effort": 0.02},
    "neural": {"latent": 2, "hidden": 4, "effort": 0.002},
    "microfacet": {"effort": 0.02, **PLAIN},
}
LIGHT, VIEW = all_pairs(hemisphere(), hemisphere(((0, 1), (30, 3), (60, 4))))


def direction(polar_deg: float, azimuth_deg: float = 0.0, dtype=torch.float64) -> torch.Tensor:
    """A unit direction [3, 1, 1] by its angles."""
    return torch.tensor(graze(math.radians(azimuth_deg), math.cos(math.radians(polar_deg))), dtype=dtype)[:, None, None]


@pytest.mark.parametrize("slope", [math.tan(math.radians(89.9)), 1e8])
def test_3_steep_slopes_give_unit_normals(slope, dtype):
    slopes = torch.tensor([slope, -slope], dtype=dtype)[:, None, None].expand(2, 3, 3).clone().requires_grad_()
    normal = normals_from_slopes(slopes)
    assert_close(normal.norm(dim=0), torch.ones(3, 3, dtype=dtype))
    normal.sum().backward()
    assert bool(torch.isfinite(slopes.grad).all())


@pytest.mark.parametrize("model", RECIPES)
def test_8_tiny_and_huge_values_in_one_btf(model):
    """Columns of 1e-8 beside columns of 1e4, on a relief that moves texels by less than one: the dark are not lost."""
    scene = relief_scene(depth=0.02, offset=0.0, finest=3)
    bright = np.ones((24, 24))
    bright[:, 12:] = 1e12
    btf = Btf.from_tensors((scene.images * 1e-8 * bright).astype(np.float32), scene.light, scene.view)
    assert float(btf.images([0]).max()) > 1e3 > 1e-7 > float(btf.images([0]).min())
    options = {"storage": "float", "measure": False, "holdout": 0.0, **OPTIONS.get(model, {})}
    result = tm.fit(btf, model, geometry=scene.true_height, **options)
    assert all(bool(torch.isfinite(value).all()) for value in result.material.maps.values())
    if model in ("texture", "lambert", "ptm", "lptm", "hsh"):  # the others share lobes or components among texels
        # As dark, for the curve of a screen is another there.
        dark = Btf.from_tensors((scene.images * 1e-8).astype(np.float32), scene.light, scene.view)
        alone = tm.fit(dark, model, geometry=scene.true_height, **options).material
        found, expected = (predict(one, btf, torch.arange(len(btf))) for one in (result.material, alone))
        # One texel of parallax and two of bicubic weights, twice, lie between these columns and the bright ones. Lambert
        # weighs samples against the mean of all texels: measured 2.4e-4, the others 5e-7.
        assert_close(found[..., 5:7], expected[..., 5:7], 1e-3 if model == "lambert" else 1e-5)


# A network of a hundredth of its steps explains half of what it is shown, all others leave far less than a tenth.
LEFT = {"neural": 0.75}


def checked(btf: Btf, model: str, height: torch.Tensor, **options) -> tm.Material:
    """Fit over a height; assert that maps and pictures are finite; return the material."""
    options = {"holdout": 0.0, "measure": False, **OPTIONS.get(model, {}), **options}
    material = tm.fit(btf, model, geometry=height, **options).material
    assert all(bool(torch.isfinite(value).all()) for value in material.maps.values())
    shaded(material, btf.light[:3, :, None, None].float(), btf.view[:3, :, None, None].float())
    return material


@pytest.mark.parametrize("model", RECIPES)
def test_9_a_black_texel_and_one_lit_once(model):
    images = plausible_images(LIGHT, VIEW, 8, 8)
    images[:, :, 2, 3] = 0
    weight = np.ones((len(LIGHT), 8, 8))
    weight[:, 5, 5] = 0
    weight[4, 5, 5] = 1
    btf = Btf.from_tensors(images.astype(np.float32), LIGHT, VIEW, weight)
    material = checked(btf, model, bumps(8, 8, 0.02, torch.float32))
    if model in ("texture", "lambert"):
        # A relief of 0.16 texels at most: neighbours blend in by less than half.
        albedo = material.maps["albedo"].detach()
        assert float(albedo[:, 2, 3].max()) < 0.5 * float(albedo.mean())


@pytest.mark.parametrize("model", RECIPES)
@pytest.mark.parametrize("which", ["one light", "one view", "coplanar lights", "two identical", "one sample", "two samples"])
def test_9_directions_that_do_not_determine_a_model_are_explained_and_others_not_made_too_bright(model, which):
    line = np.stack((np.sin(np.linspace(-1, 1, 9)), np.zeros(9), np.cos(np.linspace(-1, 1, 9))), axis=1)
    light, view = {
        "one light": all_pairs(LIGHT[4:5], hemisphere(((0, 1), (40, 5)))), "one view": all_pairs(hemisphere(), VIEW[40:41]),
        "coplanar lights": all_pairs(line, VIEW[:1]), "two identical": (LIGHT[[0, 5, 5, 9]], VIEW[[0, 5, 5, 9]]),
        "one sample": (LIGHT[7:8], VIEW[7:8]), "two samples": (LIGHT[7:9], VIEW[7:9]),
    }[which]
    btf = Btf.from_tensors(plausible_images(light, view, 6, 6).astype(np.float32), light, view)
    count = min(2, len(light))
    options = {"pca": {"components": count}, "local_pca": {"clusters": 2, "components": count}, "rbf": {"components": 3 * count}}.get(model, {})
    material = checked(btf, model, bumps(6, 6, 0.05, torch.float32), **options)
    # Measured: at most 0.071 of one view. One sample a texel is met by closed forms, two by what has unknowns enough.
    met = {"one sample": set(RECIPES) - {"local_pca", "distribution", "neural", "microfacet"}, "two samples": {"ptm", "hsh", "pca", "phong_srf"}}
    assert left_over(material, btf) < (1e-6 if model in met.get(which, ()) else LEFT.get(model, 0.09))
    with torch.no_grad():
        elsewhere = material.shade(*(torch.from_numpy(d).float()[:, :, None, None] for d in all_pairs(hemisphere(), hemisphere())))
    # Measured 1.76, and 2.11 where codes of a screen go on above white.
    most = 2.5 if model in ("ptm", "lptm", "hsh") else 2.0
    assert float(elsewhere.max()) < most * float(btf.images(torch.arange(len(btf))).max())


@pytest.mark.parametrize("which", ["one light", "coplanar lights", "one sample", "two identical"])
def test_9_geometry_is_not_guessed_from_lights_that_do_not_show_it(which):
    line = np.stack((np.sin(np.linspace(-1, 1, 9)), np.zeros(9), np.cos(np.linspace(-1, 1, 9))), axis=1)
    views = hemisphere(((0, 1), (30, 3), (60, 4)))
    light, view = {
        "one light": all_pairs(LIGHT[4:5], views), "coplanar lights": all_pairs(line, views),
        "one sample": (LIGHT[7:8], VIEW[:1]), "two identical": (LIGHT[[7, 7, 8]], VIEW[[0, 0, 0]]),
    }[which]
    btf = Btf.from_tensors(plausible_images(light, view, 6, 6).astype(np.float32), light, view)
    with pytest.raises(RangeError, match="lights must be at least 3 and not in one plane; .* stays undetermined"):
        tm.fit(btf, "texture", geometry="recover", holdout=0)


def test_9_identical_samples_change_no_height():
    scene = relief_scene(views=((0, 1), (35, 3), (60, 3)), lights=((15, 1), (45, 3)))
    once = recover_geometry(scene.btf()).relief.height
    rows = np.r_[np.arange(28), np.arange(28)]
    twice = Btf.from_tensors(scene.images[rows].astype(np.float32), scene.light[rows], scene.view[rows])
    found = recover_geometry(twice).relief.height
    # Of 56 rows the rank is 14, of 28 it is 7: measured 2.3 % of the range.
    assert float((found - once).abs().max()) < 0.03 * np.ptp(scene.height)


def test_9_a_btf_of_one_black_texel_in_all_samples_recovers():
    scene = relief_scene()
    images = scene.images.copy()
    images[:, :, 5, 6] = 0
    relief = recover_geometry(Btf.from_tensors(images.astype(np.float32), scene.light, scene.view)).relief
    assert bool(torch.isfinite(relief.height).all()) and bool(torch.isfinite(relief.normal).all())
    # Measured 2.1 % of the range at worst, as without the black texel.
    assert np.abs(relief.height[0].numpy() - scene.height).max() < 0.03 * np.ptp(scene.height)


def test_9_all_black_is_flat():
    btf = Btf.from_tensors(np.zeros((len(LIGHT), 3, 6, 6), np.float32), LIGHT, VIEW)
    relief = recover_geometry(btf).relief
    assert torch.equal(relief.height, torch.zeros(1, 6, 6))
    assert not bool(tm.fit(btf, "lambert", geometry="recover", measure=False).material.maps["albedo"].any())


SIZES = [(1, 1), (1, 9), (9, 1), (3, 5), (7, 13)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("tiles", [True, False])
def test_10_rays_and_slopes_on_odd_sizes(size, tiles, dtype):
    height = (torch.rand(1, *size, dtype=dtype) * 0.2).requires_grad_()
    views = torch.stack([direction(angle, 35, dtype) for angle in (0, 50, 80)])
    hits = trace_view(height, views, tiles=tiles)
    lit = soft_shadow(height, views, tiles=tiles)
    normal = normals_from_slopes(slopes_from_height(height, tiles=tiles))
    assert hits.uv.shape == (3, 2, *size) and lit.shape == (3, 1, *size) and normal.shape == (3, *size)
    assert torch.equal(hits.uv[0], texel_centres(*size, dtype))
    assert float(hits.height.detach().min()) >= float(height.detach().min()) - 1e-5
    assert float(hits.height.detach().max()) <= float(height.detach().max()) + 1e-5
    (hits.uv.sum() + lit.sum() + normal.sum()).backward()
    assert bool(torch.isfinite(height.grad).all())
    found = poisson(slopes_from_height(height.detach(), tiles=tiles), tiles=tiles)
    assert found.shape == (1, *size) and bool(torch.isfinite(found).all())


@pytest.mark.parametrize("model", RECIPES)
@pytest.mark.parametrize("size", [(1, 9), (9, 1), (7, 13)])
def test_10_fits_over_odd_sizes_explain_their_samples(model, size):
    btf = Btf.from_tensors(plausible_images(LIGHT, VIEW, *size).astype(np.float32), LIGHT, VIEW)
    height = torch.rand(1, *size) * 0.05
    material = checked(btf, model, height)
    assert material.size == size
    # Of a relief of noise, whose colours no parallax holds together: measured 0.136 of a texture.
    assert left_over(material, btf) < LEFT.get(model, 0.16)


@pytest.mark.parametrize("size", SIZES)
def test_10_recovery_of_odd_sizes(size):
    btf = Btf.from_tensors(plausible_images(LIGHT, VIEW, *size).astype(np.float32), LIGHT, VIEW)
    relief = recover_geometry(btf).relief
    assert relief.height.shape == (1, *size) and bool(torch.isfinite(relief.height).all())
    assert bool(torch.isfinite(tm.fit(btf, "lambert", geometry="recover").material.maps["albedo"]).all())


@pytest.mark.parametrize("tiles", [True, False])
def test_10_a_map_of_4096_columns(tiles):
    u, _ = centres(4, 4096)
    # 40 waves a texture width and 0.001 high; a slope of at most a quarter.
    height = torch.from_numpy(0.001 * np.cos(2 * np.pi * 40 * u))[None]
    view = direction(60, 0)
    hits = trace_view(height, view, tiles=tiles)
    inner = slice(100, -100)
    met = 0.001 * torch.cos(2 * math.pi * 40 * hits.uv[0])
    assert float((met - hits.height[0])[:, inner].abs().max()) < 1e-6  # measured 4.3e-7: 102 texels a wave, seen as straight lines
    # At 60 degrees a slope of 0.25 hides nothing (1 / tan 60 = 0.58); at 80 it does.
    assert float(soft_shadow(height, view, tiles=tiles).min()) == 1.0
    assert float(soft_shadow(height, direction(80, 0), tiles=tiles)[..., inner].min()) == 0.0
    slopes = slopes_from_height(height, tiles=tiles)
    expected = -0.001 * 2 * np.pi * 40 * np.sin(2 * np.pi * 40 * u[:, inner])
    assert float((slopes[0][:, inner] - torch.from_numpy(expected)).abs().max()) < 2e-4
    found = poisson(slopes, tiles=tiles)
    assert_close((found - found.mean())[..., inner], (height - height.mean())[..., inner], 2e-3)  # measured 9e-4


@pytest.mark.parametrize("model", ["texture", "lambert", "hsh"])
def test_10_one_sample_of_a_relief_is_reproduced_where_it_is_lit(model):
    scene = relief_scene(depth=0.05)
    light, view = scene.light[:1], scene.view[:1]
    btf = Btf.from_tensors(scene.images[:1].astype(np.float32), light, view)
    material = checked(btf, model, scene.true_height, storage="float")
    # From above no texel moves. The ridge of lambert's two unknowns takes 8e-4 of the value.
    assert_close(predict(material, btf, torch.tensor([0])), btf.images([0]), 1e-3 if model == "lambert" else 1e-5)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_11_images_and_heights_that_are_not_finite_are_refused(bad):
    scene = relief_scene()
    images = scene.images.astype(np.float32)
    images[3, 1, 4, 5] = bad
    with pytest.raises(RangeError, match=r"images must be finite; 1 of .*\(3, 1, 4, 5\)"):
        Btf.from_tensors(images, scene.light, scene.view)
    height = scene.true_height.clone()
    height[0, 2, 1] = bad
    with pytest.raises(RangeError, match=r"geometry must be finite; 1 of 576 .*\(0, 2, 1\)"):
        tm.fit(scene.btf(), "texture", geometry=height)
    for ask in (trace_view, soft_shadow, visible):
        with pytest.raises(RangeError, match="height must be finite"):
            ask(height, direction(30))
    with pytest.raises(RangeError, match="height"):
        make("texture", {}, 24, 24).on_relief(height)


def test_11_a_height_of_another_size_is_refused_by_material_and_fit():
    scene = relief_scene()
    with pytest.raises(ShapeError, match="geometry must be"):
        tm.fit(scene.btf(), "texture", geometry=torch.rand(1, 12, 24))
    with pytest.raises(ShapeError, match=r"have the size of the other maps"):
        make("texture", {}, 24, 24).on_relief(torch.rand(1, 12, 24, dtype=torch.float64))


def test_11_no_view_near_the_normal_is_refused():
    light, view = all_pairs(hemisphere(), hemisphere(((75, 7),)))
    btf = Btf.from_tensors(plausible_images(light, view).astype(np.float32), light, view)
    with pytest.raises(FitError, match="at 75 degrees"):
        tm.fit(btf, "lambert", geometry="recover")


def test_12_an_open_border_does_not_wrap():
    height = bumps(12, 16, 0.4)
    view = direction(75, 0)
    wrapped, open_ = (trace_view(height, view, tiles=tiles).uv for tiles in (True, False))
    assert float((wrapped - open_).abs().max()) > 0.01


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_12_turning_the_relief_by_90_degrees_turns_the_picture(turn):
    height = bumps(16, 16, 0.4)
    albedo = torch.rand(3, 16, 16, dtype=torch.float64)
    plain = make("texture", {}, 16, 16).with_maps(albedo=albedo, height=height)
    turned = plain.with_maps(albedo=albedo.rot90(turn, (-2, -1)), height=height.rot90(turn, (-2, -1)))
    with torch.no_grad():
        expected = plain.shade(direction(65, 20), direction(75, 50)).rot90(turn, (-2, -1))
        found = turned.shade(direction(65, 20 + 90 * turn), direction(75, 50 + 90 * turn))
    assert_close(found, expected, 1e-9)


@pytest.mark.parametrize("wall", [0, 6, 14])
def test_12_a_step_of_the_full_range_hides_and_shades_what_lies_behind_it(wall, dtype):
    height = torch.zeros(1, 16, 16, dtype=dtype)
    columns = torch.arange(wall, wall + 2) % 16
    height[..., columns] = 0.1
    view = direction(75, 0, dtype)  # from the right; the step hides 0.1 tan 75 = 0.37 widths, 6 texels, to its left
    behind = [(wall - step) % 16 for step in (2, 3, 4, 5)]
    free = [(wall + step) % 16 for step in (3, 4, 5, 6)]
    seen, lit = visible(height, view)[0, 8], soft_shadow(height, view)[0, 8]
    assert not bool(seen[behind].any()) and bool(seen[free].all())
    assert float(lit[behind].max()) == 0.0 and float(lit[free].min()) == 1.0
    hits = trace_view(height, view)
    # Where the plane's ray meets the wall the picture shows the wall, high up or on its flank.
    assert float(hits.height[0, 8, behind].min()) > 0.01
    gap = (hits.uv[0, 8] - texel_centres(16, 16, dtype)[0, 8]) - hits.height[0, 8] * math.tan(math.radians(75))
    assert float(gap.abs().max()) < 1e-5
