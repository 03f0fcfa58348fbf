"""The bases by hand, against the written-out oracle, and by quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.models.examples import assert_same, directions, per_image
from tests.reference.bases import BASES as ORACLE

from torchmat import frames
from torchmat.models.bases import BASES


def _at(name, light, view=(0.0, 0.0, 1.0)):
    planes = [torch.tensor(d, dtype=torch.float64)[:, None, None] for d in (light, view)]
    return BASES[name].evaluate(*planes)[:, 0, 0]


def test_every_basis_has_an_oracle_and_names_its_terms():
    assert set(BASES) == set(ORACLE)
    for name, basis in BASES.items():
        assert len(basis.terms) == len(set(basis.terms)) == len(_at(name, (0.6, 0.0, 0.8)))


@pytest.mark.parametrize("name", BASES)
def test_values_match_the_oracle(name, dtype):
    light, view = directions(40, dtype, lowest=0.001), directions(40, dtype, seed=2, lowest=0.001)
    found = BASES[name].evaluate(per_image(light), per_image(view))[:, :, 0, 0]
    expected = [ORACLE[name](one, other) for one, other in zip(light.tolist(), view.tolist(), strict=True)]
    assert_same(found, torch.tensor(expected, dtype=dtype))


@pytest.mark.parametrize("name", BASES)
def test_planes_and_images_agree(name):
    light, view = directions(6).T.reshape(3, 2, 3), directions(6, seed=2).T.reshape(3, 2, 3)
    planes = BASES[name].evaluate(light, view)
    rows = BASES[name].evaluate(per_image(light.flatten(1).T), per_image(view.flatten(1).T))
    assert_same(planes.flatten(1).T[:, :, None, None], rows)


def test_ptm_terms_by_hand():
    expected = [0.36, 0.0064, 0.048, 0.6, 0.08, 1.0]
    assert_same(_at("polynomial", (0.6, 0.08, 0.796)), torch.tensor(expected, dtype=torch.float64))
    assert BASES["polynomial"].terms == ("lx_lx", "ly_ly", "lx_ly", "lx", "ly", "1")


def test_half_and_half_light_by_hand():
    light, view = (0.6, 0.0, 0.8), (-0.6, 0.0, 0.8)
    assert_same(_at("half", light, view), torch.tensor([0, 0, 1.0], dtype=torch.float64))
    assert_same(_at("half_light", light, view), torch.tensor([0, 0, 1, 0.6, 0, 0.8, 1], dtype=torch.float64))


def test_quadratic_is_all_fifteen_products():
    light, view = (2.0, 3.0, 0.0), (5.0, 7.0, 0.0)
    expected = [1, 2, 3, 5, 7, 4, 6, 10, 14, 9, 15, 21, 25, 35, 49]
    assert_same(_at("quadratic", light, view), torch.tensor(expected, dtype=torch.float64))
    terms = BASES["quadratic"].terms
    assert terms[:7] == ("1", "lx", "ly", "vx", "vy", "lx_lx", "lx_ly")
    number = {"lx": 2, "ly": 3, "vx": 5, "vy": 7}
    assert [math.prod(number[k] for k in term.split("_")) if term != "1" else 1 for term in terms] == expected


def test_hemispherical_harmonics_by_hand():
    # Gautron et al. 2004: H00 = 1 / sqrt(2 pi); H10 = sqrt(3 / (2 pi)) (2 cos - 1).
    found = _at("hsh4", (0.0, 0.6, 0.8))
    scale = math.sqrt(3 / (2 * math.pi))
    sine = math.sqrt(1 - 0.6**2)
    expected = [1 / math.sqrt(2 * math.pi), scale * sine, scale * 0.6, 0.0]
    assert_same(found, torch.tensor(expected, dtype=torch.float64))


def test_hemispherical_harmonics_are_orthonormal_over_the_hemisphere():
    nodes, weights = np.polynomial.legendre.leggauss(12)
    z, azimuth = (nodes + 1) / 2, np.arange(16) * 2 * np.pi / 16
    rows, shares = [], []
    for height, weight in zip(z, weights / 2, strict=True):
        for turn in azimuth:
            radius = math.sqrt(1 - height * height)
            rows.append((radius * math.cos(turn), radius * math.sin(turn), height))
            shares.append(weight * 2 * np.pi / 16)
    light = per_image(torch.tensor(rows, dtype=torch.float64))
    planes = BASES["hsh16"].evaluate(light, light)[:, :, 0, 0]
    gram = torch.einsum("n,ni,nj->ij", torch.tensor(shares, dtype=torch.float64), planes, planes)
    assert_same(gram, torch.eye(16, dtype=torch.float64))


def test_fewer_harmonics_are_the_first_of_more():
    light = (0.3, -0.5, math.sqrt(0.66))
    assert torch.equal(_at("hsh9", light), _at("hsh16", light)[:9])
    assert torch.equal(_at("hsh4", light), _at("hsh9", light)[:4])


def test_harmonics_have_their_true_gradient_at_the_pole():
    light = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None].requires_grad_()
    gradient = torch.autograd.grad(BASES["hsh4"].evaluate(light, light)[3].sum(), light)[0]
    # sqrt(3 / (2 pi)) 2 sqrt(z / (1 + z)) x, so sqrt(3 / pi) along x.
    assert_same(gradient[0, 0, 0], torch.tensor(math.sqrt(3 / math.pi), dtype=torch.float64))


@pytest.mark.parametrize("name", BASES)
def test_finite_at_the_ends_of_the_hemisphere(name, dtype):
    for light in ((0, 0, 1), (1, 0, 0), (1, 0, 1e-30), (0, 1, 1e-7), (-0.0, -0.0, 1)):
        leaves = [torch.tensor(d, dtype=dtype)[:, None, None].requires_grad_() for d in (light, (0, 0, 1))]
        value = BASES[name].evaluate(*leaves)
        value.sum().backward()
        assert bool(torch.isfinite(value).all())
        assert all(leaf.grad is None or bool(torch.isfinite(leaf.grad).all()) for leaf in leaves)


@pytest.mark.parametrize("name", BASES)
def test_gradcheck(name):
    light, view = (per_image(directions(3, seed=seed, lowest=0.2)).requires_grad_() for seed in (1, 2))
    assert torch.autograd.gradcheck(BASES[name].evaluate, (light, view))


def test_half_terms_are_the_half_vector():
    light, view = per_image(directions(5)), per_image(directions(5, seed=2))
    assert torch.equal(BASES["half"].evaluate(light, view), frames.half_vector(light, view))
