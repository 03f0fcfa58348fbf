"""The short form of the conditioning suite: hard cases 9 and 13, and that its oracles can be trusted."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.hard_cases import conditioning, conditioning_maps


def test_solvers_keep_their_digits_or_say_what_they_dropped():
    failed = [row for row in conditioning.run(3) if not row["passed"]]
    assert failed == []


def test_the_rows_can_be_drawn(tmp_path):
    rows = conditioning.marquardt_rows((1.0, 1e3), 0)
    conditioning.plot(rows, tmp_path / "digits.png")
    assert (tmp_path / "digits.png").stat().st_size > 0


@pytest.mark.parametrize("condition", [1.0, 1e6, 1e12])
def test_a_matrix_has_the_condition_that_was_asked_for(condition):
    assert np.linalg.cond(conditioning.matrix_of(condition, 24, 4, 0)) == pytest.approx(condition, rel=1e-3)


def test_the_exact_solution_keeps_what_double_precision_loses():
    matrix, truth = conditioning.matrix_of(1e12, 24, 4, 0), np.array([0.5, 1.0, -1.0, 2.0])
    values = matrix @ truth
    found = conditioning.exact_least_squares(matrix, values)
    assert np.linalg.norm(found - truth) < 1e-3  # rounding the values themselves costs 1e-16 x 1e12
    assert np.linalg.norm(np.linalg.solve(matrix.T @ matrix, matrix.T @ values) - truth) > 1e-3


def test_conjugate_gradients_that_go_on_after_they_have_converged_stay_finite():
    assert all(row["passed"] for row in conditioning_maps.picture_rows((1e12,), 0, steps=300))


def test_digits_are_counted():
    wanted = torch.ones(4, dtype=torch.float64)
    assert conditioning.correct(wanted * (1 + 1e-5), wanted) == pytest.approx(5, abs=1e-3)
    assert conditioning.correct(wanted, wanted) == conditioning.MOST
    assert conditioning.correct(wanted * torch.nan, wanted) == -1


def test_a_solver_that_drops_a_direction_of_a_good_matrix_fails(monkeypatch):
    monkeypatch.setattr(conditioning, "_linear", lambda *_: (torch.zeros(4), 1.0))
    assert not any(row["passed"] for row in conditioning.linear_rows((1.0,), 0))
