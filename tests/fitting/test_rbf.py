"""Principal images under splines: against NumPy's SVD, leave-one-out errors column by column, and light where none was measured."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, FitError, RangeError
from torchmat.fitting import predict
from torchmat.fitting.models.rbf.spline import farthest, smooth
from torchmat.models.rbf import coordinates, cubes, plane_terms

HEIGHT, WIDTH = 6, 5
LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (30, 4), (60, 6))), hemisphere(((0, 1), (45, 3))))
COUNT = len(LIGHT)


def fitted(images, light=LIGHT, view=VIEW, **options):
    btf = Btf.from_tensors(images, light, view)
    material = tm.fit(btf, "rbf", dtype=torch.float64, holdout=0, measure=False, **{"storage": "float", "space": "linear", **options}).material
    return material, predict(material, btf, torch.arange(len(btf)))


@pytest.mark.parametrize("components", [1, 4, 9])
def test_truncation_costs_what_numpy_says(components):
    random = np.random.default_rng(0)
    left = np.linalg.qr(random.normal(size=(3 * COUNT, 20)))[0]
    matrix = (left * 0.6 ** np.arange(20)) @ np.linalg.qr(random.normal(size=(HEIGHT * WIDTH, 20)))[0].T
    matrix = matrix - matrix.min() + 0.1
    best = float((np.linalg.svd(matrix, compute_uv=False)[components:] ** 2).sum())
    _, predicted = fitted(matrix.reshape(COUNT, 3, HEIGHT, WIDTH), components=components, smoothing=0.0)
    error = float(((predicted.numpy().reshape(3 * COUNT, -1) - matrix) ** 2).sum())
    # Eckart-Young below; above, one power step with ten extra directions, and what a spline through noise misses at its samples.
    assert best * 0.999 <= error <= best * 1.01


def points_and_values(count=40):
    random = torch.Generator().manual_seed(3)
    light = torch.nn.functional.normalize(torch.rand(count, 3, generator=random, dtype=torch.float64) + 0.1, dim=1)
    values = torch.stack((light[:, 0] ** 2, light[:, 1].exp()), dim=1) + 0.05 * torch.rand(count, 2, generator=random, dtype=torch.float64)
    view = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).expand(count, 3)
    return coordinates(light, view, torch.tensor([0.5], dtype=torch.float64)), values


def said(spline, points, at):
    return torch.cat((cubes(at, points[spline.knots]), plane_terms(at)), dim=1) @ spline.table


@pytest.mark.parametrize("most_knots", [40, 15])
def test_what_is_left_out_is_what_the_hat_matrix_says(most_knots):
    points, values = points_and_values()
    root = torch.ones(len(points), 1, dtype=torch.float64)
    penalty = 1e-4
    found = smooth(points, values, root, penalty, most_knots)
    hat = said(smooth(points, torch.eye(len(points), dtype=torch.float64), root, penalty, most_knots), points, points)
    missed = (values - hat @ values) / (1 - hat.diagonal())[:, None]
    assert_close(found.left_out, missed.square().sum(dim=0), 1e-6)
    auto = smooth(points, values, root, None, most_knots)
    tried = [smooth(points, values, root, 10.0**power, most_knots).left_out for power in (-10, -7, -4, -2, 0)]
    assert bool((auto.left_out <= torch.stack(tried).amin(dim=0) * (1 + 1e-9)).all())


def test_a_plane_is_met_whatever_the_penalty_and_what_counts_nothing_leaves_no_trace():
    points, values = points_and_values()
    plane = plane_terms(points) @ torch.linspace(-1, 1, 18, dtype=torch.float64).reshape(9, 2)
    root = torch.ones(len(points), 1, dtype=torch.float64)
    assert_close(said(smooth(points, plane, root, 10.0, 12), points, points), plane, 1e-6)
    root[5], spoilt = 1e-7, values.clone()
    spoilt[5] = 40.0
    one, other = (said(smooth(points, each, root, 1e-3, 12), points, points) for each in (values, spoilt))
    assert_close(one, other, 1e-6)


def test_knots_lie_far_from_each_other():
    points = torch.tensor([[0.0], [0.1], [0.2], [5.0], [5.1], [9.0]])
    assert sorted(farthest(points, 3).tolist()) in ([0, 3, 5], [0, 4, 5])
    assert farthest(points, 9).tolist() == list(range(6))


def test_light_between_the_lamps_is_foretold_and_none_beyond_them_explodes():
    light, view = all_pairs(hemisphere(((0, 1), (20, 6), (40, 9), (60, 12))), hemisphere(((0, 1),)))
    wanted, above = all_pairs(hemisphere(((30, 5), (50, 5))), hemisphere(((0, 1),)))
    both = plausible_images(np.concatenate((light, wanted)), np.concatenate((view, above)), HEIGHT, WIDTH)
    material, seen = fitted(both[: len(light)], light, view, components=12)
    unseen = both[len(light) :]
    found = predict(material, Btf.from_tensors(unseen, wanted, above), torch.arange(len(wanted))).numpy()
    assert ((found - unseen) ** 2).sum() < 4e-3 * (unseen**2).sum()
    low, above = all_pairs(hemisphere(((75, 24), (89.9, 24))), hemisphere(((0, 1), (80, 4))))
    planes = [torch.from_numpy(one)[:, :, None, None] for one in (low, above)]
    with torch.no_grad():
        beyond = material.shade(*planes)
    assert bool(torch.isfinite(beyond).all()) and float(beyond.max()) < 1.5 * float(both.max())


def test_the_fit_says_what_it_cannot_do():
    images = plausible_images(LIGHT[:2], VIEW[:2], HEIGHT, WIDTH)
    with pytest.raises(FitError, match="components must not exceed what the data determines; it is 18 of 6. Use at most 6"):
        fitted(images, LIGHT[:2], VIEW[:2])
    with pytest.raises(RangeError, match="space must be 'linear' or 'srgb'|space must be one of"):
        fitted(images, LIGHT[:2], VIEW[:2], space="lab", components=1)
    with pytest.raises(RangeError, match="smoothing must be a number, or 'auto'"):
        fitted(images, LIGHT[:2], VIEW[:2], smoothing="none", components=1)
