"""The interval of a relative error: its definition in plain loops, its coverage, and where there is none."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torchmat import bootstrap, metrics
from torchmat.bootstrap import ratio_interval


def plain(error, energy, resamples=2000, seed=3):
    """The same in a loop, from other random numbers."""
    random = np.random.default_rng(seed)
    ratios = []
    for _ in range(resamples):
        drawn = [int(random.integers(len(error))) for _ in error]
        ratios.append(sum(error[k] for k in drawn) / sum(energy[k] for k in drawn))
    ratios.sort()
    return ratios[int(0.025 * resamples)], ratios[int(0.975 * resamples)]


def images(count, seed=0, bright=0):
    """Error and energy of images, of which some are a thousand times as bright."""
    random = np.random.default_rng(seed)
    energy = random.uniform(1, 2, count)
    energy[:bright] *= 1000
    return energy * random.uniform(0.01, 0.03, count), energy


@pytest.mark.parametrize("bright", [0, 3])
def test_it_is_that_of_plain_loops(bright):
    error, energy = images(60, bright=bright)
    low, high = ratio_interval(error, energy)
    assert (low, high) == pytest.approx(plain(error, energy), rel=0.05)
    assert low <= error.sum() / energy.sum() <= high


def test_it_covers_the_truth_as_often_as_it_says():
    found = [ratio_interval(*images(80, seed)) for seed in range(200)]
    truth = 0.02  # the factor is independent of the energy
    covered = np.mean([low <= truth <= high for low, high in found])
    assert 0.9 <= covered <= 0.99


def test_few_bright_images_widen_it():
    even, decided = (ratio_interval(*images(200, bright=bright)) for bright in (0, 5))
    assert (decided[1] - decided[0]) > 3 * (even[1] - even[0])


def test_the_same_images_give_the_same_interval_however_they_are_drawn(monkeypatch):
    error, energy = images(50)
    whole = ratio_interval(error, energy)
    assert ratio_interval(error, energy) == whole
    monkeypatch.setattr(bootstrap, "_DRAWN", 70)
    assert ratio_interval(error, energy) == pytest.approx(whole, rel=1e-12)  # the same numbers, fewer at a time


def test_images_that_are_alike_leave_nothing_open():
    assert ratio_interval(np.full(9, 0.3), np.full(9, 1.5)) == pytest.approx((0.2, 0.2))


@pytest.mark.parametrize("error, energy", [([], []), ([1.0], [2.0]), ([0.0, 0.0], [0.0, 0.0]), ([np.nan, 1], [1, 1]), ([np.inf, 1], [1, 1])])
def test_where_there_is_none(error, energy):
    assert ratio_interval(np.array(error), np.array(energy)) is None


def test_draws_of_black_images_alone_do_not_count():
    assert ratio_interval([0.0, 0.1], [0.0, 1.0]) == pytest.approx((0.1, 0.1))


def test_of_sample_errors():
    random = np.random.default_rng(0)
    target = torch.tensor(random.uniform(0, 1, (7, 3, 4, 5)))
    prediction = target + torch.tensor(random.normal(0, 0.1, target.shape))
    mask = torch.ones(7, 1, 4, 5, dtype=torch.bool)
    errors = metrics.SampleErrors()
    assert errors.relative_error_interval() is None
    for part in (slice(0, 3), slice(3, 7)):
        errors.add(prediction[part], target[part], mask[part], ~mask[part], torch.zeros(len(target[part]), dtype=torch.bool))
    p, t = prediction.numpy(), target.numpy()
    wanted = ratio_interval(((p - t) ** 2).sum(axis=(1, 2, 3)), (t**2).sum(axis=(1, 2, 3)))
    assert errors.relative_error_interval() == pytest.approx(wanted)
