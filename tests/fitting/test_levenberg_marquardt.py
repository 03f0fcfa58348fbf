"""Levenberg-Marquardt: minima known by hand, optimality at the end, and what stops it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.support import assert_close

from torchmat import FitError, RangeError
from torchmat.solvers.levenberg_marquardt import (
    CONVERGED, NOT_FINITE, OPEN, STEP_LIMIT, forward_jacobian, levenberg_marquardt,
)

TIME = torch.linspace(0, 4, 25, dtype=torch.float64)


def rosenbrock(p):
    return torch.stack((10 * (p[:, 1] - p[:, 0] ** 2), 1 - p[:, 0]), dim=1)


def rosenbrock_jacobian(p):
    one = torch.ones_like(p[:, 0])
    rows = (torch.stack((-20 * p[:, 0], 10 * one), 1), torch.stack((-one, 0 * one), 1))
    return torch.stack(rows, dim=1)


def decay(amplitude, rate):
    data = amplitude * np.exp(-rate * TIME.numpy())
    return lambda p: p[:, :1] * torch.exp(-p[:, 1:2] * TIME.to(p)) - torch.as_tensor(data).to(p)


def gradient(residual, parameters):
    return torch.einsum("brp,br->bp", forward_jacobian(residual)(parameters), residual(parameters))


@pytest.mark.parametrize("start", [(-1.2, 1.0), (1.0, 1.0), (3.0, -40.0), (-1e3, 1e3)])
def test_rosenbrock_ends_at_one_one(start):
    solution = levenberg_marquardt(rosenbrock, torch.tensor([start], dtype=torch.float64), max_steps=1000)
    assert solution.reasons == (CONVERGED,)
    assert_close(solution.parameters, torch.ones(1, 2, dtype=torch.float64), 1e-8)
    assert float(gradient(rosenbrock, solution.parameters).abs().max()) < 1e-8


def test_a_start_that_is_the_answer_stays_to_the_bit():
    solution = levenberg_marquardt(rosenbrock, torch.ones(1, 2, dtype=torch.float64))
    assert solution.reasons == (CONVERGED,)
    assert torch.equal(solution.parameters, torch.ones(1, 2, dtype=torch.float64))
    assert len(solution.history) == 2


@pytest.mark.parametrize("start", [(1.0, 1.0), (30.0, 0.01), (1e-3, 5.0)])
def test_exponential_decay_is_recovered(start):
    residual = decay(2.5, 0.7)
    solution = levenberg_marquardt(residual, torch.tensor([start], dtype=torch.float64))
    assert solution.reasons == (CONVERGED,)
    assert_close(solution.parameters, torch.tensor([[2.5, 0.7]], dtype=torch.float64), 1e-8)


def test_a_minimum_that_is_not_zero_has_gradient_zero():
    noise = torch.from_numpy(np.random.default_rng(0).normal(0, 0.1, len(TIME)))
    clean = decay(2.5, 0.7)
    solution = levenberg_marquardt(lambda p: clean(p) + noise, torch.tensor([[1.0, 1.0]], dtype=torch.float64))
    assert solution.reasons == (CONVERGED,)
    assert float(solution.cost) > 0.01
    assert float(gradient(lambda p: clean(p) + noise, solution.parameters).abs().max()) < 1e-4 * float(solution.cost)


def test_a_flat_objective_stops_at_once_where_it_started():
    start = torch.tensor([[0.3, -2.0]], dtype=torch.float64)
    solution = levenberg_marquardt(lambda p: 0 * p + 3.0, start)
    assert solution.reasons == (CONVERGED,) and torch.equal(solution.parameters, start) and len(solution.history) == 2


def linear(scales, seed=1):
    random = np.random.default_rng(seed)
    matrix = torch.from_numpy(random.normal(size=(30, 4)) * np.array(scales))
    truth = torch.from_numpy(random.normal(size=4) / np.array(scales))
    return matrix, truth, lambda p: (p - truth.to(p)) @ matrix.T.to(p)


def test_columns_from_1e_minus_6_to_1e6():
    scales = (1e-6, 1e-2, 1e3, 1e6)
    _, truth, residual = linear(scales)
    solution = levenberg_marquardt(residual, torch.zeros(1, 4, dtype=torch.float64))
    assert solution.reasons == (CONVERGED,)
    scale = torch.tensor(scales, dtype=torch.float64)
    assert_close(solution.parameters[0] * scale, truth * scale, 1e-8)


def test_units_do_not_change_the_path():
    _, _, plain = linear((1.0, 1.0, 1.0, 1.0))
    scale = torch.tensor([1e-6, 1e-2, 1e3, 1e6], dtype=torch.float64)
    first = levenberg_marquardt(plain, torch.zeros(1, 4, dtype=torch.float64))
    second = levenberg_marquardt(lambda p: plain(p * scale), torch.zeros(1, 4, dtype=torch.float64))
    assert len(first.history) == len(second.history)
    assert_close(second.parameters * scale, first.parameters, 1e-9)


def test_rank_deficient_columns_reach_zero_residual():
    matrix, truth, _ = linear((1.0,) * 4)
    matrix[:, 3] = matrix[:, 0] + matrix[:, 1]
    solution = levenberg_marquardt(lambda p: (p - truth) @ matrix.T, torch.zeros(1, 4, dtype=torch.float64))
    assert solution.reasons == (CONVERGED,)
    assert float(solution.cost) < 1e-16
    assert bool(torch.isfinite(solution.parameters).all())


def test_bounds_hold_and_satisfy_kkt():
    low, high = torch.tensor([-5.0, -5.0], dtype=torch.float64), torch.tensor([0.5, 5.0], dtype=torch.float64)
    solution = levenberg_marquardt(rosenbrock, torch.tensor([[-1.2, 1.0]], dtype=torch.float64), low, high)
    # With x held at 0.5 the best y is x^2.
    assert_close(solution.parameters, torch.tensor([[0.5, 0.25]], dtype=torch.float64), 1e-7)
    slope = gradient(rosenbrock, solution.parameters)[0]
    assert float(slope[0]) < -0.1 and abs(float(slope[1])) < 1e-6


def test_inactive_bounds_change_nothing():
    start = torch.tensor([[-1.2, 1.0]], dtype=torch.float64)
    bound = torch.full((2,), 100.0, dtype=torch.float64)
    free, bounded = levenberg_marquardt(rosenbrock, start), levenberg_marquardt(rosenbrock, start, -bound, bound)
    assert torch.equal(free.parameters, bounded.parameters)


def test_a_start_outside_and_a_bound_of_no_width():
    point = torch.tensor([0.2, 7.0], dtype=torch.float64)
    low, high = point.clone(), torch.tensor([0.2, 8.0], dtype=torch.float64)
    solution = levenberg_marquardt(rosenbrock, torch.tensor([[9.0, 9.0]], dtype=torch.float64), low, high)
    assert torch.equal(solution.parameters[0], point)  # y wants 0.04 and is held at 7


def test_a_batch_equals_one_by_one():
    targets = ((2.5, 0.7), (0.3, 2.0), (9.0, 0.05))
    data = torch.stack([a * torch.exp(-r * TIME) for a, r in targets])

    def batch(p):
        return p[:, :1] * torch.exp(-p[:, 1:2] * TIME) - data

    start = torch.tensor([[1.0, 1.0]], dtype=torch.float64).repeat(3, 1)
    together = levenberg_marquardt(batch, start)
    for number in range(3):
        alone = levenberg_marquardt(
            lambda p, n=number: p[:, :1] * torch.exp(-p[:, 1:2] * TIME) - data[n : n + 1], start[:1]
        )
        assert_close(together.parameters[number], alone.parameters[0], 1e-9)
        assert together.reasons[number] == alone.reasons[0] == CONVERGED
    assert_close(together.parameters, torch.tensor(targets, dtype=torch.float64), 1e-8)


def test_a_given_jacobian_equals_the_differentiated_one():
    point = torch.tensor([[0.3, -0.4], [2.0, 5.0]], dtype=torch.float64)
    assert_close(forward_jacobian(rosenbrock)(point), rosenbrock_jacobian(point))
    start = torch.tensor([[-1.2, 1.0]], dtype=torch.float64)
    found = levenberg_marquardt(rosenbrock, start, jacobian=rosenbrock_jacobian)
    assert_close(found.parameters, levenberg_marquardt(rosenbrock, start).parameters, 1e-9)


def test_a_start_with_nan_or_without_finite_residuals_is_refused():
    with pytest.raises(RangeError, match="start must be finite"):
        levenberg_marquardt(rosenbrock, torch.tensor([[float("nan"), 0.0]], dtype=torch.float64))
    with pytest.raises(FitError, match="finite residuals"):
        levenberg_marquardt(lambda p: torch.log(p), torch.tensor([[-1.0]], dtype=torch.float64))


def test_steps_into_nan_are_refused_and_the_best_is_kept():
    # log is NaN below 0, where the first full step leads; the minimum at 1e-3 must still be found.
    def residual(p):
        return torch.log(p) - np.log(1e-3)

    solution = levenberg_marquardt(residual, torch.tensor([[50.0]], dtype=torch.float64))
    assert solution.reasons == (CONVERGED,)
    assert_close(solution.parameters, torch.tensor([[1e-3]], dtype=torch.float64), 1e-8)


def test_nothing_finite_but_the_start_is_named_so():
    start = torch.tensor([[1.0]], dtype=torch.float64)

    def residual(p):
        return torch.where(p == 1.0, p, p * float("nan"))

    solution = levenberg_marquardt(residual, start)
    assert solution.reasons == (NOT_FINITE,)
    assert torch.equal(solution.parameters, start)


def test_an_infinite_jacobian_is_named_and_spares_the_rest_of_the_batch():
    def residual(p):
        return torch.sqrt(p) - 2  # its slope at 0 is infinite

    solution = levenberg_marquardt(residual, torch.tensor([[0.0], [1.0]], dtype=torch.float64))
    assert solution.reasons == (NOT_FINITE, CONVERGED)
    assert_close(solution.parameters, torch.tensor([[0.0], [4.0]], dtype=torch.float64), 1e-9)


def test_the_step_limit_is_named():
    start = torch.tensor([[-1.2, 1.0]], dtype=torch.float64)
    solution = levenberg_marquardt(rosenbrock, start, max_steps=3)
    assert solution.reasons == (STEP_LIMIT,) and len(solution.history) == 4
    assert bool((solution.history.diff(dim=0) <= 0).all())
    assert torch.equal(levenberg_marquardt(rosenbrock, start, max_steps=0).parameters, start)


def test_float32_keeps_five_digits():
    # float64 reaches 1e-8 (above); measured in float32: 2e-7 here. The bound leaves a factor of 50 for other machines.
    start = torch.tensor([[1.0, 1.0]])
    solution = levenberg_marquardt(decay(2.5, 0.7), start)
    assert solution.reasons == (CONVERGED,)
    assert_close(solution.parameters, torch.tensor([[2.5, 0.7]]), 1e-5)


def weak_direction(strength, dtype):
    """Return the residual of an exponential of two parameters, the second of which hardly matters, and its start."""
    random = np.random.default_rng(0)
    matrix = np.linalg.qr(random.normal(size=(24, 2)))[0] * (1, strength) @ np.array([[0.8, 0.6], [-0.6, 0.8]])
    data = torch.exp(torch.from_numpy(matrix @ (0.5, 1.0))).to(dtype)
    rows = torch.from_numpy(matrix).to(dtype)
    return (lambda p: torch.exp(p @ rows.T) - data), torch.zeros(1, 2, dtype=dtype)


def test_what_damping_hides_is_not_called_converged():
    residual, start = weak_direction(1e-4, torch.float32)
    solution = levenberg_marquardt(residual, start, max_steps=500)
    assert solution.reasons == (OPEN,)
    # It is as said: the step without damping, in double precision, makes the misfit a hundred times smaller.
    double, _ = weak_direction(1e-4, torch.float64)
    at = solution.parameters.double()
    step = torch.linalg.lstsq(forward_jacobian(double)(at)[0], -double(at)[0, :, None]).solution[:, 0]
    assert float(double(at + step).norm()) < 0.01 * float(double(at).norm())


@pytest.mark.parametrize(("strength", "dtype"), [(1e-1, torch.float32), (1e-4, torch.float64), (1e-9, torch.float32)])
def test_what_is_found_or_lost_in_rounding_is_converged(strength, dtype):
    residual, start = weak_direction(strength, dtype)
    assert levenberg_marquardt(residual, start, max_steps=500).reasons == (CONVERGED,)


def test_a_batch_names_open_directions_of_its_own_problems():
    rows = [weak_direction(strength, torch.float32)[0] for strength in (1e-1, 1e-4)]

    def batch(p):
        return torch.cat([residual(p[number : number + 1]) for number, residual in enumerate(rows)])

    def by_rows(p):
        return torch.stack([forward_jacobian(one)(p[number : number + 1])[0] for number, one in enumerate(rows)])

    solution = levenberg_marquardt(batch, torch.zeros(2, 2), jacobian=by_rows, max_steps=500)
    assert solution.reasons == (CONVERGED, OPEN)
