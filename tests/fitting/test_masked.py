"""Fits of an object that does not fill its images: what is outside of its mask counts nowhere, whatever it shows."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat.fitting.fewer_texels import averaged
from torchmat.metrics import SampleErrors
from torchmat.models.masked import cut_out, neutral_outside

ROWS, COLUMNS = 8, 10
LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (30, 5), (60, 6))), hemisphere(((0, 1), (25, 4), (50, 4))))
IMAGES = plausible_images(LIGHT, VIEW, ROWS, COLUMNS)
HALF = torch.zeros(ROWS, COLUMNS, dtype=torch.bool)
HALF[:, : COLUMNS // 2] = True
GARBAGE = (np.float32(40.0), np.random.default_rng(5).uniform(0, 9, (len(LIGHT), 3, ROWS, COLUMNS)))


def btf_of(images: np.ndarray) -> tm.Btf:
    return tm.Btf.from_tensors(images.astype(np.float32), LIGHT.astype(np.float32), VIEW.astype(np.float32))


def spoilt(garbage) -> tm.Btf:
    """The images with their right half spoilt, and the mask that says so."""
    return btf_of(np.where(HALF.numpy(), IMAGES, garbage)).masked(HALF, "a test")


def maps_of(material: tm.Material) -> dict[str, torch.Tensor]:
    return {name: value.detach() for name, value in material.maps.items()}


FAST = {"seed": 0, "holdout": 0.2, "measure": "none", "progress": False}
WAYS = [
    ("texture", {}), ("lambert", {}), ("lptm", {}), ("ptm", {}), ("hsh", {"terms": 4}),
    ("phong_srf", {}), ("phong_srf", {"solver": "varpro"}), ("phong_srf", {"phong": "per_light"}), ("phong_srf", {"solver": "adam"}),
    ("ptm", {"solver": tm.Adam(steps=20)}), ("ptm", {"solver": tm.LBFGS(steps=8)}), ("ptm", {"solver": tm.Minibatch(steps=30)}),
    ("ptm", {"solver": tm.Adam(steps=5), "objective": "display"}),
    ("shading_map", {}), ("shading_map", {"joint": False}), ("pca", {"components": 4}), ("local_pca", {"clusters": 2, "components": 2}), ("rbf", {"components": 5}),
    ("sphere_images", {"size": 16}), ("neural", {"effort": 0.002}), ("distribution", {"effort": 0.01, "lobes": 2}),
]


@pytest.mark.parametrize(("model", "options"), WAYS, ids=[f"{model}-{number}" for number, (model, _) in enumerate(WAYS)])
def test_what_is_outside_leaves_no_trace(model, options):
    fits = [tm.fit(spoilt(garbage), model, geometry="flat", **FAST, **options) for garbage in GARBAGE]
    first, second = (maps_of(fit.material) for fit in fits)
    assert first.keys() == second.keys() and "opacity" in first
    for name, value in first.items():
        assert torch.equal(value, second[name]), name
        assert bool(torch.isfinite(value).all())
    assert torch.equal(first["opacity"][0] > 0, HALF)
    with torch.no_grad():
        colour = fits[0].material.shade(*(torch.tensor([0.3, 0.1, 0.9487])[:, None, None],) * 2)
    assert float(colour[:, ~HALF].abs().max()) == 0


@pytest.mark.parametrize(("model", "options"), [
    ("texture", {}), ("lambert", {}), ("ptm", {}), ("hsh", {"terms": 4}), ("phong_srf", {}), ("phong_srf", {"residual": "half_light"}),
    ("ptm", {"solver": tm.Adam(steps=20)}), ("ptm", {"solver": tm.LBFGS(steps=8)}), ("shading_map", {}),
])
def test_the_object_gets_the_maps_that_it_gets_alone(model, options):
    alone, how = btf_of(IMAGES[..., : COLUMNS // 2]), {**FAST, "dtype": torch.float64, "geometry": "flat"}
    wanted = maps_of(tm.fit(alone, model, **how, **options).material)
    found = maps_of(tm.fit(spoilt(GARBAGE[0]), model, **how, **options).material)
    for name, value in wanted.items():
        inside = found[name][..., : COLUMNS // 2] if found[name].shape[-2:] == (ROWS, COLUMNS) else found[name]
        # Sums of the same terms in another order, which eight steps of L-BFGS make 2e-11.
        assert_close(inside, value, 1e-9)


@pytest.mark.parametrize("model", ["lambert", "ptm", "distribution"])
def test_on_a_relief_too(model):
    axis = torch.linspace(0, 6.28, COLUMNS)
    height = (0.02 * torch.sin(axis)).expand(1, ROWS, COLUMNS).clone()
    options = {"effort": 0.01, "lobes": 1} if model == "distribution" else {}
    fits = [tm.fit(spoilt(garbage), model, geometry=height, tiles=False, **FAST, **options) for garbage in GARBAGE]
    first, second = (maps_of(fit.material) for fit in fits)
    for name, value in first.items():
        assert torch.equal(value, second[name]), name
    assert torch.equal(first["height"], height)  # a height that is given is kept, outside as well


def test_outside_is_the_mean_of_the_object():
    material = tm.fit(spoilt(GARBAGE[0]), "lambert", geometry="flat", **FAST).material
    albedo, normal = material.maps["albedo"].detach(), material.maps["normal"].detach()
    assert_close(albedo[:, 3, -1], albedo[:, HALF].mean(dim=1))
    assert normal[:, 0, -1].tolist() == [0, 0, 1]
    exported = material.stored_as("png8").as_exported()
    assert torch.equal(exported.maps["opacity"], material.maps["opacity"])
    rest = (exported.maps["albedo"].detach() - albedo)[:, HALF].abs().max()
    span = albedo[:, HALF].max()
    assert rest < span / 60  # codes of the object's own range; garbage of 40 would leave half a unit a code


def test_index_rotation_and_a_height_outside():
    size = (2, 3)
    mask = torch.tensor([[1, 1, 1], [0, 0, 1]]).bool()
    index = torch.tensor([[[1.0, 1.0, 0.0], [9.0, 9.0, 1.0]]])
    angle = torch.tensor([[[0.1, 0.3, 0.1], [2.0, 2.0, 0.3]]])
    from torchmat.models.masked import _filled
    from torchmat.models.storage import MapSpec

    assert _filled(MapSpec("a", "", index=True), index, mask)[0].tolist() == [[1, 1, 0], [1, 1, 1]]
    turned = _filled(MapSpec("r", "", kind="rotation"), torch.cat((angle.cos(), angle.sin())), mask)
    assert_close(torch.atan2(turned[1], turned[0])[1, :2], torch.tensor([0.2, 0.2]), 1e-6)
    material = tm.fit(btf_of(IMAGES[..., :2, :3]), "texture", geometry="flat", **FAST).material.on_relief(torch.arange(6.0).reshape(1, *size) / 9)
    assert torch.equal(neutral_outside(material, mask).maps["height"], material.maps["height"])
    assert cut_out(material, None) is material and neutral_outside(material, None) is material
    assert neutral_outside(material, torch.zeros_like(mask)) is material
    half = material.with_maps(opacity=torch.full((1, *size), 0.5))
    assert cut_out(half, mask) is half  # an opacity of the user's own


def test_errors_are_those_of_the_object():
    btf = spoilt(GARBAGE[1])
    result = tm.fit(btf, "ptm", geometry="flat", seed=0, holdout=0.2, progress=False)
    rows = result.split.held_out
    light, view = (torch.from_numpy(d).float()[rows][:, :, None, None] for d in (LIGHT, VIEW))
    with torch.no_grad():
        shaded = result.material.shade(light, view)
    gap = (shaded - torch.from_numpy(IMAGES).float()[rows])[..., HALF].double()
    energy = torch.from_numpy(IMAGES)[rows][..., HALF].square().sum()
    held_out = result.report["held_out"]
    assert held_out["mse"] == pytest.approx(float(gap.square().mean()), rel=1e-5)
    assert held_out["relative_error"] == pytest.approx(float(gap.square().sum() / energy), rel=1e-5)
    assert result.report["source"]["object"] == {"mask": "a test", "texels": ROWS * COLUMNS // 2, "share": 0.5}
    assert result.report["coverage"]["texels_not_fully_determined"] == 0
    bare = tm.fit(btf_of(IMAGES), "ptm", geometry="flat", seed=0, holdout=0.2, progress=False).report
    assert "object" not in bare["source"]
    # Half floats as before, and a byte of opacity.
    assert result.report["bytes_per_texel"] == bare["bytes_per_texel"] + 1


def test_structure_and_colour_difference_count_the_object_alone():
    random = torch.Generator().manual_seed(0)
    target, prediction = torch.rand(2, 3, 20, 20, generator=random), torch.rand(2, 3, 20, 20, generator=random)
    mask = torch.zeros(20, 20, dtype=torch.bool)
    mask[4:16, 5:14] = True
    valid, clipped = mask.expand(2, 1, 20, 20), torch.zeros(2, 1, 20, 20, dtype=torch.bool)
    found = []
    for garbage in (0.0, 5.0):
        errors = SampleErrors()
        planes = (torch.where(mask, one, garbage) for one in (prediction, target))
        errors.add(*planes, valid, clipped, torch.ones(2, dtype=torch.bool))
        found.append(errors.report())
    assert found[0] == found[1]


@pytest.mark.parametrize("model", ["ptm", "phong_srf", "pca"])
def test_tiles_do_not_count_it_either(model):
    options = {"components": 4} if model == "pca" else {}
    fits = [tm.fit(spoilt(garbage), model, geometry="flat", tile_size=4, **FAST, **options) for garbage in GARBAGE]
    for name, value in maps_of(fits[0].material).items():
        assert torch.equal(value, maps_of(fits[1].material)[name]), name
    whole = maps_of(tm.fit(spoilt(GARBAGE[0]), "ptm", geometry="flat", **FAST).material)
    if model == "ptm":  # its columns 8 and 9 are a tile without object
        assert_close(maps_of(fits[0].material)["polynomial"], whole["polynomial"], 1e-4)


def test_the_choice_does_not_count_it():
    fits = [tm.fit(spoilt(garbage), "auto", psnr=14, bytes=8, geometry="flat", **FAST) for garbage in GARBAGE]
    assert fits[0].report["figures"]["auto"]["chosen"]["candidate"] == fits[1].report["figures"]["auto"]["chosen"]["candidate"]
    for name, value in maps_of(fits[0].material).items():
        assert torch.equal(value, maps_of(fits[1].material)[name]), name
    assert fits[0].report["bytes_per_texel"] <= 8
    with pytest.raises(tm.RangeError, match="bytes must hold a material and its object mask; it is 0.9 a texel, of which the mask takes 1"):
        tm.fit(spoilt(GARBAGE[0]), "auto", bytes=0.9, geometry="flat", **FAST)


def test_refit_and_fits_from_a_material():
    results = []
    for garbage in GARBAGE:
        btf = spoilt(garbage)
        begun = tm.fit(btf, "lambert", geometry="flat", **FAST).material
        again = tm.refit(btf, begun, steps=10, progress=False)
        onward = tm.fit(btf, begun.with_maps(albedo=begun.maps["albedo"] * 1.2), solver=tm.Adam(steps=10), **FAST)
        results.append((maps_of(again.material), maps_of(onward.material)))
    for first, second in zip(*results, strict=True):
        for name, value in first.items():
            assert torch.equal(value, second[name]), name


def test_fewer_texels_have_a_mask_of_their_own():
    small = averaged(spoilt(GARBAGE[0]), torch.arange(3), (4, 5), torch.float32)
    assert small.mask.tolist() == [[True, True, True, False, False]] * 4  # half a texel of the third column is object
    wanted = torch.from_numpy(IMAGES[:3]).float()[..., :4].reshape(3, 3, 4, 2, 2, 2).mean(dim=(3, 5))
    assert_close(small.images(range(3))[..., :2], wanted, 1e-5)
    assert_close(small.images(range(3))[..., 2], torch.from_numpy(IMAGES[:3]).float()[..., 4].reshape(3, 3, 4, 2).mean(dim=3), 1e-5)


def test_a_mask_that_leaves_nothing_out_changes_no_bit():
    whole = btf_of(IMAGES)
    one, other = (tm.fit(btf, "phong_srf", geometry="flat", **FAST).material for btf in (whole, whole.masked(torch.ones_like(HALF))))
    assert maps_of(one).keys() == maps_of(other).keys()
    assert all(torch.equal(value, maps_of(other)[name]) for name, value in maps_of(one).items())


def test_a_relief_is_recovered_within_the_mask():
    light, view = hemisphere(((0, 1), (30, 5), (60, 6))), np.array([[0.0, 0.0, 1.0]])
    size = 24
    axis = (torch.arange(size, dtype=torch.float64) + 0.5) / size - 0.5
    up, across = torch.meshgrid(-axis, axis, indexing="ij")
    inside = across**2 + up**2 < 0.35**2
    height = -0.5 * (across**2 + up**2)
    normal = torch.stack((across, up, torch.ones_like(up)))
    normal = normal / normal.norm(dim=0)
    shading = torch.einsum("nk,khw->nhw", torch.from_numpy(light), normal).clamp(min=0)
    images = torch.where(inside, 0.5 * shading, 0.9)[:, None].expand(-1, 3, -1, -1).float()
    view = torch.from_numpy(view).float().expand(len(light), 3)
    btf = tm.Btf.from_tensors(images, torch.from_numpy(light).float(), view).masked(inside)
    found = tm.recover_geometry(btf, tiles=False, progress=False).relief
    assert_close(found.height[0, inside], (height - height[inside].mean())[inside].float(), 0.02)
    assert bool((found.height[0, ~inside] == found.height[0, inside].min()).all())
    assert found.normal[:, ~inside].T.unique(dim=0).tolist() == [[0, 0, 1]]
