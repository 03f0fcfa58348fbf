"""Phong + residual: lobe and residual recovered from images that NumPy made."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.support import all_pairs, assert_close, hemisphere

import torchmat as tm
from torchmat import Btf, FitError, RangeError

HEIGHT, WIDTH = 4, 5
LIGHT, VIEW = all_pairs(hemisphere(((5, 3), (25, 6), (50, 7), (70, 9))), hemisphere(((0, 1), (30, 5), (60, 7))))
DIFFUSE, SPECULAR, EXPONENT = np.array([0.5, 0.3, 0.2]), np.array([0.1, 0.2, 0.3]), 15.0


def half_of(light, view):
    half = light + view
    return half / np.linalg.norm(half, axis=1, keepdims=True)


def phong(light=LIGHT, view=VIEW):
    lobe = np.maximum(0, half_of(light, view)[:, 2]) ** EXPONENT
    return light[:, 2:3] * DIFFUSE + lobe[:, None] * SPECULAR


def ashikhmin_shirley(light, view, diffuse, specular, along, across, axis):
    """One sample at a time: pi (n.l) times eq. 4 of Ashikhmin & Shirley 2000, over a Lambert base."""
    rows = []
    for k1, k2 in zip(light, view, strict=True):
        h = (k1 + k2) / np.linalg.norm(k1 + k2)
        u, v = np.array([math.cos(axis), math.sin(axis), 0]), np.array([-math.sin(axis), math.cos(axis), 0])
        power = (along * (h @ u) ** 2 + across * (h @ v) ** 2) / max(1 - h[2] ** 2, 1e-30)
        fresnel = specular + (1 - specular) * (1 - h @ k1) ** 5
        lobe = math.sqrt((along + 1) * (across + 1)) / (8 * math.pi) * h[2] ** power / ((h @ k1) * max(k1[2], k2[2]))
        rows.append(diffuse * k1[2] + math.pi * k1[2] * lobe * fresnel)
    return np.array(rows)


def family(name, light=LIGHT, view=VIEW):
    half, one = half_of(light, view), np.ones((len(light), 1))
    if name == "half":
        return half
    if name == "half_light":
        return np.hstack((half, light, one))
    flat = np.hstack((light[:, :2], view[:, :2]))
    return np.hstack((one, flat, *[flat[:, i : i + 1] * flat[:, i:] for i in range(4)]))


def residual_of(terms, size=0.05, seed=0):
    """Return coefficients [K, 3, H, W] whose mean over the texels is 0, so that the mean BRDF stays the lobe's."""
    found = np.random.default_rng(seed).uniform(-size, size, (terms, 3, HEIGHT, WIDTH))
    return found - found.mean(axis=(2, 3), keepdims=True)


def fitted(images, light=LIGHT, view=VIEW, **options):
    btf = Btf.from_tensors(images.astype(np.float64), light, view)
    return tm.fit(btf, "phong_srf", holdout=0, dtype=torch.float64, measure=False, **options)


def flat(values):
    return np.broadcast_to(values[:, :, None, None], (*values.shape, HEIGHT, WIDTH))


@pytest.mark.parametrize("way", ["mean_brdf", "per_light"])
@pytest.mark.parametrize("residual", ["half", "half_light", "quadratic"])
def test_lobe_and_residual_are_recovered(way, residual):
    matrix = family(residual)
    truth = residual_of(matrix.shape[1])
    images = flat(phong()) + np.einsum("nk,kchw->nchw", matrix, truth)
    result = fitted(images, phong=way, residual=residual, ridge=0.0)
    assert result.stop_reason == "converged"
    lobe = result.material.maps["lobe"].detach()
    # Each light alone says less about the lobe; measured 2e-9 (mean_brdf) and 2e-5 (per_light).
    bound = 1e-6 if way == "mean_brdf" else 1e-3
    assert_close(lobe, torch.tensor([*DIFFUSE, *SPECULAR, math.log(EXPONENT)], dtype=torch.float64), bound)
    found = result.material.maps["residual"].detach().unflatten(0, (-1, 3))
    assert_close(found, torch.from_numpy(truth), 20 * bound)
    assert bool((result.coverage == 1).all())


@pytest.mark.parametrize("way", ["mean_brdf", "per_light"])
def test_both_errors_are_reported(way):
    result = fitted(flat(phong()), phong=way)
    errors = result.report["figures"]["lobe_error_on_mean_brdf"]
    assert set(errors) == {"mean_brdf", "per_light"}
    assert 0 <= errors["mean_brdf"] < 1e-10 and 0 <= errors["per_light"] < 1e-6
    assert set(result.report["figures"]["lobe"]) == {
        "diffuse_r", "diffuse_g", "diffuse_b", "specular_r", "specular_g", "specular_b", "log_exponent",
    }


def test_the_reported_error_is_that_of_the_lobe_on_the_means():
    images = np.random.default_rng(0).uniform(0.2, 0.5, (len(LIGHT), 3, HEIGHT, WIDTH))
    result = fitted(images)
    values = result.material.maps["lobe"].tolist()
    half = np.maximum(0, half_of(LIGHT, VIEW)[:, 2:3])
    predicted = LIGHT[:, 2:3] * values[:3] + half ** math.exp(values[6]) * values[3:6]
    means = images.mean(axis=(2, 3))
    expected = ((predicted - means) ** 2).sum() / (means**2).sum()
    assert abs(result.report["figures"]["lobe_error_on_mean_brdf"]["mean_brdf"] - expected) < 1e-9


def test_the_mean_brdf_lobe_is_optimal_within_its_bounds():
    noise = np.random.default_rng(1).normal(0, 0.01, (len(LIGHT), 3, HEIGHT, WIDTH))
    images = flat(phong()) + noise
    result = fitted(images)
    found = result.material.maps["lobe"].detach().numpy()
    half = np.maximum(1e-300, half_of(LIGHT, VIEW)[:, 2])

    def cost(p):
        predicted = LIGHT[:, 2:3] * p[:3] + half[:, None] ** np.exp(p[6]) * p[3:6]
        return 0.5 * ((predicted - images.mean(axis=(2, 3))) ** 2).sum()

    for index in range(7):
        step = np.zeros(7)
        step[index] = 1e-5
        slope = (cost(found + step) - cost(found - step)) / 2e-5
        assert abs(slope) < 1e-5, (index, slope)
    # 20 texels average the noise to 0.0022; the specular peak is seen by a few dozen of 325 samples.
    truth = np.array([*DIFFUSE, *SPECULAR, math.log(EXPONENT)])
    assert float(np.abs(found - truth)[:6].max()) < 0.01 and abs(found[6] - truth[6]) < 0.05


def test_the_anisotropic_base_is_recovered():
    diffuse, specular = np.array([0.4, 0.3, 0.2]), np.array([0.1, 0.15, 0.2])
    axis = 0.6
    means = ashikhmin_shirley(LIGHT, VIEW, diffuse, specular, 60.0, 8.0, axis)
    result = fitted(flat(means), base="ashikhmin_shirley", ridge=0.0)
    found = result.material.maps["lobe"].detach().numpy()
    assert float(np.abs(found[:6] - [*diffuse, *specular]).max()) < 1e-5
    along, across, turn = found[6], found[7], found[8]
    if along < across:  # the same lobe, named the other way round
        along, across, turn = across, along, turn + math.pi / 2
    assert abs(along - math.log(60)) < 1e-4 and abs(across - math.log(8)) < 1e-4
    assert abs(math.sin(turn - axis)) < 1e-4
    assert float(result.material.maps["residual"].detach().abs().max()) < 1e-4


def test_per_light_without_enough_views_says_what_to_do():
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1), (30, 1))))
    with pytest.raises(FitError, match=r"per_light.*3 views.*mean_brdf"):
        fitted(flat(phong(light, view)), light, view, phong="per_light")
    report = fitted(flat(phong(light, view)), light, view).report
    assert report["figures"]["lobe_error_on_mean_brdf"]["per_light"] is None


@pytest.mark.parametrize("ridge", [-1.0, float("nan"), float("inf"), "much"])
def test_a_ridge_that_is_no_penalty_is_refused(ridge):
    with pytest.raises(RangeError, match="ridge"):
        fitted(flat(phong()), ridge=ridge)


@pytest.mark.parametrize("name,value", [("residual", "half_lite"), ("phong", "mean"), ("base", "fong")])
def test_unknown_choices_are_refused(name, value):
    with pytest.raises(RangeError, match=name):
        fitted(flat(phong()), **{name: value})


def test_black_data_gives_a_black_material():
    result = fitted(np.zeros((len(LIGHT), 3, HEIGHT, WIDTH)))
    assert float(result.material.maps["residual"].detach().abs().max()) < 1e-20
    pole = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None]
    shaded = result.material.shade(pole, pole)
    assert float(shaded.detach().max()) < 1e-11


def test_one_view_and_one_light_stay_finite_and_say_what_they_miss():
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1),)))
    for first, second in ((light, view), (view, light)):
        images = np.random.default_rng(0).uniform(0, 1, (len(light), 3, HEIGHT, WIDTH))
        result = fitted(images, first, second, residual="quadratic", ridge=0.0)
        assert all(bool(torch.isfinite(value).all()) for value in result.material.maps.values())
        assert float(result.coverage.max()) < 1  # products with the fixed direction are 0 here


@pytest.mark.parametrize("residual", ["half", "half_light", "quadratic"])
@pytest.mark.parametrize("way", ["mean_brdf", "per_light"])
def test_a_highlight_of_1e4_leaves_the_dark_texels_their_fit(residual, way):
    albedo = 10.0 ** np.random.default_rng(0).uniform(-8, -2, (3, 12, 12))
    dark = LIGHT[:, 2, None, None, None] * albedo
    bright = dark.copy()
    bright[:, :, 5, 6] = 1e4 * np.maximum(0, half_of(LIGHT, VIEW)[:, 2, None]) ** 80
    without, with_it = (
        tm.fit(Btf.from_tensors(images.astype(np.float32), LIGHT, VIEW), "phong_srf", holdout=0, measure=False,
               residual=residual, phong=way)
        for images in (dark, bright)
    )
    assert with_it.report["figures"]["texels_left_out_of_lobe"] == 1
    assert without.report["figures"]["texels_left_out_of_lobe"] == 0
    on = torch.ones(12, 12, dtype=torch.bool)
    on[5, 6] = False
    light, view = (torch.from_numpy(rows).float()[:, :, None, None] for rows in (LIGHT, VIEW))
    with torch.no_grad():
        expected, found = (result.material.shade(light, view)[..., on] for result in (without, with_it))
    # One texel of 144 no longer takes part in the mean lobe: measured up to 0.4 % of the brightest dark value.
    assert_close(found, expected, 0.01)


def test_texels_of_like_brightness_all_share_the_lobe():
    images = flat(phong()) * np.random.default_rng(0).uniform(0.05, 1, (1, 1, HEIGHT, WIDTH))
    assert fitted(images).report["figures"]["texels_left_out_of_lobe"] == 0


def test_axes_are_averaged_as_lines_not_as_numbers():
    from torchmat.fitting.models.phong_srf import _average
    from torchmat.models.lobes import LOBES

    lobe = LOBES["ashikhmin_shirley"]
    parameters = torch.zeros(2, len(lobe.names), dtype=torch.float64)
    parameters[:, :3] = torch.tensor([[0.2], [0.4]], dtype=torch.float64)
    parameters[:, lobe.axis] = torch.tensor([math.radians(89), math.radians(-89)], dtype=torch.float64)
    mean = _average(lobe, parameters)
    assert mean[:3].tolist() == pytest.approx([0.3] * 3)
    assert abs(math.degrees(float(mean[lobe.axis]))) == pytest.approx(90)
