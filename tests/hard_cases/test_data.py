"""Hard cases 8, 9 and 10 for every model that can be fitted: finite, flagged, and no worse than it must be."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, FitError
from torchmat.btf.btf import CLIPPED, summarise
from torchmat.btf.decode import Decoder
from torchmat.fit import FITTERS, predict

LIGHTS = hemisphere()
LIGHT, VIEW = all_pairs(LIGHTS, hemisphere(((0, 1), (30, 4), (60, 5))))
COVERED = ("texture", "lambert", "ptm", "lptm", "hsh", "phong_srf")


def options_of(model, samples=99, texels=99):
    if model == "pca":
        return {"components": min(4, samples, 3 * texels)}
    if model == "local_pca":
        return {"clusters": min(2, texels), "components": min(2, texels, 3 * samples)}
    if model == "distribution":  # few steps: that nothing breaks shows at once
        return {"lobes": 1, "fresnel": "yes", "rotation": "yes", "specular_size": 8, "effort": 0.02}
    if model == "neural":
        return {"latent": 2, "hidden": 4, "effort": 0.002}
    return {}


def checked(btf, model, **options):
    """Fit; assert that maps, predictions and their gradients are finite; return the result."""
    options = {**options_of(model, len(btf), btf.height * btf.width), "holdout": 0, **options}
    result = tm.fit(btf, model, **options)
    material = result.material
    assert all(bool(torch.isfinite(value).all()) for value in material.maps.values())
    light, view = (rows[:4, :, None, None].float() for rows in (btf.light, btf.view))
    shaded = material.shade(light, view)
    assert bool(torch.isfinite(shaded).all())
    shaded.sum().backward()
    assert all(value.grad is None or bool(torch.isfinite(value.grad).all()) for value in material.parameters())
    return result


def btf_of(images, light=LIGHT, view=VIEW, weight=None):
    return Btf.from_tensors(np.asarray(images, np.float32), light, view, weight)


@pytest.mark.parametrize("model", [*COVERED, "pca"])
def test_8_dark_texels_are_not_lost_to_a_highlight(model):
    images = plausible_images(LIGHT, VIEW, 12, 12) * 1e-2
    bright = images.copy()
    bright[30:34, :, 3, 4] = 1e4
    options = {"components": len(LIGHT)} if model == "pca" else {}
    on = torch.ones(12, 12, dtype=torch.bool)
    on[3, 4] = False
    plain, hdr = (
        predict(checked(btf_of(data), model, storage="float", **options).material, btf_of(data), torch.arange(len(LIGHT)))
        for data in (images, bright)
    )
    # phong_srf: one texel of 144 leaves the mean of the lobe. pca: full rank, or the highlight takes a component.
    assert_close(hdr[..., on], plain[..., on], 0.01 if model == "phong_srf" else 1e-3)


@pytest.mark.parametrize("model", FITTERS)
def test_9_a_black_texel(model):
    images = plausible_images(LIGHT, VIEW)
    images[:, :, 2, 1] = 0
    result = checked(btf_of(images), model, **({"residual": "half_light"} if model == "phong_srf" else {}))
    # These share something with the other texels, and the steps of the last two are counted.
    if model not in ("phong_srf", "local_pca", "distribution", "neural"):
        shaded = predict(result.material, btf_of(images), torch.arange(len(LIGHT)))
        assert float(shaded[:, :, 2, 1].abs().max()) < 1e-6


@pytest.mark.parametrize("model", FITTERS)
def test_9_a_texel_without_any_sample(model):
    weight = np.ones((len(LIGHT), 5, 4))
    weight[:, 1, 1] = 0
    result = checked(btf_of(plausible_images(LIGHT, VIEW), weight=weight), model)
    if model in COVERED:
        assert float(result.coverage[0, 1, 1]) == 0 and float(result.coverage.sum()) == 19


@pytest.mark.parametrize("model", FITTERS)
def test_9_a_texel_lit_in_one_sample_only(model):
    weight = np.ones((len(LIGHT), 5, 4))
    weight[:, 1, 1] = 0
    weight[7, 1, 1] = 1
    images = plausible_images(LIGHT, VIEW)
    result = checked(btf_of(images, weight=weight), model, storage="float")
    if model in COVERED:
        unknowns = {"texture": 1, "lambert": 3, "ptm": 6, "lptm": 6, "hsh": 9, "phong_srf": 3}[model]
        assert_close(result.coverage[0, 1, 1], torch.tensor(1 / unknowns))
    if model in ("texture", "ptm", "hsh"):
        found = predict(result.material, btf_of(images), torch.tensor([7]))[0, :, 1, 1]
        assert_close(found, torch.from_numpy(images[7, :, 1, 1]), 1e-4)


@pytest.mark.parametrize("model", FITTERS)
def test_9_a_texel_clipped_in_most_samples(model):
    images = plausible_images(LIGHT, VIEW).astype(np.float32)
    flags = np.zeros((len(LIGHT), 5, 4), np.uint8)
    flags[10:, 1, 1] = CLIPPED
    images[10:, :, 1, 1] = 1
    light, view = torch.from_numpy(LIGHT).float(), torch.from_numpy(VIEW).float()
    btf = Btf(summarise(images, flags), light, view, Decoder(images.dtype, "linear", 1.0))
    result = checked(btf, model, storage="float")
    if model == "texture":
        # The ten clear samples outweigh the 210 clipped ones at a weight of 0.05 each (10 against 10.5).
        weight = np.where(np.arange(len(LIGHT)) < 10, 1, 0.05)
        expected = (weight * LIGHT[:, 2]) @ images[:, :, 1, 1] / (weight @ LIGHT[:, 2] ** 2)
        assert_close(result.material.maps["albedo"][:, 1, 1].detach(), torch.from_numpy(expected), 1e-5)


@pytest.mark.parametrize("model", FITTERS)
@pytest.mark.parametrize("which", ["one light", "one view", "coplanar lights", "two identical", "one sample", "two samples"])
def test_9_directions_that_do_not_determine_the_model(model, which):
    line = np.stack((np.sin(np.linspace(-1, 1, 9)), np.zeros(9), np.cos(np.linspace(-1, 1, 9))), axis=1)
    light, view = {
        "one light": all_pairs(LIGHTS[4:5], LIGHTS), "one view": all_pairs(LIGHTS, LIGHTS[4:5]),
        "coplanar lights": all_pairs(line, LIGHTS[:1]), "two identical": (LIGHT[[0, 5, 5, 9]], VIEW[[0, 5, 5, 9]]),
        "one sample": (LIGHT[7:8], VIEW[7:8]), "two samples": (LIGHT[7:9], VIEW[7:9]),
    }[which]
    images = plausible_images(light, view)
    result = checked(btf_of(images, light, view), model)
    lights = len(np.unique(light.round(6), axis=0))
    unknowns = {"ptm": 6, "lptm": 6, "hsh": 9, "lambert": 3}.get(model)
    if unknowns and lights < unknowns:
        assert_close(result.coverage, torch.full((1, 5, 4), lights / unknowns))
    if model in ("lambert",) and which == "coplanar lights":
        assert_close(result.coverage, torch.full((1, 5, 4), 2 / 3))


@pytest.mark.parametrize("residual", ["half", "half_light", "quadratic"])
def test_9_coplanar_half_vectors_are_flagged(residual):
    line = np.stack((np.sin(np.linspace(-1, 1, 9)), np.zeros(9), np.cos(np.linspace(-1, 1, 9))), axis=1)
    light, view = all_pairs(line, line[3:6])
    result = checked(btf_of(plausible_images(light, view), light, view), "phong_srf", residual=residual)
    assert 0 < float(result.coverage.min()) == float(result.coverage.max()) < 1


@pytest.mark.parametrize("model", FITTERS)
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (3, 5), (1, 4096)])
def test_10_map_sizes(model, size):
    result = checked(btf_of(plausible_images(LIGHT, VIEW, *size)), model)
    assert result.material.size == size


@pytest.mark.parametrize("model", [*COVERED, "pca"])
def test_10_one_sample_is_reproduced_where_the_model_can(model):
    images = plausible_images(LIGHT[7:8], VIEW[7:8])
    btf = btf_of(images, LIGHT[7:8], VIEW[7:8])
    result = checked(btf, model, storage="float", **({"ridge": 0.0} if model == "phong_srf" else {}))
    assert_close(predict(result.material, btf, torch.tensor([0])), torch.from_numpy(images), 1e-4)


def test_10_one_sample_cannot_be_held_out():
    with pytest.raises(tm.RangeError, match="at least two pairs.*holdout=0"):
        tm.fit(btf_of(plausible_images(LIGHT[:1], VIEW[:1]), LIGHT[:1], VIEW[:1]), "texture")


@pytest.mark.parametrize("model", ["texture", "phong_srf", "pca"])
def test_10_25000_samples(model):
    random = np.random.default_rng(0)
    light, view = (random.normal(size=(25_000, 3)) for _ in range(2))
    for rows in (light, view):
        rows[:, 2] = np.abs(rows[:, 2]) + 0.2
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    images = plausible_images(light, view, 2, 2)
    result = tm.fit(btf_of(images, light, view), model, measure=False, **options_of(model))
    assert all(bool(torch.isfinite(value).all()) for value in result.material.maps.values())
    if model == "texture":
        train = result.split.train.numpy()
        cosine = light[train, 2]
        expected = np.einsum("n,nchw->chw", cosine, images[train]) / (cosine @ cosine)
        assert_close(result.material.maps["albedo"].detach(), torch.from_numpy(expected))


def test_fewer_samples_than_components_is_an_error_that_says_how_many():
    with pytest.raises(FitError, match="Use at most 3"):
        tm.fit(btf_of(plausible_images(LIGHT[:3], VIEW[:3]), LIGHT[:3], VIEW[:3]), "pca", holdout=0)
