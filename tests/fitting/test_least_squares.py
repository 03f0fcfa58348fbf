"""Shared-design least squares against NumPy, texel by texel, in float64."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import torch
from tests.support import assert_close

from torchmat import Btf
from torchmat.btf.btf import CLIPPED, PixelStore, summarise
from torchmat.btf.decode import Decoder
from torchmat.fitting.models.streamed import solve_texels, stream_moments
from torchmat.solvers.least_squares import make_design

HEIGHT, WIDTH = 3, 4
# float32 streams the products; 2e-5 of the largest coefficient holds for designs as well conditioned as these.
BOUND = {torch.float32: 5e-5, torch.float64: 1e-10}


def directions(count, seed=0):
    random = np.random.default_rng(seed)
    found = random.normal(size=(count, 3))
    found[:, 2] = np.abs(found[:, 2]) + 0.3
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def images_of(count, seed=1):
    return np.random.default_rng(seed).uniform(0, 1, (count, 3, HEIGHT, WIDTH))


def btf_of(images, weight=None, light=None, clipped_weight=None):
    """Return a Btf of float64 images; `weight` 0 masks, and where `clipped_weight` is given, marks as clipped."""
    light = directions(len(images)) if light is None else light
    if clipped_weight is None:
        return Btf.from_tensors(images, light, directions(len(images), 9), weight)
    flags = np.where(weight == 0, CLIPPED, 0).astype(np.uint8)
    store = summarise(np.ascontiguousarray(images), flags)
    assert isinstance(store, PixelStore)
    view = torch.from_numpy(directions(len(images), 9))
    return Btf(store, torch.from_numpy(light), view, Decoder(images.dtype, "linear", 1.0), None, clipped_weight)


def solve(btf, matrix, used=None, ridge=0.0, dtype=torch.float64, explained=None):
    used = torch.ones(len(btf), dtype=torch.bool) if used is None else torch.as_tensor(used)
    design = make_design(torch.as_tensor(matrix), used, ridge)
    return solve_texels(btf, design, stream_moments(btf, design, used, dtype), used, explained)


def oracle(matrix, images, weight, explained=0.0, penalty=0.0):
    """Return [K, 3, H, W] of minimum norm, one texel and channel at a time."""
    out = np.zeros((matrix.shape[1], *images.shape[1:]))
    for channel, row, column in np.ndindex(images.shape[1:]):
        root = np.sqrt(weight[:, row, column])
        values = (images[:, channel, row, column] - (explained[:, channel] if np.ndim(explained) else 0)) * root
        scaled = matrix * root[:, None]
        if penalty:
            normal = scaled.T @ scaled + penalty * np.eye(matrix.shape[1])
            out[:, channel, row, column] = np.linalg.solve(normal, scaled.T @ values)
        else:
            out[:, channel, row, column] = np.linalg.pinv(scaled, rcond=1e-6) @ values
    return out


def test_plain_samples_match_lstsq(dtype):
    images, matrix = images_of(20), np.random.default_rng(3).normal(size=(20, 5))
    solved = solve(btf_of(images), matrix, dtype=dtype)
    expected = np.linalg.lstsq(matrix, images.reshape(20, -1), rcond=None)[0].reshape(5, 3, HEIGHT, WIDTH)
    assert_close(solved.coefficients, torch.from_numpy(expected), BOUND[dtype])
    assert torch.equal(solved.coverage, torch.ones(1, HEIGHT, WIDTH))


def test_masked_samples_match_weighted_lstsq(dtype):
    random = np.random.default_rng(4)
    images, matrix = images_of(25), random.normal(size=(25, 4))
    weight = (random.random((25, HEIGHT, WIDTH)) > 0.4).astype(float)
    weight[:, 0, 0] = 1
    solved = solve(btf_of(images, weight), matrix, dtype=dtype)
    assert_close(solved.coefficients, torch.from_numpy(oracle(matrix, images, weight)), BOUND[dtype])


def test_clipped_samples_count_their_weight(dtype):
    random = np.random.default_rng(5)
    images, matrix = images_of(25), random.normal(size=(25, 4))
    clear = (random.random((25, HEIGHT, WIDTH)) > 0.3).astype(float)
    solved = solve(btf_of(images, clear, clipped_weight=0.05), matrix, dtype=dtype)
    weight = np.where(clear == 0, float(np.float32(0.05)), 1.0)
    assert_close(solved.coefficients, torch.from_numpy(oracle(matrix, images, weight)), BOUND[dtype])


def test_what_is_explained_is_taken_off_masked_and_whole_texels():
    random = np.random.default_rng(6)
    images, matrix, explained = images_of(25), random.normal(size=(25, 4)), random.normal(size=(25, 3))
    weight = (random.random((25, HEIGHT, WIDTH)) > 0.4).astype(float)
    weight[:, 0] = 1
    solved = solve(btf_of(images, weight), matrix, explained=torch.from_numpy(explained))
    assert_close(solved.coefficients, torch.from_numpy(oracle(matrix, images, weight, explained)), 1e-7)


def test_unused_samples_do_not_matter(dtype):
    images, matrix = images_of(20), np.random.default_rng(3).normal(size=(20, 5))
    used = np.arange(20) % 4 != 0
    first = solve(btf_of(images), matrix, used, dtype=dtype)
    images[~used], matrix[~used] = 1e6, 1e3
    second = solve(btf_of(images), matrix, used, dtype=dtype)
    assert torch.equal(first.coefficients, second.coefficients)


@pytest.mark.parametrize("count", [1, 2])
def test_fewer_samples_than_unknowns_give_the_minimum_norm(count, dtype):
    images, matrix = images_of(count), directions(count)
    solved = solve(btf_of(images), matrix, dtype=dtype)
    expected = oracle(matrix, images, np.ones((count, HEIGHT, WIDTH)))
    assert_close(solved.coefficients, torch.from_numpy(expected), BOUND[dtype])
    assert_close(solved.coverage, torch.full((1, HEIGHT, WIDTH), count / 3))


def test_coplanar_vectors_give_the_minimum_norm(dtype):
    angles = np.linspace(-1, 1, 9)
    matrix = np.stack((np.sin(angles), 0 * angles, np.cos(angles)), axis=1)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    matrix = matrix @ turn  # a plane that no axis lies in
    images = images_of(9)
    solved = solve(btf_of(images), matrix, dtype=dtype)
    expected = oracle(matrix, images, np.ones((9, HEIGHT, WIDTH)))
    assert_close(solved.coefficients, torch.from_numpy(expected), BOUND[dtype])
    assert_close(solved.coverage, torch.full((1, HEIGHT, WIDTH), 2 / 3))


def test_coplanar_vectors_of_masked_texels_give_the_minimum_norm(dtype):
    angles = np.linspace(-1, 1, 9)
    matrix = np.stack((np.sin(angles), 0.3 * np.sin(angles), np.cos(angles)), axis=1)
    random = np.random.default_rng(2)
    images, weight = images_of(9), (random.random((9, HEIGHT, WIDTH)) > 0.3).astype(float)
    solved = solve(btf_of(images, weight), matrix, dtype=dtype)
    assert_close(solved.coefficients, torch.from_numpy(oracle(matrix, images, weight)), BOUND[dtype])


def test_a_texel_that_keeps_few_samples_gets_the_minimum_norm_and_says_so(dtype):
    images, matrix = images_of(12), directions(12)
    weight = np.ones((12, HEIGHT, WIDTH))
    for column, kept in enumerate((0, 1, 2)):
        weight[kept:, 0, column] = 0
    explained = torch.from_numpy(np.random.default_rng(0).normal(size=(12, 3)))
    for shared in (None, explained):
        solved = solve(btf_of(images, weight), matrix, dtype=dtype, explained=shared)
        expected = oracle(matrix, images, weight, 0.0 if shared is None else shared.numpy())
        assert_close(solved.coefficients, torch.from_numpy(expected), 20 * BOUND[dtype])
        assert bool((solved.coefficients[..., 0, 0] == 0).all())
        expected_coverage = torch.ones(1, HEIGHT, WIDTH)
        expected_coverage[0, 0, :3] = torch.tensor([0, 1 / 3, 2 / 3])
        assert_close(solved.coverage, expected_coverage)


def test_a_texel_clipped_throughout_is_solved_but_not_called_determined():
    images, matrix = images_of(12), directions(12)
    clear = np.ones((12, HEIGHT, WIDTH))
    clear[:, 1, 2] = 0
    for weight in (0.05, 0.3, 0.7):
        solved = solve(btf_of(images, clear, clipped_weight=weight), matrix)
        expected = oracle(matrix, images, np.ones_like(clear))  # one weight for all samples of a texel is none
        assert_close(solved.coefficients, torch.from_numpy(expected), 1e-6)
        expected_coverage = torch.ones(1, HEIGHT, WIDTH)
        expected_coverage[0, 1, 2] = 0
        assert torch.equal(solved.coverage, expected_coverage), weight


@pytest.mark.parametrize("masked", [False, True])
def test_ridge_is_the_stated_formula(masked, dtype):
    random = np.random.default_rng(7)
    images, matrix = images_of(25), random.normal(size=(25, 4))
    weight = (random.random((25, HEIGHT, WIDTH)) > 0.4).astype(float) if masked else np.ones((25, HEIGHT, WIDTH))
    solved = solve(btf_of(images, weight), matrix, ridge=0.1, dtype=dtype)
    penalty = 0.1 * (matrix**2).sum() / 4
    assert_close(solved.coefficients, torch.from_numpy(oracle(matrix, images, weight, penalty=penalty)), BOUND[dtype])


@pytest.mark.parametrize("masked", [False, True])
def test_columns_from_1e_minus_4_to_1e4_keep_their_digits(masked, dtype):
    random = np.random.default_rng(8)
    scale = np.array([1e-4, 1e-2, 1.0, 1e4])
    images, matrix = images_of(25), random.normal(size=(25, 4))
    weight = (random.random((25, HEIGHT, WIDTH)) > 0.4).astype(float) if masked else np.ones((25, HEIGHT, WIDTH))
    solved = solve(btf_of(images, weight), matrix * scale, dtype=dtype)
    restored = solved.coefficients.double() * torch.from_numpy(scale)[:, None, None, None]
    assert_close(restored, torch.from_numpy(oracle(matrix, images, weight)), BOUND[dtype])


def test_identical_samples_count_twice():
    images, matrix = images_of(10), np.random.default_rng(3).normal(size=(10, 4))
    twice, rows = np.concatenate((images, images[:3])), np.concatenate((matrix, matrix[:3]))
    solved = solve(btf_of(twice), rows)
    weight = np.ones((10, HEIGHT, WIDTH))
    weight[:3] = 2
    assert_close(solved.coefficients, torch.from_numpy(oracle(matrix, images, weight)), 1e-10)


def test_residuals_are_orthogonal_to_the_design():
    images, matrix = images_of(30), np.random.default_rng(3).normal(size=(30, 6))
    solved = solve(btf_of(images), matrix)
    rest = np.einsum("nk,kchw->nchw", matrix, solved.coefficients.numpy()) - images
    assert float(np.abs(np.einsum("nk,nchw->kchw", matrix, rest)).max()) < 1e-12


def test_dark_texels_keep_their_digits_beside_a_highlight(dtype):
    images, matrix = images_of(20) * 1e-8, np.random.default_rng(3).normal(size=(20, 5))
    images[4, :, 1, 1] = 1e4
    solved = solve(btf_of(images), matrix, dtype=dtype)
    expected = oracle(matrix, images, np.ones((20, HEIGHT, WIDTH)))
    dark = np.ones((HEIGHT, WIDTH), dtype=bool)
    dark[1, 1] = False
    found = solved.coefficients.flatten(2)[..., dark.reshape(-1)]
    assert_close(found, torch.from_numpy(expected[..., dark]), BOUND[dtype])


def test_means_weigh_each_image_by_its_own_weights():
    random = np.random.default_rng(1)
    images, weight = images_of(6), (random.random((6, HEIGHT, WIDTH)) > 0.5).astype(float)
    weight[5] = 0
    btf = btf_of(images, weight)
    used = torch.ones(6, dtype=torch.bool)
    means = stream_moments(btf, make_design(torch.from_numpy(directions(6)), used), used, torch.float64).means
    for sample in range(5):
        on = weight[sample].astype(bool)
        assert_close(means[sample], torch.from_numpy(images[sample][:, on].mean(axis=1)), 1e-12)
    assert torch.equal(means[5], torch.zeros(3, dtype=torch.float64))


def in_units(columns, units, rank):
    """Return a matrix [25, columns] of a rank with columns in units of their own, and these units."""
    random = np.random.default_rng(3)
    return random.normal(size=(25, rank)) @ random.normal(size=(rank, columns)), np.geomspace(1, units, columns)


def exact(matrix, unit, values, ridge):
    """Return the penalised solution [K] in 80 digits."""
    with mpmath.workdps(80):
        a, y = mpmath.matrix((matrix * unit).tolist()), mpmath.matrix(values.tolist())
        penalty = mpmath.mpf(ridge) * sum(x * x for x in a) / len(unit)
        return np.array([float(x) for x in mpmath.lu_solve(a.T * a + penalty * mpmath.eye(len(unit)), a.T * y)])


@pytest.mark.parametrize("units", [1e-12, 1e-6, 1e6, 1e12, 1e20])
@pytest.mark.parametrize("ridge", [0.0, 1e-3])
def test_units_of_columns_cost_no_digits_of_float64(units, ridge):
    matrix, unit = in_units(4, units, 4)
    images = images_of(25)
    solved = solve(btf_of(images), matrix * unit, ridge=ridge).coefficients[:, 0, 0, 0]
    expected = exact(matrix, unit, images[:, 0, 0, 0], ridge)
    # Each coefficient has its digits, however small it is beside the others; by pinv of the columns as they are six and
    # twelve magnitudes cost as many digits, twenty the column itself.
    for found, wanted in zip(solved, expected, strict=True):
        assert_close(found, torch.tensor(wanted, dtype=torch.float64), 1e-12)


@pytest.mark.parametrize("units", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_dependent_columns_of_any_units_give_the_minimum_norm_in_them(units):
    matrix, unit = in_units(4, units, 3)
    images = images_of(25)
    solved = solve(btf_of(images), matrix * unit).coefficients.flatten(1)
    some = np.linalg.lstsq(matrix, images.reshape(25, -1), rcond=1e-12)[0] / unit[:, None]
    without_effect = np.linalg.svd(matrix)[2][3] / unit
    without_effect /= np.linalg.norm(without_effect)
    # What is taken off is far larger than what stays: measured 5e-12 where units differ by 1e12, below 1e-14 for one unit.
    assert_close(solved, some - np.outer(without_effect, without_effect @ some), 2e-11)
