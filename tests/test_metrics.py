"""The error figures against plain NumPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.reference import colour as oracle
from tests.support import assert_close

from torchmat import colour, metrics


def _images(count=3, height=12, width=9, seed=0, dtype=torch.float32):
    random = np.random.default_rng(seed)
    target = random.uniform(0, 1.3, (count, 3, height, width))
    prediction = target + random.normal(0, 0.1, target.shape)
    return torch.tensor(prediction, dtype=dtype), torch.tensor(target, dtype=dtype)


def _errors(prediction, target, valid=None, clipped=None, perceptual=None) -> metrics.SampleErrors:
    count, _, height, width = target.shape
    mask = torch.ones(count, 1, height, width, dtype=torch.bool)
    errors = metrics.SampleErrors()
    errors.add(
        prediction, target, mask if valid is None else valid, ~mask if clipped is None else clipped,
        torch.ones(count, dtype=torch.bool) if perceptual is None else perceptual,
    )
    return errors


def _encode(image):
    return np.vectorize(oracle.encode)(np.clip(image, 0, 1))


def _figures(prediction, target):
    """The four pooled figures in NumPy."""
    p, t = prediction.double().numpy(), target.double().numpy()
    mu = 5000.0

    def log(x):
        return np.log(1 + mu * np.maximum(x, 0)) / np.log(1 + mu)

    return {
        "mse": ((p - t) ** 2).mean(), "relative_error": ((p - t) ** 2).sum() / (t**2).sum(),
        "psnr_db": 10 * np.log10(1 / ((_encode(p) - _encode(t)) ** 2).mean()),
        "psnr_log_db": 10 * np.log10(1 / ((log(p) - log(t)) ** 2).mean()),
    }


def test_pooled_figures(dtype):
    prediction, target = _images(dtype=dtype)
    found = _errors(prediction, target).pooled()
    for key, value in _figures(prediction, target).items():
        assert found[key] == pytest.approx(value, rel=1e-5 if dtype == torch.float32 else 1e-10), key


def test_by_hand():
    found = _errors(torch.full((1, 3, 1, 1), 0.5), torch.full((1, 3, 1, 1), 0.25)).report()
    assert found["mse"] == pytest.approx(0.0625)
    assert found["relative_error"] == pytest.approx(1.0)
    assert found["psnr_db"] == pytest.approx(-20 * math.log10(oracle.encode(0.5) - oracle.encode(0.25)), rel=1e-6)
    assert found["ssim"] is None


def test_samples_pool_however_they_are_added():
    prediction, target = _images(4)
    together, apart = _errors(prediction, target), metrics.SampleErrors()
    for part in (slice(0, 1), slice(1, 4)):
        k = len(target[part])
        mask = torch.ones(k, 1, *target.shape[-2:], dtype=torch.bool)
        apart.add(prediction[part], target[part], mask, ~mask, torch.ones(k, dtype=torch.bool))
    for key, value in together.report().items():
        assert apart.report()[key] == pytest.approx(value, rel=1e-6), key
    assert_close(apart.per_sample_display(), together.per_sample_display(), 1e-6)  # float32 powers differ by batch


def test_chosen_samples():
    prediction, target = _images(4)
    chosen = torch.tensor([True, False, True, False])
    found = _errors(prediction, target).pooled(chosen)
    for key, value in _figures(prediction[chosen], target[chosen]).items():
        assert found[key] == pytest.approx(value, rel=1e-5), key


def test_per_sample_display_pools_to_the_psnr():
    prediction, target = _images()
    errors = _errors(prediction, target)
    assert metrics.psnr(float(errors.per_sample_display().mean())) == pytest.approx(errors.pooled()["psnr_db"])


@pytest.mark.parametrize("channels", [1, 3])
def test_invalid_samples_count_nowhere(channels):
    prediction, target = _images(2, 16, 16)
    valid = torch.ones(2, channels, 16, 16, dtype=torch.bool)
    valid[:, :, :, 8:] = False
    spoiled = prediction.clone()
    spoiled[..., 8:] = float("nan")
    garbage = target.clone()
    garbage[..., 8:] = 1e6
    found = _errors(spoiled, garbage, valid=valid).report()
    for key, value in _figures(prediction[..., :8], target[..., :8]).items():
        assert found[key] == pytest.approx(value, rel=1e-5), key
    assert found["delta_e"] == pytest.approx(_errors(prediction[..., :8], target[..., :8]).report()["delta_e"], rel=1e-5)
    # The half that has no data must not count as a perfect match; windows at the seam see it, so only nearly equal.
    assert found["ssim"] == pytest.approx(_errors(prediction[..., :8], target[..., :8]).report()["ssim"], abs=0.05)
    assert found["ssim"] < 0.99


def test_a_sample_without_data_is_left_out():
    prediction, target = _images(2)
    valid = torch.ones(2, 1, 12, 9, dtype=torch.bool)
    valid[1] = False
    found, alone = _errors(prediction, target, valid=valid).report(), _errors(prediction[:1], target[:1]).report()
    assert found == pytest.approx(alone)
    nothing = _errors(prediction, target, valid=torch.zeros_like(valid)).report()
    assert nothing == {"mse": 0, "relative_error": 0, "psnr_db": 200, "psnr_log_db": 200, "ssim": None, "delta_e": None}


def test_clipped_targets_are_one_sided():
    target = torch.full((1, 3, 1, 2), 0.8)
    prediction = torch.tensor([5.0, 0.5]).expand(1, 3, 1, 2)
    clipped = torch.ones(1, 1, 1, 2, dtype=torch.bool)
    found = _errors(prediction, target, clipped=clipped).pooled()
    assert found["mse"] == pytest.approx(0.09 / 2)
    # A clipped channel alone: masks may have three channels.
    one = torch.zeros(1, 3, 1, 2, dtype=torch.bool)
    one[:, 0] = True
    assert _errors(prediction, target, clipped=one).pooled()["mse"] == pytest.approx((3 * 0.09 + 2 * 4.2**2) / 6)


def test_an_all_zero_target():
    zero = torch.zeros(1, 3, 6, 6)
    found = _errors(zero, zero).report()
    assert (found["mse"], found["relative_error"], found["psnr_db"], found["psnr_log_db"]) == (0, 0, 200, 200)
    assert found["ssim"] == pytest.approx(1, abs=2e-5)  # kornia adds 1e-12 to a denominator of 9e-8
    assert found["delta_e"] == 0
    wrong = _errors(zero + 0.1, zero).pooled()
    assert wrong["relative_error"] is None
    assert wrong["mse"] == pytest.approx(0.01)


@pytest.mark.parametrize("height, width, defined", [(1, 1, False), (5, 30, False), (30, 5, False), (6, 6, True)])
def test_ssim_of_tiny_images(height, width, defined):
    prediction, target = _images(1, height, width)
    report = _errors(prediction, target).report()
    assert (report["ssim"] is not None) is defined
    assert report["delta_e"] > 0


def _ssim(x, y):
    """SSIM of two planes after Wang et al. 2004: Gaussian window 11, sigma 1.5, reflected borders, peak 1."""
    offset = np.arange(11) - 5
    line = np.exp(-(offset**2) / (2 * 1.5**2))
    window = np.outer(line, line) / line.sum() ** 2
    x, y = (np.pad(image, 5, mode="reflect") for image in (x, y))
    total, places = 0.0, 0
    for row in range(x.shape[0] - 10):
        for column in range(x.shape[1] - 10):
            a, b = x[row : row + 11, column : column + 11], y[row : row + 11, column : column + 11]
            mean_a, mean_b = (window * a).sum(), (window * b).sum()
            var_a, var_b = (window * a * a).sum() - mean_a**2, (window * b * b).sum() - mean_b**2
            covariance = (window * a * b).sum() - mean_a * mean_b
            total += ((2 * mean_a * mean_b + 1e-4) * (2 * covariance + 9e-4)) / (
                (mean_a**2 + mean_b**2 + 1e-4) * (var_a + var_b + 9e-4)
            )
            places += 1
    return total / places


def test_ssim_against_numpy():
    prediction, target = _images(1)
    shown, wanted = _encode(prediction.double().numpy())[0], _encode(target.double().numpy())[0]
    expected = np.mean([_ssim(shown[c], wanted[c]) for c in range(3)])
    assert _errors(prediction, target).report()["ssim"] == pytest.approx(expected, abs=1e-5)


def test_delta_e_is_the_mean_over_texels():
    prediction, target = _images(2, 3, 2)
    total = 0.0
    for p, t in zip(prediction.movedim(1, -1).reshape(-1, 3), target.movedim(1, -1).reshape(-1, 3), strict=True):
        labs = [colour.srgb_to_lab(torch.tensor(_encode(v.double().numpy())).reshape(3, 1, 1)) for v in (p, t)]
        total += float(colour.ciede2000(*labs))
    assert _errors(prediction, target).report()["delta_e"] == pytest.approx(total / 12, rel=1e-4)


def test_only_perceptual_samples_get_the_slow_figures():
    prediction, target = _images(3)
    chosen = torch.tensor([False, True, False])
    found = _errors(prediction, target, perceptual=chosen).report()
    alone = _errors(prediction[1:2], target[1:2]).report()
    assert found["ssim"] == pytest.approx(alone["ssim"])
    assert found["delta_e"] == pytest.approx(alone["delta_e"])
    assert _errors(prediction, target, perceptual=~torch.ones(3, dtype=torch.bool)).report()["ssim"] is None


def test_a_prediction_that_is_not_a_number_is_no_perfect_score():
    prediction, target = _images(1)
    prediction[0, 0, 0, 0] = float("nan")
    found = _errors(prediction, target).report()
    assert all(math.isnan(value) for value in found.values()), found
    assert math.isnan(metrics.psnr(math.nan))


def test_psnr_ends():
    assert metrics.psnr(0.0) == 200
    assert metrics.psnr(1.0) == 0
    assert metrics.psnr(0.01) == pytest.approx(20)
    assert metrics.psnr(math.inf) == -math.inf


def test_log_encoding():
    ends = metrics.log_encode(torch.tensor([-1.0, 0.0, 1.0, 1e-4]))
    assert_close(ends, torch.tensor([0, 0, 1, math.log(1.5) / math.log(5001)]))


def test_relative():
    assert metrics.relative(1.0, 4.0) == 0.25
    assert metrics.relative(0.0, 0.0) == 0
    assert metrics.relative(1.0, 0.0) is None
