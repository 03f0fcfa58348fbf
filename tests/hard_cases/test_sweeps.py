"""The short form of the sweeps: hard cases 1, 2, 4 to 7 and 13 over all floats, and what they found."""

from __future__ import annotations

import math
from types import ModuleType

import mpmath
import numpy as np
import pytest
import torch
from tests.hard_cases import sweep_models, sweeps
from tests.hard_cases.floats import from_ordinals, neighbours, ordinals, sweep
from tests.hard_cases.sweep_entries import ENTRIES
from tests.models.examples import CASES
from tests.support import assert_close

from torchmat import colour, frames, safe
from torchmat.brdf.analytic import ANALYTIC
from torchmat.geometry.rays import ray_slope
from torchmat.models.shading_map import layer_weights, sector_weights


def _failures(rows):
    return [
        f"{row['case']}, {row['component']}: {row['figure']} digits, {row['note']}" for row in rows if not row["passed"]
    ]


def test_every_public_function_has_an_entry():
    assert sorted(ENTRIES) == sorted(sweeps.all_functions())


def test_a_new_public_function_is_found():
    module = ModuleType("new")

    def added(x):
        return x

    added.__module__ = "new"
    module.added, module.other, module._hidden = added, math.sin, added
    assert sweeps.public_functions(module) == ["added"]


@pytest.mark.parametrize("name", [name for name, entry in ENTRIES.items() if not isinstance(entry, str)])
def test_values_and_gradients_over_all_floats(name):
    assert _failures(sweeps.run(12, 1, [name])) == []


@pytest.mark.parametrize("name, options", CASES)
def test_models_over_hard_directions_and_all_floats_of_their_maps(name, options, request):
    label = request.node.callspec.id
    rows = []
    for dtype in sweep_models.DTYPES:
        rows += sweep_models.sweep_directions(name, options, label, dtype, 24, 1)
        rows += sweep_models.sweep_maps(name, options, label, dtype, 24, 1)
    assert _failures(rows) == []


def test_floats_are_counted_in_their_order(dtype):
    values = sweep(dtype, 200, np.random.default_rng(0)).numpy()
    assert np.array_equal(from_ordinals(ordinals(values), dtype), values)
    assert ordinals(np.array([0.0, -0.0], dtype=values.dtype)).tolist() == [0, 0]
    below, here, above = (ordinals(np.array([x], dtype=values.dtype))[0] for x in neighbours(1.0, dtype))
    assert (here - below, above - here) == (1, 1)


def test_a_sweep_holds_the_ends_of_all_magnitudes(dtype):
    info, values = torch.finfo(dtype), sweep(dtype, 50, np.random.default_rng(0), kinks=(0.5,))
    smallest = float(from_ordinals(np.array([1]), dtype)[0])
    for wanted in (0.0, smallest, -smallest, info.tiny, info.max, -info.max, *neighbours(0.5, dtype)):
        assert wanted in values.tolist()


@pytest.mark.parametrize(
    "wrong, case",
    [
        (lambda x: torch.sqrt(x.clamp(min=0)), "gradients"),
        (lambda x: safe.sqrt(x) * (1 + 1e-4), "values"),
        (lambda x: torch.where(x > 0, safe.sqrt(x), math.nan), "values"),
        (lambda x: safe.sqrt(x.detach()) + 0 * x, "gradients"),
    ],
)
def test_a_wrong_function_fails_the_sweep(wrong, case):
    entry = ENTRIES["safe.sqrt"]._replace(call=lambda x: wrong(x)[None])
    failed = [row["case"] for row in sweeps.sweep_entry("wrong", entry, torch.float32, 12, 0) if not row["passed"]]
    assert case in failed


def test_a_function_that_is_not_monotone_fails_the_sweep():
    entry = ENTRIES["safe.sqrt"]._replace(check=lambda columns, outputs: "not monotone")
    assert not sweeps.sweep_entry("wrong", entry, torch.float64, 4, 0)[0]["passed"]


def test_a_model_that_is_wrong_fails_the_sweep(monkeypatch):
    from torchmat.models import Texture

    monkeypatch.setattr(
        Texture, "value", lambda self, light, view: self.maps["albedo"] * torch.sqrt(light[..., 2:3, :, :] - 1e-4)
    )
    rows = [
        row
        for dtype in sweep_models.DTYPES
        for row in sweep_models.sweep_directions("texture", {}, "texture", dtype, 20, 0)
    ]
    assert len(_failures(rows)) >= 2


def test_a_ray_at_the_very_horizon_is_as_flat_as_rays_get(dtype):
    # The slope's square overflowed, and the slope became 0: that of a ray straight up.
    steepest = ray_slope(torch.tensor([1.0, 0.0, 1e-3], dtype=dtype)[:, None, None], 1, 1)
    for height in (0.0, torch.finfo(dtype).tiny, 1e-30):
        direction = torch.tensor([1.0, 0.0, height], dtype=dtype)[:, None, None].requires_grad_()
        slope = ray_slope(direction, 1, 1)
        assert_close(slope, steepest)
        slope.sum().backward()
        assert bool(torch.isfinite(direction.grad).all())


def test_the_polar_angle_near_the_pole_keeps_its_digits_and_its_gradient(dtype):
    # x^2 + y^2 underflowed: the angle was 0 with gradient 0.
    direction = torch.tensor([3e-25, 4e-25, 1.0], dtype=dtype, requires_grad=True)
    polar, _ = frames.to_polar(direction)
    polar.backward()
    assert float(polar.detach()) == pytest.approx(5e-25, rel=1e-6)
    assert_close(direction.grad[:2], torch.tensor([0.6, 0.8], dtype=dtype))


def test_an_azimuth_that_rounds_to_a_full_turn_keeps_its_gradient():
    direction = torch.tensor([1.0, -1e-9, 0.5], requires_grad=True)
    _, azimuth = frames.to_polar(direction)
    azimuth.backward()
    assert float(azimuth.detach()) == 0 and float(direction.grad[1]) == pytest.approx(1)


@pytest.mark.parametrize("first, second", [
    ((50.0, 0.0, 0.0), (50.0, 0.0, 0.0)), ((50.0, 3.0, 4.0), (50.0, 3.0, 4.0)), ((50.0, 0.0, 0.0), (40.0, 10.0, -5.0)),
    ((50.0, 1e-30, 0.0), (50.0, 0.0, 1e-30)), ((50.0, 1e6, -1e6), (50.0, 1.0, 1.0)),
])
def test_the_colour_difference_is_finite_with_its_gradient(first, second, dtype):
    # At grey and between equal colours the gradient was NaN; beyond a chroma of 3e5 the value was.
    leaves = [torch.tensor(c, dtype=dtype)[:, None, None].requires_grad_() for c in (first, second)]
    value = colour.ciede2000(*leaves)
    value.sum().backward()
    assert bool(torch.isfinite(value).all())
    assert all(bool(torch.isfinite(leaf.grad).all()) for leaf in leaves)


def test_the_half_vector_of_nearly_opposite_directions_is_that_of_double_precision():
    # 2 + 2 L.V lost all digits in float32, and the specular map was looked up by a vector of any length.
    light = torch.tensor([1.0, 0.0, 1e-4])[:, None, None]
    view = torch.tensor([-1.0, 1.2e-4, 1e-4])[:, None, None]
    single, double = sweep_models.twin(
        "distribution", {"lobes": 1, "parts": ["specular_mask", "fresnel"]}, torch.float32
    )
    assert_close(single.shade(light, view), double.shade(light.double(), view.double()).float(), 1e-5)


@pytest.mark.parametrize("name", ANALYTIC)
def test_formulas_stay_finite_where_the_half_vector_nearly_vanishes(name):
    low, high = torch.finfo(torch.float32).tiny, 1.4e-45
    parameters = torch.tensor([ANALYTIC[name].starts[0]])[0]
    light = torch.tensor([-0.6, 0.8, low])[:, None, None].requires_grad_()
    view = torch.tensor([0.6, -0.8, high])[:, None, None].requires_grad_()
    value = ANALYTIC[name].evaluate(parameters, light, view)
    value.sum().backward()
    for tensor in (value, light.grad, *(() if view.grad is None else (view.grad,))):
        assert bool(torch.isfinite(tensor).all())


def test_weights_at_a_sector_or_a_layer_have_the_gradient_of_one_side(dtype):
    # Absolute values and clamps gave the sum of both sides' gradients at the sectors themselves.
    light = torch.tensor([-0.6, 0.0, 0.8], dtype=dtype)[:, None, None].requires_grad_()
    weights = sector_weights(light, 4)[:, 0, 0]
    slopes = torch.stack([torch.autograd.grad(w, light, retain_graph=True)[0][1, 0, 0] for w in weights])
    per_turn = 0.6 * 4 / (2 * math.pi) / -0.6  # the share's slope by y: y turns the azimuth back at -x
    assert_close(slopes, torch.tensor([0, 0, -per_turn, per_turn], dtype=dtype))
    place = torch.tensor([1.0], dtype=dtype)[:, None, None].requires_grad_()
    weights = layer_weights(place, 4)[:, 0, 0]
    slopes = torch.stack([torch.autograd.grad(w, place, retain_graph=True)[0].reshape(()) for w in weights])
    assert slopes.tolist() == [0, -1, 1, 0]


def test_differences_are_found_with_enough_digits():
    with mpmath.workdps(sweeps.digits_for([1.0, 1e-300], torch.finfo(torch.float64))):
        point = [mpmath.mpf(1), mpmath.mpf(1e-300)]
        exact = lambda info, x, y: (x * x + y * y,)  # noqa: E731
        left, central, right = sweeps.one_sided(exact, torch.finfo(torch.float64), point, 1, exact(None, *point))[0]
        for found in (left, central, right):
            assert abs(found / mpmath.mpf(2e-300) - 1) < 1e-12
