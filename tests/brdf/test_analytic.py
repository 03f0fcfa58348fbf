"""The formulas: by hand, against the printed forms, derivatives, energy, symmetries, hard cases, bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.brdf.directions import HARD_PAIRS, graze, near_mirror, planes, random_directions, shade_and_differentiate
from tests.reference.brdf import REFLECTANCE, exact_value, value
from tests.reference.gradient import central
from tests.support import assert_close

from torchmat.brdf import ANALYTIC, AnalyticBrdf
from torchmat.brdf.albedo import directional_albedo
from torchmat.errors import RangeError, ShapeError

every = pytest.mark.parametrize("name", ANALYTIC)
EXAMPLES = {
    "lambert": (0.4, 0.3, 0.2),
    "phong": (0.4, 0.3, 0.2, 0.3, 0.2, 0.25, math.log(20.0)),
    "blinn": (0.4, 0.3, 0.2, 0.3, 0.2, 0.25, math.log(60.0)),
    "ashikhmin_shirley": (0.4, 0.3, 0.2, 0.08, 0.1, 0.05, math.log(40.0), math.log(10.0), 0.4),
    "ward": (0.4, 0.3, 0.2, 0.3, 0.2, 0.25, math.log(0.3), math.log(0.15), 0.4),
    "cook_torrance": (0.4, 0.3, 0.2, 0.08, 0.1, 0.05, math.log(0.25)),
    "ggx": (0.4, 0.3, 0.2, 0.08, 0.1, 0.05, math.log(0.25)),
    "ggx_anisotropic": (0.4, 0.3, 0.2, 0.08, 0.1, 0.05, math.log(0.3), math.log(0.15), 0.4),
}
ANISOTROPIC = {"ashikhmin_shirley", "ward", "ggx_anisotropic"}


def make(name, dtype=torch.float64, **numbers):
    return AnalyticBrdf(name, dtype=dtype, **numbers)


def example(name, dtype=torch.float64):
    return AnalyticBrdf.from_parameters(name, torch.tensor(EXAMPLES[name], dtype=dtype))


def at(brdf, light, view):
    light, view = (torch.tensor(d, dtype=torch.float64)[:, None, None] for d in (light, view))
    return brdf.shade(light, view)[:, 0, 0]


def exactly(values):
    return torch.tensor(values, dtype=torch.float64)


def test_every_formula_has_an_oracle_and_consistent_tables():
    assert set(ANALYTIC) == set(REFLECTANCE) == set(EXAMPLES)
    for name, lobe in ANALYTIC.items():
        assert len(lobe.names) == len(lobe.low) == len(lobe.high)
        assert lobe.starts and (lobe.axis is not None) == (name in ANISOTROPIC)
        for start in lobe.starts:
            assert all(low <= s <= high for low, s, high in zip(lobe.low, start, lobe.high, strict=True))


def test_values_along_the_normal_by_hand():
    pole = (0, 0, 1.0)
    assert_close(at(make("lambert", diffuse=(0.1, 0.2, 0.3)), (0.6, 0, 0.8), pole), exactly([0.08, 0.16, 0.24]))
    phong = make("phong", diffuse=0.5, specular=(0.1, 0.2, 0.4), exponent=8)
    assert_close(at(phong, pole, pole), exactly([0.5 + 5 * k for k in (0.1, 0.2, 0.4)]))  # (n + 2) / 2
    blinn = make("blinn", diffuse=0.5, specular=1, exponent=2)
    assert_close(at(blinn, pole, pole), exactly([0.5 + 4 * 6 / (8 * 2.5)] * 3))
    ward = make("ward", diffuse=0, specular=0.5, roughness_along=0.5, roughness_across=0.25)
    assert_close(at(ward, pole, pole), exactly([0.5 / (4 * 0.125)] * 3))
    for name in ("ggx", "cook_torrance", "ggx_anisotropic"):
        assert_close(at(make(name, diffuse=0, specular=0.5, roughness=0.5), pole, pole), exactly([0.5 / 4 / 0.25] * 3))


def test_phong_highlight_lies_in_the_mirror_direction_and_falls_with_its_power():
    phong = make("phong", diffuse=0, specular=1, exponent=3)
    assert_close(at(phong, (0.6, 0, 0.8), (-0.6, 0, 0.8)), exactly([2.5 * 0.8] * 3))
    assert_close(at(phong, (0, 0.6, 0.8), (-0.6, 0, 0.8)), exactly([2.5 * 0.8 * 0.64**3] * 3))
    assert_close(at(phong, (-0.8, 0, 0.6), (-0.8, 0, 0.6)), exactly([0.0] * 3))  # R.L = 0.36 - 0.64


@every
def test_values_match_the_printed_formulas(name, dtype):
    light = random_directions(80, 1)
    view = np.concatenate((near_mirror(light[:40], 2), random_directions(40, 3)))
    found = example(name, dtype).shade(planes(light, dtype), planes(view, dtype))[:, :, 0, 0]
    rows = zip(planes(light, dtype)[:, :, 0, 0].tolist(), planes(view, dtype)[:, :, 0, 0].tolist(), strict=True)
    expected = torch.tensor([value(name, EXAMPLES[name], *row) for row in rows], dtype=dtype)
    # The oracle's acos and tan lose half the digits of a float64 near the pole.
    assert_close(found, expected, 1e-10 if dtype == torch.float64 else None)


@every
def test_parameter_gradients_match_the_printed_formulas(name):
    light, view = random_directions(6, 4, 0.2), random_directions(6, 5, 0.2)
    parameters = torch.tensor(EXAMPLES[name], dtype=torch.float64, requires_grad=True)
    for one, other in zip(light, view, strict=True):
        found = AnalyticBrdf.from_parameters(name, parameters).shade(*planes(np.stack((one, other))))
        gradient = torch.autograd.grad(found.sum(), parameters)[0]
        expected = central(lambda p, pair=(one, other): sum(value(name, p, *pair)), EXAMPLES[name])
        assert_close(gradient, torch.from_numpy(expected), 1e-7)


@every
def test_gradcheck(name):
    light, view = (planes(random_directions(3, seed, 0.2)).requires_grad_() for seed in (6, 7))
    parameters = torch.tensor(EXAMPLES[name], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(ANALYTIC[name].evaluate, (parameters, light, view))


@every
def test_reciprocity(name):
    brdf = example(name)
    light, view = planes(random_directions(30, 8)), planes(random_directions(30, 9))
    assert brdf.reciprocal
    assert_close(brdf.reflectance(light, view), brdf.reflectance(view, light), 1e-12)


def turned(rows, angle):
    c, s = math.cos(angle), math.sin(angle)
    return rows @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


@every
def test_turning_about_the_normal(name):
    light, view = random_directions(20, 10), random_directions(20, 11)
    other = list(EXAMPLES[name])
    if name in ANISOTROPIC:
        other[8] += 0.8
    moved = AnalyticBrdf.from_parameters(name, torch.tensor(other, dtype=torch.float64))
    straight = example(name).shade(planes(light), planes(view))
    assert_close(moved.shade(planes(turned(light, 0.8)), planes(turned(view, 0.8))), straight, 1e-12)
    assert example(name).isotropic == (name not in ANISOTROPIC)
    if name in ANISOTROPIC:
        apart = example(name).shade(planes(turned(light, 0.8)), planes(turned(view, 0.8))) - straight
        assert float(apart.abs().max()) > 0.01


@pytest.mark.parametrize(
    "name, number",
    [("ashikhmin_shirley", {"exponent": 30}), ("ward", {"roughness": 0.3}), ("ggx_anisotropic", {"roughness": 0.3})],
)
def test_equal_widths_are_isotropic(name, number):
    one, other = make(name, **number, axis=0.0), make(name, **number, axis=1.1)
    assert one.isotropic
    light, view = planes(random_directions(9, 12)), planes(random_directions(9, 13))
    assert_close(one.shade(light, view), other.shade(light, view), 1e-12)


def test_the_anisotropic_ggx_with_equal_widths_is_the_isotropic_one():
    light, view = planes(random_directions(9, 14)), planes(random_directions(9, 15))
    found = make("ggx_anisotropic", roughness=0.2, axis=0.7).shade(light, view)
    assert_close(found, make("ggx", roughness=0.2).shade(light, view), 1e-12)


@pytest.mark.parametrize("name", [name for name in ANALYTIC if name != "lambert"])
def test_no_lobe_reflects_more_than_it_receives(name):
    by_exponent = "exponent" in ANALYTIC[name].names[6]
    label, widths = ("exponent", (1e-3, 1.0, 30.0)) if by_exponent else ("roughness", (0.05, 0.3, 1.0))
    for width in widths:
        brdf = make(name, diffuse=0.0, specular=1.0, **{label: width})
        for polar_deg in (0, 30, 60, 80, 89):
            albedo = directional_albedo(brdf, math.radians(polar_deg), steps=96)
            assert float(albedo.max()) <= 1 + 2e-3, (width, polar_deg)


@pytest.mark.parametrize("exponent", [1e-3, 1.0, 20.0, 1000.0])
@pytest.mark.parametrize("name", ["phong", "blinn"])
def test_the_specular_colour_is_the_reflectance_at_normal_incidence(name, exponent):
    albedo = directional_albedo(make(name, diffuse=0.0, specular=(0.2, 0.4, 0.8), exponent=exponent), 0.0, steps=96)
    assert_close(albedo, torch.tensor([0.2, 0.4, 0.8], dtype=torch.float64), 1e-3)


def test_the_phong_lobe_loses_the_cosine_when_narrow():
    # Nearly all of a narrow lobe lies at the mirror direction, whose cosine is the view's.
    albedo = directional_albedo(make("phong", diffuse=0.0, specular=1.0, exponent=2000), math.radians(60), steps=96)
    assert_close(albedo, torch.full((3,), 0.5, dtype=torch.float64), 1e-3)


@pytest.mark.parametrize("polar_deg", [0, 45, 75, 89])
def test_albedo_of_lambert(polar_deg):
    albedo = directional_albedo(make("lambert", diffuse=(0.2, 0.5, 1.0)), math.radians(polar_deg), 0.4, steps=128)
    assert_close(albedo, torch.tensor([0.2, 0.5, 1.0], dtype=torch.float64), 2e-4)


def hard_values_are_exact(name, parameters, dtype, digits):
    """Assert that values at hard pairs are those of 50 digits, and that their gradients are finite.

    Of the opposite pair a rounding error above the horizon only that it is dimmer: a half vector's cosine to the light
    counts as 1e-12 at least, and is 6e-17.
    """
    for pair, directions in HARD_PAIRS.items():
        leaf = torch.tensor(parameters, dtype=dtype, requires_grad=True)
        if (name, dtype, pair) == ("ward", torch.float32, "both_a_rounding_error_above_the_horizon") and parameters[6] < -6:
            continue  # the true derivative is 4e38: 2 / (4 roughness^2 cos^2), three times
        found = shade_and_differentiate(AnalyticBrdf.from_parameters(name, leaf), *directions, dtype, leaf)
        found, expected = found.double().numpy()[:, 0, 0], exact_value(name, leaf.tolist(), *directions)
        if pair == "both_a_rounding_error_above_the_horizon":
            assert (found <= expected * (1 + 1e-6)).all(), f"{pair}: {found} is brighter than {expected}"
        else:
            np.testing.assert_allclose(found, expected, rtol=digits, atol=1e-12, err_msg=pair)


@every
def test_case_1_values_at_hard_directions_are_exact_and_gradients_finite(name, dtype):
    # In float32 the light 1e-7 above the horizon is rounded by 1e-8, and powers of 20 to 60 by as many 1e-7: 2e-4.
    hard_values_are_exact(name, EXAMPLES[name], dtype, 3e-4 if dtype == torch.float32 else 2e-9)


@every
@pytest.mark.parametrize("end", ["low", "high"])
@pytest.mark.parametrize("colours", [0.0, 1.0])
def test_case_7_values_at_the_ends_of_the_parameters_are_exact_and_gradients_finite(name, end, colours, dtype):
    lobe = ANALYTIC[name]
    shape = [p if math.isfinite(p) else 3.0 for p in getattr(lobe, end)[6:]]
    # An exponent of 1e5 and a roughness of 1e-3 multiply the rounding of a cosine, 6e-8, by as much: measured 6e-3.
    hard_values_are_exact(name, [colours] * min(6, len(lobe.names)) + shape, dtype, 1e-2 if dtype == torch.float32 else 2e-9)


@every
def test_case_1_gradients_of_parameters_at_hard_directions_match_differences_of_50_digits(name):
    for pair, directions in HARD_PAIRS.items():
        if pair == "both_a_rounding_error_above_the_horizon":
            continue
        leaf = torch.tensor(EXAMPLES[name], dtype=torch.float64, requires_grad=True)
        shaded = AnalyticBrdf.from_parameters(name, leaf).shade(*planes(np.array(directions)))
        found = torch.autograd.grad(shaded.sum(), leaf)[0].numpy()
        expected = central(lambda p, given=directions: exact_value(name, p, *given).sum(), EXAMPLES[name], 1e-5)
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max(), err_msg=pair)


@every
def test_case_1_below_the_horizon_is_black_without_gradient(name):
    brdf = example(name)
    light = planes([(0.6, 0, -0.8), (0.6, 0, 0.8), (1, 0, 0)]).requires_grad_()
    view = planes([(0, 0.6, 0.8), (0, 0.6, -0.8), (0, 0, 1)]).requires_grad_()
    found = brdf.shade(light, view)
    assert not bool(found.any())
    found.sum().backward()
    assert not bool(light.grad.any())
    assert (view.grad is None) == (name == "lambert") and (view.grad is None or not bool(view.grad.any()))


@every
@pytest.mark.parametrize("azimuth", [0.0, 1.3, 3.0])
def test_case_2_value_is_continuous_on_the_way_into_the_horizon(name, azimuth):
    heights = [10.0**-k for k in range(2, 9)]
    light, view = (planes([graze(a, h) for h in heights]) for a in (azimuth, azimuth + 0.5))
    steps = example(name).shade(light, view).diff(dim=0).abs().amax(dim=(1, 2, 3))
    assert float(steps[-1]) < 1e-3
    assert float(steps[-1]) <= float(steps[0]) + 1e-12


@pytest.mark.parametrize("name", [name for name in ANALYTIC if name != "lambert"])
@pytest.mark.parametrize("end", ["low", "high"])
def test_float32_loses_what_the_rounding_of_a_cosine_costs(name, end):
    lobe = ANALYTIC[name]
    parameters = torch.tensor(EXAMPLES[name], dtype=torch.float64)
    parameters[6 : 8 if name in ANISOTROPIC else 7] = getattr(lobe, end)[6]
    light = random_directions(200, 16, 0.1)
    view = np.concatenate((near_mirror(light[:100], 17, 1e-3), random_directions(100, 18, 0.1)))
    light, view = planes(light, torch.float32), planes(view, torch.float32)
    narrow = AnalyticBrdf.from_parameters(name, parameters.float()).shade(light, view)
    wide = AnalyticBrdf.from_parameters(name, parameters).shade(light.double(), view.double())
    # An exponent of 1e5 times the rounding of a cosine, 6e-8, is 6e-3: measured 8e-3. Lobes by slopes lose nothing.
    assert_close(narrow, wide.float(), 2e-2 if end == "high" and "exponent" in lobe.names[6] else None)


def test_parameters_keep_the_graph_and_broadcast():
    parameters = torch.tensor([EXAMPLES["ggx"]] * 3, dtype=torch.float64) * torch.tensor([[1.0], [0.9], [0.8]])
    parameters.requires_grad_()
    light, view = planes(random_directions(3, 19)), planes(random_directions(3, 20))
    found = AnalyticBrdf.from_parameters("ggx", parameters).shade(light, view)
    for index in range(3):
        one = AnalyticBrdf.from_parameters("ggx", parameters[index])
        assert_close(found[index], one.shade(light[index], view[index]), 1e-12)
    found.sum().backward()
    assert bool((parameters.grad != 0).any(dim=1).all())


def test_keywords_are_natural_numbers_with_defaults(dtype):
    brdf = make("ggx", dtype, diffuse=(0.2, 0.1, 0.3), roughness=0.25)
    assert brdf.dtype == dtype and brdf.name == "ggx"
    assert_close(brdf.parameters, torch.tensor([0.2, 0.1, 0.3, 0.04, 0.04, 0.04, math.log(0.25)], dtype=dtype))
    aniso = make("ashikhmin_shirley", dtype, exponent=100, exponent_across=10, axis=0.5)
    assert_close(aniso.parameters[6:], torch.tensor([math.log(100), math.log(10), 0.5], dtype=dtype))


@pytest.mark.parametrize(
    "error, words, numbers",
    [
        (RangeError, "'roughness'", {"rougness": 0.3}),
        (RangeError, "roughness must lie in", {"roughness": 1.5}),
        (RangeError, "roughness must be positive", {"roughness": 0}),
        (RangeError, "diffuse_r must lie in", {"diffuse": -0.1}),
        (RangeError, "specular_r must lie in", {"specular": 1.5}),
        (RangeError, "finite", {"diffuse": math.nan}),
        (ShapeError, "diffuse must be one number or three", {"diffuse": (0.1, 0.2)}),
    ],
)
def test_bad_numbers_are_refused_by_name(error, words, numbers):
    with pytest.raises(error, match=words.replace("'", "")):
        make("ggx", **numbers)


def test_bad_names_and_parameters_are_refused():
    with pytest.raises(RangeError, match="Did you mean 'cook_torrance'"):
        make("cook_torance")
    with pytest.raises(ShapeError, match=r"\[\.\.\., 7\]"):
        AnalyticBrdf.from_parameters("ggx", torch.zeros(6))
    with pytest.raises(RangeError, match="float32"):
        make("ggx", torch.float32).shade(planes([(0, 0, 1.0)]), planes([(0, 0, 1.0)]))
    with pytest.raises(ShapeError, match="dimension -3"):
        make("ggx").shade(torch.zeros(3, dtype=torch.float64), planes([(0, 0, 1.0)]))


def test_numbers_of_any_kind_are_taken_and_others_named():
    given = AnalyticBrdf("ggx", specular=np.float32(0.25), roughness=torch.tensor(0.5), diffuse=(0.5, 0.25, 0.125))
    same = AnalyticBrdf("ggx", specular=0.25, roughness=0.5, diffuse=(0.5, 0.25, 0.125))
    assert torch.equal(given.parameters, same.parameters)
    with pytest.raises(RangeError, match="roughness must be numbers; it is 'x'"):
        AnalyticBrdf("ggx", roughness="x")
