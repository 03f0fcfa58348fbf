"""Every model over a known relief, and the choice between a recovered relief and none."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from tests.fitting.auto_data import shorten_fits
from tests.fitting.reference_scene import glossy_scene, relief_scene
from tests.models.examples import PLAIN
from tests.support import assert_close

import torchmat as tm
from torchmat import Btf, RangeError, ShapeError
from torchmat.fitting import RECIPES, FitResult, on_relief, predict
from torchmat.fitting.models.linear import _two_non_negative, fit_lambert_on_relief
from torchmat.fitting.relief.recover import Recovery
from torchmat.fitting.relief.surface import bring_onto
from torchmat.fitting.training import make_training
from torchmat.geometry import Relief, normals_from_slopes

OPTIONS = {
    "pca": {"components": 8}, "rbf": {"components": 12}, "local_pca": {"clusters": 4, "components": 4},
    "distribution": {
        "lobes": 1, "fresnel": False, "rotation": False, "specular_size": 8, "effort": 0.05, "storage": "half",
    },
    "neural": {"latent": 4, "hidden": 12, "effort": 0.03, "storage": "half"},
    "microfacet": {"effort": 0.05, "storage": "half", **PLAIN},
}
# Gain in dB on held-out samples over the flat fit. Measured: texture 2.9 (it has no normals), lambert 15.4, ptm and
# lptm 11.5 (in codes of a screen, which bend what they hold exactly in linear light: 15.7 there), hsh 16.2, phong_srf 3.6, pca 4.3 and local_pca 3.7 (90 samples are few for tables over directions),
# distribution 14.6 after 100 steps, sphere_images 2.7 (no normals either).
GAIN = {
    "texture": 2.3, "lambert": 14, "ptm": 10, "lptm": 10, "hsh": 14, "phong_srf": 3, "pca": 3.5, "local_pca": 3,
    "distribution": 12, "sphere_images": 2.2,
}
# For what does not depend on how far a fit comes.
FEW_STEPS = {
    name: {**options, "effort": 0.01} if "effort" in options else options
    for name, options in (OPTIONS | {"distribution": {**OPTIONS["distribution"], "specular_spacing": "even"}}).items()
}
every_model = pytest.mark.parametrize("model", RECIPES)


@functools.lru_cache(maxsize=None)
def fitted(model: str, relief: bool) -> FitResult:
    scene = relief_scene()
    geometry = scene.true_height if relief else "flat"
    return tm.fit(scene.btf(), model, geometry=geometry, **OPTIONS.get(model, {}))


@every_model
def test_the_true_height_predicts_held_out_samples_better(model):
    flat, relief = (fitted(model, way).report["held_out"]["psnr_db"] for way in (False, True))
    assert relief > flat + GAIN.get(model, 2)


@every_model
def test_the_material_carries_the_relief(model):
    material, truth = fitted(model, True).material, relief_scene().true_height.float()
    assert material.has_relief and material.tiles
    assert torch.equal(material.maps["height"].detach(), truth), "a height that is given stays as it is"
    assert material.maps["ambient"].shape == (3, 24, 24) and bool((material.maps["ambient"] >= 0).all())
    assert not fitted(model, False).material.has_relief
    report = fitted(model, True).report
    assert report["geometry"] == "given" and fitted(model, False).report["geometry"] == "flat"


@every_model
def test_the_relief_survives_export_and_the_round_trip(model, tmp_path):
    scene = relief_scene()
    material = fitted(model, True).material
    exported = material.as_exported()
    loaded = tm.load_material(tm.save_material(material, tmp_path / "m"))
    assert loaded.has_relief and type(loaded) is type(material) and loaded.tiles == material.tiles
    for name, value in exported.maps.items():
        assert torch.equal(loaded.maps[name], value)
    span = float(np.ptp(scene.height))
    assert float((exported.maps["height"] - material.maps["height"]).detach().abs().max()) <= 0.51 * span / 65535 + 1e-8
    indices = torch.arange(0, 90, 7)
    assert torch.equal(predict(loaded, scene.btf(), indices), predict(exported, scene.btf(), indices))
    # Half precision keeps 11 bits, 5e-4: measured 2e-4 to 6e-4 of the largest value, of a product of two maps in codes of a
    # screen, whose curve is steeper than 2 near white, 1.3e-3.
    bound = 2e-3 if model == "lptm" else 1e-3
    assert_close(predict(exported, scene.btf(), indices), predict(material, scene.btf(), indices), bound)


@pytest.mark.parametrize(("model", "way"), [
    *((model, way) for model in RECIPES for way in ("flat", "given")), ("lambert", "recover"), ("distribution", "recover"),
])
def test_a_surface_that_does_not_repeat_says_so(model, way):
    scene = relief_scene(rows=8, columns=9, tiles=False)
    geometry = scene.true_height if way == "given" else way
    result = tm.fit(scene.btf(), model, geometry=geometry, tiles=False, measure=False, **FEW_STEPS.get(model, {}))
    assert result.material.tiles is False and result.report["tiles"] is False
    assert result.material.as_exported().tiles is False


@every_model
def test_double_precision_stays_double(model):
    scene = relief_scene()
    result = tm.fit(
        scene.btf(np.float64), model, geometry=scene.true_height, dtype=torch.float64, **OPTIONS.get(model, {})
    )
    assert all(value.dtype == torch.float64 for value in result.material.maps.values())
    indices = torch.arange(0, 90, 7)
    double, single = (predict(one.material, scene.btf(), indices) for one in (result, fitted(model, True)))
    if model in ("pca", "local_pca", "rbf", "neural"):
        # Texels between two clusters, components of nearly one weight, and hundreds of steps through a network part
        # otherwise on the last bit: single texels differ by up to 0.27 (the network's by 0.01), the error does not.
        errors = [one.report["held_out"]["psnr_db"] for one in (result, fitted(model, True))]
        assert abs(errors[0] - errors[1]) < 0.3
    else:
        # The steps of Adam carry rounding on, through what all texels share most: the printed formula differs by 7e-5, with
        # Smith's two numbers by 7e-4.
        assert_close(single.double(), double, {"distribution": 1e-3, "microfacet": 5e-4}.get(model, 1e-5))


def test_lambert_recovers_albedo_and_ambient():
    scene = relief_scene(depth=0.05, finest=3)
    material = tm.fit(scene.btf(), "lambert", geometry=scene.true_height, holdout=0, measure=False).material
    albedo, ambient = (material.maps[name].detach().numpy() for name in ("albedo", "ambient"))
    # Sobel slopes of 24 texels are up to 5 % too low, and no shadow parts the two: measured 0.017 and 0.0069.
    assert np.abs(albedo - scene.albedo).max() < 0.021
    assert np.abs(ambient - scene.ambient).max() < 0.009


def test_bright_samples_weigh_less_in_lambert_on_a_relief():
    """Each sample weighs 1 / (its mean + the mean of all): by NumPy's least squares, and a highlight moves little."""
    scene = relief_scene(rows=8, columns=9, depth=0.04, finest=2)
    images, gloss = scene.images.copy(), (np.arange(len(scene.light)) % 7 == 3)
    images[gloss] += 4.0  # 13 of 90 samples shine
    light, view, known = scene.light, scene.view, np.random.default_rng(0).random((90, 8, 9)) > 0.03
    images = np.where(known[:, None], images, 50.0)
    training = make_training(Btf.from_tensors(images, light, view, known), torch.arange(90), 0, True, torch.float64, False)
    surface = bring_onto(training, scene.true_height)
    with torch.no_grad():
        material = fit_lambert_on_relief(surface, scene.true_height).material
    found = torch.cat([material.maps[name].detach() for name in ("albedo", "ambient")]).numpy()
    normal = normals_from_slopes(surface.slopes).numpy()
    values, counts = (part.numpy() for part in surface.values(slice(0, 90)))
    direct = np.maximum(0, np.einsum("nk,khw->nhw", light, normal)) * surface.shadow(slice(0, 90))[:, 0].numpy()
    weight = counts[:, 0] / (values.mean(axis=1) + values.mean())
    plain = np.empty_like(found)
    for row in range(8):
        for column in range(9):
            for channel in range(3):
                at = (slice(None), row, column)
                for given, into in ((weight[at], None), (counts[:, 0][at], plain)):
                    root = np.sqrt(given)[:, None]
                    matrix = root * np.stack((direct[at], np.ones(90)), axis=1)
                    ridge = np.sqrt(0.5e-4 * (matrix**2).sum()) * np.eye(2)
                    right = np.append(root[:, 0] * values[:, channel, row, column], (0, 0))
                    x = nnls(np.concatenate((matrix, ridge)), right)[0]
                    if into is None:
                        np.testing.assert_allclose(found[[channel, 3 + channel], row, column], x, atol=1e-6)
                    else:
                        into[[channel, 3 + channel], row, column] = x
    # What is added is no light of these normals: without weights most of it becomes ambient. Measured 0.081 and 0.382.
    assert found[3:].mean() < 0.12 and plain[3:].mean() > 0.3


def test_lambert_with_a_normal_map_goes_the_common_way():
    scene = relief_scene()
    material = tm.fit(scene.btf(), "lambert", geometry=scene.true_height, normals="map", measure=False).material
    assert set(material.maps) == {"albedo", "normal", "height", "ambient"}
    rise = (np.roll(scene.height, -1, 1) - np.roll(scene.height, 1, 1)) * 12
    found = (-material.maps["normal"][0] / material.maps["normal"][2]).detach().numpy()
    # Blended in at the rims of what is hidden; typical is what shows that the normals are the surface's.
    assert np.abs(found - rise).mean() < 0.1 * np.abs(rise).mean()
    with pytest.raises(RangeError, match="normals='height'.*flat"):
        tm.fit(scene.btf(), "lambert", normals="height")


def test_recovery_is_chosen_and_reported_on_a_relief():
    scene = relief_scene()
    result = tm.fit(scene.btf(), "lambert", geometry="recover", finish=False)  # which would move the height
    figures = result.report["figures"]["geometry"]
    assert figures["chosen"] == "recover" and result.report["geometry"] == "recover"
    assert set(figures["validation_psnr_db"]) == {"flat", "recover"}
    assert figures["validation_psnr_db"]["recover"] > figures["validation_psnr_db"]["flat"] + 5
    assert figures["disagreement"] < figures["disagreement_flat"] and figures["recovery_seconds"] > 0
    assert 0.8 < figures["scale"] < 1.2 and 0 < figures["offset"] < 0.2
    assert torch.equal(result.relief.height, result.material.maps["height"].detach())
    # Measured 31.5 dB against 19.0 flat and 34.4 on the true height.
    assert result.report["held_out"]["psnr_db"] > 29


def same_maps(first: FitResult, second: FitResult) -> bool:
    names = set(first.material.maps)
    return names == set(second.material.maps) and all(
        torch.equal(first.material.maps[name], second.material.maps[name]) for name in names
    )


@every_model
def test_a_flat_gloss_stays_flat_bit_for_bit(model):
    btf = glossy_scene().btf()
    options = {**FEW_STEPS.get(model, {}), "measure": False}
    recovered, flat = (tm.fit(btf, model, geometry=way, **options) for way in ("recover", "flat"))
    assert same_maps(recovered, flat) and "height" not in recovered.material.maps
    figures = recovered.report["figures"]["geometry"]
    assert figures["chosen"] == "flat" and figures["scale"] == 0.0
    assert recovered.relief is None


def test_a_wrong_relief_is_dropped_on_samples_that_neither_fit_saw(monkeypatch):
    scene = glossy_scene()
    wrong = relief_scene().true_height.float()
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 24, 24)
    monkeypatch.setattr(on_relief, "recover_relief", lambda training: Recovery(Relief(wrong, up), "made up", 1.0, 0.0, "nothing"))
    result, flat = (tm.fit(scene.btf(), "ptm", geometry=way, measure=False) for way in ("recover", "flat"))
    figures = result.report["figures"]["geometry"]
    assert figures["chosen"] == "flat" and figures["validation_psnr_db"]["flat"] > figures["validation_psnr_db"]["recover"]
    assert same_maps(result, flat)


def test_the_height_stays_until_the_finish(monkeypatch):
    scene = relief_scene(rows=12, columns=12)
    wrong = 0.8 * scene.true_height.float()
    training = make_training(scene.btf(), torch.arange(90), 0, True, torch.float32, False)
    options = {"lobes": 1, "fresnel": False, "rotation": False, "specular_size": 8, "effort": 0.02}
    fitted = on_relief.fit_on_relief(training, "distribution", options, wrong)
    assert torch.equal(fitted.material.maps["height"], wrong)
    shorten_fits(monkeypatch)
    result = tm.fit(scene.btf(), "auto", psnr=60, geometry=wrong, measure=False)
    assert torch.equal(result.material.maps["height"], wrong)


def test_a_fit_that_ends_worse_on_the_relief_than_flat_is_the_flat_one(monkeypatch):
    """Of the fit on the relief only the long one goes astray: what the short ones said of it does not hold."""
    scene = relief_scene(rows=12, columns=12)
    upright = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 12, 12)
    found = Recovery(Relief(scene.true_height.float(), upright), "made up", 1.0, 0.0, "nothing")
    monkeypatch.setattr(on_relief, "recover_relief", lambda training: found)
    fit, options = on_relief.fit_on_relief, {**FEW_STEPS["distribution"], "effort": 0.02}
    monkeypatch.setitem(RECIPES, "distribution", replace(RECIPES["distribution"], quick={"effort": 0.015}))

    def astray(training, model, options, *rest, **more):
        fitted = fit(training, model, options, *rest, **more)
        if options["effort"] == 0.015:
            return fitted
        material = fitted.material.with_maps(diffuse=0 * fitted.material.maps["diffuse"].detach())
        return replace(fitted, material=material, stop_reason="diverged")

    assert tm.fit(scene.btf(), "distribution", measure=False, **options).material.has_relief
    monkeypatch.setattr(on_relief, "fit_on_relief", astray)
    result, flat = (tm.fit(scene.btf(), "distribution", measure=False, geometry=way, **options) for way in ("recover", "flat"))
    figures = result.report["figures"]["geometry"]
    assert same_maps(result, flat) and not result.material.has_relief and result.stop_reason == flat.stop_reason
    assert figures["chosen"] == "flat" and result.relief is None
    assert figures["fell_back"].startswith("the fit on the relief ended (diverged) at ")


@pytest.mark.parametrize("used", [slice(None), slice(None, None, 3)])
def test_flat_and_relief_are_compared_on_samples_that_neither_was_fitted_to(used, monkeypatch):
    scene, seen, measured = relief_scene(), [], []
    training = make_training(scene.btf(), torch.arange(90)[used], 0, True, torch.float32, False)
    for name in ("fit_flat", "fit_on_relief"):
        fit = getattr(on_relief, name)
        monkeypatch.setattr(on_relief, name, lambda part, *given, fit=fit: seen.append(part.used) or fit(part, *given))
    judge = on_relief.evaluate
    monkeypatch.setattr(on_relief, "evaluate", lambda made, btf, rows, most, **how: measured.append(rows) or judge(made, btf, rows, most, **how))
    assert on_relief.compare_with_flat(training, "lambert", {}, scene.true_height)[0] == "recover"
    assert len(measured) == 2 and len(measured[0]) == round(0.1 * int(training.used.sum()))
    for rows in measured:
        apart = training.used.clone()
        apart[rows] = False
        assert bool(training.used[rows].all()) and len(seen) >= 2 and all(torch.equal(part, apart) for part in seen)


def sums(random: np.random.Generator, texels: int) -> tuple[np.ndarray, ...]:
    """Return the sums of products of random problems: 1 and 2 unknown at all, and right-hand sides of both signs."""
    a, b = random.uniform(0, 1, (2, 6, texels)) * (random.random((2, 6, texels)) > 0.3)
    a[:, 0], b[:, 1] = 0, 0
    a[:, 2], b[:, 2] = 0, 0
    b[:, 3] = 2 * a[:, 3]  # one cannot be told from the other
    y = random.normal(size=(6, 3, texels))
    products = (a * a).sum(0), (a * b).sum(0), (b * b).sum(0)
    return (*products, np.einsum("nt,nct->ct", a, y), np.einsum("nt,nct->ct", b, y))


def test_two_non_negative_unknowns_against_brute_force():
    aa, ab, bb, ay, by = sums(np.random.default_rng(0), 400)
    given = [torch.from_numpy(value.reshape(*value.shape[:-1], 20, 20)) for value in (aa, ab, bb, ay, by)]
    x, y = (found.reshape(3, 400).numpy() for found in _two_non_negative(*given))
    assert (x >= 0).all() and (y >= 0).all()
    seen = set()
    for texel in range(400):
        ridge = 1e-4 * (aa[texel] + bb[texel]) / 2
        matrix = np.array([[aa[texel] + ridge, ab[texel]], [ab[texel], bb[texel] + ridge]])
        for channel in range(3):
            right = np.array([ay[channel, texel], by[channel, texel]])
            best, least = np.zeros(2), 0.0
            for free in ([0], [1], [0, 1]):
                part = np.zeros(2)
                part[free] = np.linalg.lstsq(matrix[np.ix_(free, free)], right[free], rcond=None)[0]
                value = part @ matrix @ part - 2 * part @ right
                if (part >= 0).all() and value < least:
                    best, least = part, value
            seen.add(tuple(best > 0))
            np.testing.assert_allclose([x[channel, texel], y[channel, texel]], best, rtol=1e-6, atol=1e-9)
    assert len(seen) == 4  # every way of being at a bound occurred
    assert (x[:, 0] == 0).all() and (y[:, 1] == 0).all() and (x[:, 2] == 0).all() and (y[:, 2] == 0).all()


def test_heights_of_any_kind_of_array_are_taken():
    scene = relief_scene()
    kinds = {
        "tensor": scene.true_height.float(), "map without channel": scene.true_height[0].float(), "float64": scene.true_height,
        "numpy": scene.height.astype(np.float32), "list": scene.height.astype(np.float32).tolist(),
    }
    results = {name: tm.fit(scene.btf(), "texture", geometry=height, measure=False) for name, height in kinds.items()}
    assert all(same_maps(result, results["tensor"]) for result in results.values())
    steps = torch.arange(24)[:, None].expand(24, 24) % 2  # whole texture widths: silly, yet a height
    whole = tm.fit(scene.btf(), "texture", geometry=steps, measure=False).material.maps["height"]
    assert torch.equal(whole.detach(), steps[None].float())


@pytest.mark.parametrize("shape", [(24, 25), (1, 25, 24), (3, 24, 24), (24,), (1, 1, 24, 24), ()])
def test_a_height_of_another_size_is_refused(shape):
    with pytest.raises(ShapeError, match=r"fit: geometry must be \[1, 24, 24\]; it is .*Resample"):
        tm.fit(relief_scene().btf(), "texture", geometry=torch.rand(shape))


@pytest.mark.parametrize(("change", "says"), [
    (lambda height: height.index_fill(1, torch.tensor([3]), float("nan")), r"finite; 24 of 576 .* \(0, 3, 0\)"),
    (lambda height: height.index_fill(1, torch.tensor([3]), float("inf")), "finite"),
    (torch.zeros_like, "same everywhere"),
    (lambda height: torch.full_like(height, 0.3), "same everywhere"),
    (lambda height: height * (10 / height.max()), "reaches 10 texture widths"),
    (lambda height: height - 10.1, "reaches 10.* texture widths"),
], ids=["nan", "inf", "zero", "constant", "ten widths", "ten widths below"])
def test_a_height_that_is_none_is_refused(change, says):
    with pytest.raises(RangeError, match=f"fit: geometry must be .*{says}"):
        tm.fit(relief_scene().btf(), "texture", geometry=change(relief_scene().true_height))


def test_an_unknown_geometry_is_refused_with_the_nearest():
    with pytest.raises(RangeError, match="geometry must be one of 'flat', 'recover'.*Did you mean 'recover'"):
        tm.fit(relief_scene().btf(), "texture", geometry="recovered")
