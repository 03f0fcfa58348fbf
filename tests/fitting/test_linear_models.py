"""Baselines recover what NumPy oracles made: exactly representable data, then noisy data."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.reference.colour import decode
from tests.support import all_pairs, assert_close, hemisphere

import torchmat as tm
from torchmat import Btf

HEIGHT, WIDTH = 4, 5
LIGHT, VIEW = all_pairs(hemisphere(), hemisphere(((0, 1), (40, 4))))
# The design is summed in float32 over 110 samples; HSH's higher terms are the worst conditioned of these bases.
BOUND = {torch.float32: 2e-4, torch.float64: 1e-5}  # directions are float32 in float32 data, float64 in float64 data


def legendre(degree, order, x):
    """Associated Legendre polynomials without the phase, written out."""
    s = np.sqrt(1 - x * x)
    return {
        (0, 0): 1 + 0 * x, (1, 0): x, (1, 1): s, (2, 0): (3 * x * x - 1) / 2, (2, 1): 3 * x * s, (2, 2): 3 * s * s,
        (3, 0): (5 * x**3 - 3 * x) / 2, (3, 1): 1.5 * (5 * x * x - 1) * s, (3, 2): 15 * x * s * s, (3, 3): 15 * s**3,
    }[degree, order]


def harmonics(light, bands):
    """Return [n, bands^2] hemispherical harmonics, one direction at a time."""
    rows = []
    for x, y, z in light:
        azimuth, row = math.atan2(y, x), []
        for degree in range(bands):
            for order in range(-degree, degree + 1):
                m = abs(order)
                scale = (2 * degree + 1) * math.factorial(degree - m) / (2 * math.pi * math.factorial(degree + m))
                turn = math.cos(m * azimuth) if order >= 0 else math.sin(m * azimuth)
                row.append(math.sqrt(scale * (2 if m else 1)) * legendre(degree, m, 2 * z - 1) * turn)
        rows.append(row)
    return np.array(rows)


def biquadratic(light):
    x, y = light[:, 0], light[:, 1]
    return np.stack((x * x, y * y, x * y, x, y, np.ones_like(x)), axis=1)


def btf_of(images, dtype, weight=None, light=LIGHT, view=VIEW):
    kind = np.float32 if dtype == torch.float32 else np.float64
    return Btf.from_tensors(images.astype(kind), light, view, weight)


def uniform(*shape, low=-1.0, high=1.0, seed=0):
    return np.random.default_rng(seed).uniform(low, high, shape)


def fitted(images, model, dtype, weight=None, **options):
    result = tm.fit(btf_of(images, dtype, weight), model, holdout=0, dtype=dtype, measure=False, **options)
    return result.material


LINEAR = {
    "ptm": (lambda light: biquadratic(light), "polynomial", {"space": "linear"}),
    "hsh4": (lambda light: harmonics(light, 2), "harmonic", {"terms": 4, "space": "linear"}),
    "hsh9": (lambda light: harmonics(light, 3), "harmonic", {"terms": 9, "space": "linear"}),
    "hsh16": (lambda light: harmonics(light, 4), "harmonic", {"terms": 16, "space": "linear"}),
}
decoded = np.vectorize(decode)


@pytest.mark.parametrize("masked", [False, True], ids=["whole", "masked"])
@pytest.mark.parametrize("name", LINEAR)
def test_linear_models_recover_their_coefficients(name, masked, dtype):
    matrix_of, map_name, options = LINEAR[name]
    matrix = matrix_of(LIGHT)
    truth = uniform(matrix.shape[1], 3, HEIGHT, WIDTH)
    images = np.einsum("nk,kchw->nchw", matrix, truth)
    weight = np.random.default_rng(1).random((len(LIGHT), HEIGHT, WIDTH)) > 0.2 if masked else None
    material = fitted(images, name.rstrip("0123456789"), dtype, weight, **options)
    found = material.maps[map_name].detach().unflatten(0, (-1, 3))
    assert_close(found, torch.from_numpy(truth), BOUND[dtype])


@pytest.mark.parametrize("name", LINEAR)
def test_coefficients_in_codes_are_recovered_above_white_too(name, dtype):
    matrix_of, map_name, options = LINEAR[name]
    matrix = matrix_of(LIGHT)
    truth = uniform(matrix.shape[1], 3, HEIGHT, WIDTH, low=-0.02, high=0.02)
    truth[5 if name == "ptm" else 0] += 1.0 if name == "ptm" else 2.5  # codes stay positive over the hemisphere; some are above 1
    codes = np.einsum("nk,kchw->nchw", matrix, truth)
    assert codes.min() > 0 and codes.max() > 1
    material = fitted(decoded(codes), name.rstrip("0123456789"), dtype, **{**options, "space": "srgb"})
    assert material.options["space"] == "srgb"
    assert_close(material.maps[map_name].detach().unflatten(0, (-1, 3)), torch.from_numpy(truth), 5 * BOUND[dtype])


def test_lptm_recovers_its_codes(dtype):
    luminance = uniform(6, HEIGHT, WIDTH, low=-0.05, high=0.05)
    luminance[5] = 0.6
    chroma = uniform(3, HEIGHT, WIDTH, low=0.5, high=1.5, seed=3)
    chroma /= np.tensordot((0.2126, 0.7152, 0.0722), chroma, 1)
    codes = np.einsum("nk,khw->nhw", biquadratic(LIGHT), luminance)[:, None] * chroma
    material = fitted(decoded(codes), "lptm", dtype, space="srgb")
    assert_close(material.maps["chroma"].detach(), torch.from_numpy(chroma), BOUND[dtype])
    assert_close(material.maps["luminance"].detach(), torch.from_numpy(luminance), BOUND[dtype])


@pytest.mark.parametrize("model", ["ptm", "lptm", "hsh"])
def test_codes_are_the_default_and_other_spaces_are_refused(model):
    images = uniform(len(LIGHT), 3, HEIGHT, WIDTH, low=0, high=1)
    assert fitted(images, model, torch.float32).options["space"] == "srgb"
    with pytest.raises(tm.RangeError, match="space.*be one of 'linear', 'srgb'; it is 'gamma'"):
        fitted(images, model, torch.float32, space="gamma")


def test_texture_recovers_its_colours(dtype):
    albedo = uniform(3, HEIGHT, WIDTH, low=0, high=1)
    material = fitted(LIGHT[:, 2, None, None, None] * albedo, "texture", dtype)
    assert_close(material.maps["albedo"].detach(), torch.from_numpy(albedo), BOUND[dtype])


def test_texture_never_goes_below_zero():
    images = -np.ones((len(LIGHT), 3, HEIGHT, WIDTH))
    assert torch.equal(fitted(images, "texture", torch.float32).maps["albedo"].detach(), torch.zeros(3, HEIGHT, WIDTH))


def lambert_images(tilt):
    normal = np.stack((*uniform(2, HEIGHT, WIDTH, low=-tilt, high=tilt), np.ones((HEIGHT, WIDTH))))
    normal /= np.linalg.norm(normal, axis=0)
    albedo = uniform(3, HEIGHT, WIDTH, low=0.1, high=0.9, seed=2)
    cosine = np.einsum("nk,khw->nhw", LIGHT, normal)
    return albedo, normal, cosine


def test_lambert_recovers_normal_and_albedo_without_shadows(dtype):
    albedo, normal, cosine = lambert_images(0.2)
    assert cosine.min() > 0
    material = fitted(albedo * cosine[:, None], "lambert", dtype)
    assert_close(material.maps["normal"].detach(), torch.from_numpy(normal), BOUND[dtype])
    assert_close(material.maps["albedo"].detach(), torch.from_numpy(albedo), BOUND[dtype])


def test_lambert_keeps_a_black_texel_black_and_flat():
    albedo, _, cosine = lambert_images(0.2)
    albedo[:, 1, 1] = 0
    material = fitted(albedo * cosine[:, None], "lambert", torch.float32)
    assert torch.equal(material.maps["normal"][:, 1, 1].detach(), torch.tensor([0.0, 0.0, 1.0]))
    assert torch.equal(material.maps["albedo"][:, 1, 1].detach(), torch.zeros(3))


def test_lptm_recovers_colour_and_luminance(dtype):
    luminance = uniform(6, HEIGHT, WIDTH, low=-0.05, high=0.05)
    luminance[5] = 0.6  # stays positive over the hemisphere
    chroma = uniform(3, HEIGHT, WIDTH, low=0.5, high=1.5, seed=3)
    chroma /= np.tensordot((0.2126, 0.7152, 0.0722), chroma, 1)
    images = np.einsum("nk,khw->nhw", biquadratic(LIGHT), luminance)[:, None] * chroma
    material = fitted(images, "lptm", dtype, space="linear")
    assert_close(material.maps["chroma"].detach(), torch.from_numpy(chroma), BOUND[dtype])
    assert_close(material.maps["luminance"].detach(), torch.from_numpy(luminance), BOUND[dtype])


@pytest.mark.parametrize("name", LINEAR)
def test_noise_is_averaged_as_statistics_say(name):
    matrix_of, map_name, options = LINEAR[name]
    matrix = matrix_of(LIGHT)
    truth = uniform(matrix.shape[1], 3, HEIGHT, WIDTH)
    noise = np.random.default_rng(5).normal(0, 0.01, (len(LIGHT), 3, HEIGHT, WIDTH))
    images = np.einsum("nk,kchw->nchw", matrix, truth) + noise
    material = fitted(images, name.rstrip("0123456789"), torch.float64, **options)
    found = material.maps[map_name].detach().unflatten(0, (-1, 3)).numpy()
    deviation = 0.01 * np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    # 60 draws a term: six standard deviations fail once in 10^7 runs; the seed is fixed.
    assert float((np.abs(found - truth) / deviation[:, None, None, None]).max()) < 6
    gradient = np.einsum("nk,nchw->kchw", matrix, np.einsum("nk,kchw->nchw", matrix, found) - images)
    assert float(np.abs(gradient).max()) < 1e-4 * len(LIGHT) * 0.01


def test_more_harmonics_than_lights_give_the_minimum_norm():
    light, view = all_pairs(hemisphere(((10, 1), (45, 5))), hemisphere(((0, 1),)))
    images = uniform(len(light), 3, HEIGHT, WIDTH)
    result = tm.fit(btf_of(images, torch.float64, light=light, view=view), "hsh", holdout=0, dtype=torch.float64, space="linear")
    expected = np.linalg.pinv(harmonics(light, 3)) @ images.reshape(len(light), -1)
    found = result.material.maps["harmonic"].detach()
    assert_close(found, torch.from_numpy(expected.reshape(27, HEIGHT, WIDTH)), 1e-6)
    assert_close(result.coverage, torch.full((1, HEIGHT, WIDTH), 6 / 9))
