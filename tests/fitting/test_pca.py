"""Factorisations against NumPy's SVD, and subspaces known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.support import all_pairs, assert_close, hemisphere

import torchmat as tm
from torchmat import Btf, FitError, RangeError
from torchmat.fitting import predict

HEIGHT, WIDTH = 6, 5
LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (30, 4), (60, 6))), hemisphere(((0, 1), (45, 4))))
COUNT = len(LIGHT)
# At a measured direction its neighbours still weigh about 1e-7 each.
SEEN = 1e-5


def decaying(rank=30, seed=0):
    """Return positive images [n, 3, H, W] whose singular values fall by 0.6 each."""
    random = np.random.default_rng(seed)
    left = np.linalg.qr(random.normal(size=(COUNT, rank)))[0]
    right = np.linalg.qr(random.normal(size=(3 * HEIGHT * WIDTH, rank)))[0]
    matrix = (left * 0.6 ** np.arange(rank)) @ right.T
    return (matrix - matrix.min() + 0.1).reshape(COUNT, 3, HEIGHT, WIDTH)


def fitted(images, model, weight=None, dtype=torch.float32, **options):
    kind = np.float32 if dtype == torch.float32 else np.float64
    btf = Btf.from_tensors(images.astype(kind), LIGHT, VIEW, weight)
    result = tm.fit(btf, model, holdout=0, dtype=dtype, measure=False, **options)
    return result.material, predict(result.material, btf, torch.arange(COUNT))


def test_full_rank_reproduces_what_was_seen(dtype):
    images = decaying()
    _, predicted = fitted(images, "pca", components=COUNT, dtype=dtype)
    assert_close(predicted, torch.from_numpy(images), SEEN)


@pytest.mark.parametrize("components", [1, 3, 8])
def test_truncation_costs_what_numpy_says(components):
    images = decaying()
    matrix = images.reshape(COUNT, -1)
    best = float((np.linalg.svd(matrix, compute_uv=False)[components:] ** 2).sum())
    _, predicted = fitted(images, "pca", components=components, dtype=torch.float64)
    error = float(((predicted.numpy().reshape(COUNT, -1) - matrix) ** 2).sum())
    # Eckart-Young below; above, one power step with ten extra directions: measured 1.000.
    assert best * 0.999 <= error <= best * 1.01 + 1e-9


def test_components_are_orthogonal_and_ordered():
    material, _ = fitted(decaying(), "pca", components=4, dtype=torch.float64)
    images = material.maps["component"].detach().unflatten(0, (4, 3)).flatten(1)
    weights = material.maps["weight"][:, 0].detach()
    for rows in (images, weights):
        gram = rows @ rows.T
        scale = gram.diagonal().sqrt()
        assert float((gram / scale[:, None] / scale - torch.eye(4)).abs().max()) < 1e-9
    energy = images.norm(dim=1) * weights.norm(dim=1)
    assert bool((energy.diff() < 0).all())


def test_dark_texels_keep_their_digits_beside_a_highlight():
    images = decaying() * 1e-6
    images[3, :, 2, 2] = 1e4
    material, _ = fitted(images, "pca", components=COUNT)
    product = torch.einsum("kn,kchw->nchw", material.maps["weight"][:, 0], material.maps["component"].unflatten(0, (-1, 3)))
    dark = np.ones((HEIGHT, WIDTH), dtype=bool)
    dark[2, 2] = False
    found = product.detach().flatten(2)[..., dark.reshape(-1)]
    assert_close(found, torch.from_numpy(images[..., dark]), 1e-4)


def test_masked_samples_take_their_texels_mean():
    images = decaying()
    weight = np.ones((COUNT, HEIGHT, WIDTH))
    weight[5, 1, 1] = weight[9, 4, 2] = 0
    hidden = images.copy()
    hidden[5, :, 1, 1], hidden[9, :, 4, 2] = 1e6, np.nan
    material, predicted = fitted(hidden, "pca", weight, components=COUNT)
    expected = images.copy()
    for sample, row, column in ((5, 1, 1), (9, 4, 2)):
        others = np.arange(COUNT) != sample
        expected[sample, :, row, column] = images[others, :, row, column].mean(axis=0)
    assert_close(predicted, torch.from_numpy(expected), SEEN)


def test_clipped_highlights_stay():
    from torchmat.btf.btf import CLIPPED, summarise
    from torchmat.btf.decode import Decoder

    images = decaying().astype(np.float32)
    images /= images.max()
    images[7, :, 2, 3] = 1
    flags = np.zeros((COUNT, HEIGHT, WIDTH), dtype=np.uint8)
    flags[7, 2, 3] = CLIPPED
    light, view = torch.from_numpy(LIGHT).float(), torch.from_numpy(VIEW).float()
    btf = Btf(summarise(images, flags), light, view, Decoder(images.dtype, "linear", 1.0))
    material = tm.fit(btf, "pca", holdout=0, components=COUNT, measure=False).material
    assert_close(predict(material, btf, torch.tensor([7]))[0, :, 2, 3], torch.ones(3), SEEN)


def two_subspaces():
    """Return images whose texels lie in one of two known planes of reflectance, and which."""
    random = np.random.default_rng(4)
    label = random.random((HEIGHT, WIDTH)) > 0.5
    texels = np.zeros((HEIGHT, WIDTH, 3 * COUNT))
    for which in (False, True):
        mean, basis = random.uniform(1, 2, 3 * COUNT), random.normal(size=(2, 3 * COUNT)) * 0.2
        number = int((label == which).sum())
        texels[label == which] = mean + random.normal(size=(number, 2)) * 0.5 @ basis
    return texels.reshape(HEIGHT, WIDTH, COUNT, 3).transpose(2, 3, 0, 1), label


def test_local_pca_finds_two_known_subspaces():
    images, label = two_subspaces()
    material, predicted = fitted(images, "local_pca", clusters=2, components=2)
    cluster = material.maps["cluster"][0].detach().bool().numpy()
    assert (cluster == label).all() or (cluster != label).all()
    assert_close(predicted, torch.from_numpy(images), 1e-4)


def test_one_cluster_is_a_centred_pca():
    images = decaying()
    _, predicted = fitted(images, "local_pca", clusters=1, components=3, dtype=torch.float64)
    rows = images.transpose(2, 3, 0, 1).reshape(HEIGHT * WIDTH, -1)
    best = float((np.linalg.svd(rows - rows.mean(axis=0), compute_uv=False)[3:] ** 2).sum())
    error = float(((predicted.numpy() - images) ** 2).sum())
    assert best * 0.999 <= error <= best * 1.01


def test_as_many_clusters_as_texels_reproduce_them():
    images = decaying()
    _, predicted = fitted(images, "local_pca", clusters=HEIGHT * WIDTH, components=1)
    assert_close(predicted, torch.from_numpy(images), 1e-4)


@pytest.mark.parametrize(("model", "options"), [
    ("pca", {"components": COUNT + 1}), ("local_pca", {"clusters": HEIGHT * WIDTH + 1}),
    ("local_pca", {"components": HEIGHT * WIDTH + 1}),
])
def test_more_than_the_data_determine_is_refused(model, options):
    with pytest.raises(FitError, match=r"must not exceed.*Use at most \d+"):
        fitted(decaying(), model, **options)


@pytest.mark.parametrize(("model", "options"), [
    ("pca", {"components": 0}), ("pca", {"components": -3}), ("pca", {"components": 2.0}), ("pca", {"components": "8"}),
    ("local_pca", {"clusters": 0}), ("local_pca", {"components": True}),
])
def test_options_that_are_no_count_are_refused(model, options):
    with pytest.raises(RangeError, match=next(iter(options))):
        fitted(decaying(), model, **options)
