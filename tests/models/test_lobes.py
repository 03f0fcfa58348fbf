"""Phong and Ashikhmin-Shirley lobes: by hand, against the oracle, their derivatives and symmetries."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.examples import LOBES as EXAMPLES
from tests.models.examples import assert_same, directions, per_image
from tests.reference.gradient import central
from tests.reference.lobes import LOBES as ORACLE

from torchmat.models.lobes import LOBES

every_lobe = pytest.mark.parametrize("name", LOBES)


def _parameters(name, dtype=torch.float64):
    return torch.tensor(EXAMPLES[name], dtype=dtype)


def _evaluate(name, parameters, light, view):
    planes = [torch.tensor(d, dtype=torch.float64)[:, None, None] for d in (light, view)]
    return LOBES[name].evaluate(torch.tensor(parameters, dtype=torch.float64), *planes)[:, 0, 0]


def test_every_lobe_has_an_oracle_and_consistent_tables():
    assert set(LOBES) == set(ORACLE) == set(EXAMPLES)
    for lobe in LOBES.values():
        assert len(lobe.names) == len(lobe.low) == len(lobe.high)
        for start in lobe.starts:
            assert all(low <= s <= high for low, s, high in zip(lobe.low, start, lobe.high, strict=True))


def test_phong_by_hand():
    # H = z: the lobe is 1 whatever the exponent; then half way down a cosine of 0.8, squared.
    assert_same(
        _evaluate("phong", (0.5, 0.25, 0, 0.1, 0.2, 0.3, math.log(50)), (0.6, 0, 0.8), (-0.6, 0, 0.8)),
        torch.tensor([0.5, 0.4, 0.3], dtype=torch.float64),
    )
    assert_same(
        _evaluate("phong", (0, 0, 0, 1, 2, 3, math.log(2)), (0.6, 0, 0.8), (0.6, 0, 0.8)),
        torch.tensor([0.64, 1.28, 1.92], dtype=torch.float64),
    )


def test_ashikhmin_shirley_by_hand():
    # Light = view = normal: h.k = 1, F = R_s, so rho = sqrt((n_u + 1)(n_v + 1)) / (8 pi) R_s.
    found = _evaluate("ashikhmin_shirley", (0.3, 0.3, 0.3, 0.1, 0.2, 0.4, math.log(8), math.log(3), 0.7), (0, 0, 1), (0, 0, 1))
    assert_same(found, torch.tensor([0.3 + 6 / 8 * r for r in (0.1, 0.2, 0.4)], dtype=torch.float64))
    # Light = view = (0.6, 0, 0.8): h is that too, cos phi = 1, so rho = sqrt(24) / (8 pi) 0.8^n_u / 0.8.
    for axis, exponent in ((0.0, 7), (math.pi / 2, 2)):
        found = _evaluate("ashikhmin_shirley", (0, 0, 0, 1, 1, 1, math.log(7), math.log(2), axis), (0.6, 0, 0.8), (0.6, 0, 0.8))
        expected = math.pi * 0.8 * math.sqrt(24) / (8 * math.pi) * 0.8**exponent / 0.8
        assert_same(found, torch.full((3,), expected, dtype=torch.float64))


@every_lobe
def test_values_match_the_oracle(name, dtype):
    light, view = directions(60, dtype, lowest=0.02), directions(60, dtype, seed=2, lowest=0.02)
    found = LOBES[name].evaluate(_parameters(name, dtype), per_image(light), per_image(view))[:, :, 0, 0]
    parameters = _parameters(name, dtype).tolist()
    rows = zip(light.tolist(), view.tolist(), strict=True)
    assert_same(found, torch.tensor([ORACLE[name](parameters, *row) for row in rows], dtype=dtype))


@every_lobe
def test_parameter_gradients_match_the_oracle(name):
    light, view = directions(8, lowest=0.2), directions(8, seed=2, lowest=0.2)
    parameters = _parameters(name).requires_grad_()
    for one, other in zip(light, view, strict=True):
        value = LOBES[name].evaluate(parameters, one[:, None, None], other[:, None, None]).sum()
        gradient = torch.autograd.grad(value, parameters)[0]
        rows = one.tolist(), other.tolist()
        expected = central(lambda p, rows=rows: sum(ORACLE[name](p, *rows)), EXAMPLES[name])
        assert_same(gradient, torch.from_numpy(expected), 1e-7)


@every_lobe
def test_one_set_of_parameters_per_image(name):
    light, view = per_image(directions(3)), per_image(directions(3, seed=2))
    parameters = torch.stack([_parameters(name) * share for share in (1.0, 0.9, 0.8)])
    found = LOBES[name].evaluate(parameters, light, view)
    for index in range(3):
        assert_same(found[index], LOBES[name].evaluate(parameters[index], light[index], view[index]))


@pytest.mark.parametrize("name", [name for name, lobe in LOBES.items() if lobe.jacobian])
def test_analytic_jacobian_equals_differentiation(name):
    lobe = LOBES[name]
    extra = torch.tensor([[0, 0, 1.0], [0.8, 0, 0.6], [1, 0, 0]], dtype=torch.float64)
    light = per_image(torch.cat((directions(7), extra)))
    view = per_image(torch.cat((directions(7, seed=2), extra * torch.tensor([-1.0, -1, 1], dtype=torch.float64))))
    for log_exponent in (math.log(1e-2), 0.0, math.log(30), math.log(1e5)):
        parameters = _parameters(name).clone()
        parameters[-1] = log_exponent
        found = lobe.jacobian(parameters, light, view)
        expected = torch.func.jacrev(lambda p: lobe.evaluate(p, light, view)[:, :, 0, 0])(parameters)
        assert found.shape == (10, 3, 7)
        assert_same(found, expected)


def test_phong_jacobian_takes_parameters_per_image():
    lobe = LOBES["phong"]
    light, view = per_image(directions(4)), per_image(directions(4, seed=2))
    parameters = torch.stack([_parameters("phong") * share for share in (1.0, 0.9, 0.8, 0.7)])
    found = lobe.jacobian(parameters, light, view)
    for index in range(4):
        assert_same(found[index], lobe.jacobian(parameters[index], light[index : index + 1], view[index : index + 1])[0])


@every_lobe
def test_gradcheck(name):
    light, view = (per_image(directions(3, seed=seed, lowest=0.2)).requires_grad_() for seed in (1, 2))
    assert torch.autograd.gradcheck(LOBES[name].evaluate, (_parameters(name).requires_grad_(), light, view))


def _turned(angle, rows):
    c, s = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float64)
    return rows @ turn.T


def test_phong_is_isotropic_and_ashikhmin_shirley_turns_with_its_axis():
    light, view = directions(9), directions(9, seed=2)
    turned = [per_image(_turned(0.8, rows)) for rows in (light, view)]
    straight = per_image(light), per_image(view)
    for name, shift in (("phong", 0.0), ("ashikhmin_shirley", 0.8)):
        parameters, other = _parameters(name), _parameters(name)
        other[-1] += shift
        assert_same(LOBES[name].evaluate(other, *turned), LOBES[name].evaluate(parameters, *straight))
    aniso = _parameters("ashikhmin_shirley")
    apart = LOBES["ashikhmin_shirley"].evaluate(aniso, *turned) - LOBES["ashikhmin_shirley"].evaluate(aniso, *straight)
    assert float(apart.abs().max()) > 0.01


def test_ashikhmin_shirley_is_reciprocal_and_equal_exponents_are_isotropic():
    parameters = _parameters("ashikhmin_shirley")
    light, view = per_image(directions(9)), per_image(directions(9, seed=2))
    one = LOBES["ashikhmin_shirley"].evaluate(parameters, light, view) / light[:, 2:3]
    other = LOBES["ashikhmin_shirley"].evaluate(parameters, view, light) / view[:, 2:3]
    assert_same(one, other)
    parameters[7] = parameters[6]
    turned = parameters.clone()
    turned[8] += 1.1
    assert_same(*(LOBES["ashikhmin_shirley"].evaluate(p, light, view) for p in (parameters, turned)))


@every_lobe
@pytest.mark.parametrize("exponent", [1e-2, 1.0, 1e3, 1e5])
def test_float32_loses_what_the_cosine_loses(name, exponent):
    """A cosine near 1 is rounded by 6e-8, which the exponent multiplies: the loss is about exponent * 1.2e-7."""
    light, view = directions(200, torch.float32).double(), directions(200, torch.float32, seed=2).double()
    view[:100] = light[:100] * torch.tensor([-1.0, -1, 1])  # half of them on the highlight's axis
    view[:50, 0] += 1e-3
    view = torch.nn.functional.normalize(view, dim=1).float().double()
    parameters = list(EXAMPLES[name])
    for place in (6, 7)[: len(parameters) - 6]:
        parameters[place] = math.log(exponent) if place == 6 or name != "phong" else parameters[place]
    parameters = torch.tensor(parameters).double()
    wide = LOBES[name].evaluate(parameters, per_image(light), per_image(view))
    narrow = LOBES[name].evaluate(parameters.float(), per_image(light.float()), per_image(view.float()))
    assert_same(narrow, wide.float(), max(2e-5, 2e-7 * exponent))
