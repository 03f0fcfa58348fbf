"""Hard cases 8 to 10 of fits that want options or data of their own; every model by every solver is in the table."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.hard_cases.cases_fitting import LIGHT, VIEW, btf_of, fitted, predicted, small_options
from tests.hard_cases.components import Room
from tests.support import all_pairs, assert_close, plausible_images

import torchmat as tm
from torchmat import FitError


def test_8_dark_texels_are_not_lost_to_a_highlight_that_has_a_component(tmp_path):
    images = plausible_images(LIGHT, VIEW, 12, 12) * 1e-2
    bright = images.copy()
    bright[30:34, :, 3, 4] = 1e4
    on = torch.ones(12, 12, dtype=torch.bool)
    on[3, 4] = False
    road, options = ("pca", "closed_form"), {"components": len(LIGHT)}  # full rank, or the highlight takes a component
    plain, hdr = (
        predicted(fitted(btf_of(data), road, Room(tmp_path), **options), btf_of(data))[..., on] for data in (images, bright)
    )
    assert_close(hdr, plain, 1e-3)


@pytest.mark.parametrize("residual", ["half", "half_light", "quadratic"])
def test_9_coplanar_half_vectors_are_flagged(residual, tmp_path):
    line = np.stack((np.sin(np.linspace(-1, 1, 9)), np.zeros(9), np.cos(np.linspace(-1, 1, 9))), axis=1)
    light, view = all_pairs(line, line[3:6])
    btf = btf_of(plausible_images(light, view), light, view)
    result = fitted(btf, ("phong_srf", "lm"), Room(tmp_path), residual=residual)
    assert 0 < float(result.coverage.min()) == float(result.coverage.max()) < 1


def test_10_one_sample_cannot_be_held_out():
    with pytest.raises(tm.RangeError, match="at least two pairs.*holdout=0"):
        tm.fit(btf_of(plausible_images(LIGHT[:1], VIEW[:1]), LIGHT[:1], VIEW[:1]), "texture")


@pytest.mark.parametrize("model", ["texture", "lptm", "phong_srf", "pca"])
def test_10_25000_samples(model):
    random = np.random.default_rng(0)
    light, view = (random.normal(size=(25_000, 3)) for _ in range(2))
    for rows in (light, view):
        rows[:, 2] = np.abs(rows[:, 2]) + 0.2
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    images = plausible_images(light, view, 2, 2)
    result = tm.fit(btf_of(images, light, view), model, measure=False, **small_options(model, 25_000, 4))
    assert all(bool(torch.isfinite(value).all()) for value in result.material.maps.values())
    if model == "texture":
        train = result.split.train.numpy()
        cosine = light[train, 2]
        expected = np.einsum("n,nchw->chw", cosine, images[train]) / (cosine @ cosine)
        assert_close(result.material.maps["albedo"].detach(), torch.from_numpy(expected))


def test_fewer_samples_than_components_is_an_error_that_says_how_many():
    with pytest.raises(FitError, match="Use at most 3"):
        tm.fit(btf_of(plausible_images(LIGHT[:3], VIEW[:3]), LIGHT[:3], VIEW[:3]), "pca", holdout=0)
