"""Each test helper, proven able to fail."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from tests import support
import torch
from tests.support import TOLERANCE, all_pairs, assert_close, hemisphere, plausible_images, shared_path


def test_assert_close_passes_within_the_tolerance(dtype):
    expected = torch.tensor([1.0, -100.0], dtype=dtype)
    assert_close(expected + 50 * TOLERANCE[dtype], expected)
    assert_close(expected.clone(), expected)


def test_assert_close_fails_beyond_the_tolerance(dtype):
    expected = torch.tensor([1.0, -100.0], dtype=dtype)
    with pytest.raises(AssertionError, match="worst relative difference"):
        assert_close(expected + torch.tensor([200 * TOLERANCE[dtype], 0], dtype=dtype), expected)
    with pytest.raises(AssertionError, match=r"allowed 0\.1"):
        assert_close(torch.tensor([0.0]), torch.tensor([1.0]), 0.1)


def test_assert_close_looks_at_the_worst_element_not_the_mean():
    expected = torch.zeros(1000) + 1
    actual = expected.clone()
    actual[3] += 0.01
    actual[4] -= 0.01
    with pytest.raises(AssertionError, match=r"worst relative difference 0\.01"):
        assert_close(actual, expected)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_assert_close_fails_on_what_is_not_finite(bad):
    with pytest.raises(AssertionError, match="not finite"):
        assert_close(torch.tensor([bad]), torch.tensor([bad]))


def test_assert_close_fails_on_shapes_that_would_broadcast():
    with pytest.raises(AssertionError, match="shapes differ"):
        assert_close(torch.ones(2, 1), torch.ones(2, 2))


def test_assert_close_fails_on_anything_but_zero_for_zero():
    assert_close(torch.zeros(3), torch.zeros(3))
    with pytest.raises(AssertionError):
        assert_close(torch.full((3,), 1e-12), torch.zeros(3))


def test_hemisphere_is_of_unit_vectors_above_the_horizon():
    rows = hemisphere()
    assert rows.shape == (22, 3)
    assert np.abs(np.linalg.norm(rows, axis=1) - 1).max() < 1e-15
    assert rows[:, 2].min() == pytest.approx(np.cos(np.deg2rad(70)))
    assert len(np.unique(rows.round(9), axis=0)) == 22
    assert tuple(rows[0]) == (0, 0, 1)


def test_all_pairs_has_each_pair_once_with_views_outermost():
    lights, views = hemisphere(((0, 1), (40, 2))), hemisphere(((10, 2),))
    light, view = all_pairs(lights, views)
    assert light.shape == view.shape == (6, 3)
    assert len(np.unique(np.concatenate((light, view), axis=1), axis=0)) == 6
    assert np.array_equal(light[:3], lights)
    assert np.array_equal(view[:3], np.tile(views[:1], (3, 1)))


def test_plausible_images_are_seeded_positive_and_answer_to_light_and_view():
    light, view = all_pairs(hemisphere(), hemisphere())
    images = plausible_images(light, view)
    assert images.shape == (484, 3, 5, 4)
    assert images.min() >= 0
    assert np.array_equal(images, plausible_images(light, view))
    assert not np.array_equal(images, plausible_images(light, view, seed=1))
    assert not np.allclose(images, plausible_images(view, light))
    assert images.std(axis=0).min() > 0
    assert images.std(axis=(2, 3)).min() > 0


def test_shared_path_skips_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(support, "SHARED", tmp_path)
    with pytest.raises(pytest.skip.Exception, match="shared data nothing is not on this machine"):
        shared_path("nothing")
    (tmp_path / "something").touch()
    assert shared_path("something") == tmp_path / "something"


def test_the_cache_of_tests_is_not_the_users(tmp_path):
    assert Path(os.environ["TORCHMAT_CACHE"]).parent == tmp_path


def test_every_test_starts_from_one_random_state():
    first = torch.rand(3)
    torch.manual_seed(0)
    assert torch.equal(first, torch.rand(3))


def test_small_btf_holds_the_images(small_btf):
    light, view = all_pairs(hemisphere(), hemisphere())
    assert len(small_btf) == 484
    assert_close(small_btf.light.double(), torch.from_numpy(light), 1e-6)
    assert_close(small_btf.view.double(), torch.from_numpy(view), 1e-6)
    assert_close(small_btf.image(7).double(), torch.from_numpy(plausible_images(light, view)[7]), 1e-6)
