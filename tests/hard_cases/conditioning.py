"""Solvers against condition numbers from 1 to 1e12, scaled units, and samples that are missing or there twice.

Each case has a known answer in double precision (or from mpmath, where double precision is not enough). A figure is the
number of correct digits of what the solver returns; the note says what float32 did: kept its digits, damped, dropped
directions that it could not tell, or said that they stay open.
"""

from __future__ import annotations

from collections.abc import Sequence

import mpmath
import numpy as np
import torch
from torch import Tensor

from torchmat import Btf
from torchmat.fitting.models.streamed import solve_texels, stream_moments
from torchmat.solvers.least_squares import make_design
from torchmat.solvers.levenberg_marquardt import levenberg_marquardt

DTYPES = (torch.float32, torch.float64)
CONDITIONS = tuple(10.0**k for k in range(13))
UNITS = tuple(10.0**k for k in range(-6, 7, 2))
MOST = 16.0
PICTURE_STEPS = 100


def correct(found: Tensor, wanted: Tensor) -> float:
    """Return the number of correct digits: -log10 of the error's length relative to that of what is wanted."""
    error = float((found.double() - wanted.double()).norm() / wanted.double().norm().clamp(min=1e-300))
    return float(np.clip(-np.log10(error), -1, MOST)) if 0 < error < np.inf else (MOST if error == 0 else -1.0)


def matrix_of(condition: float, rows: int, columns: int, seed: int) -> np.ndarray:
    """Return a random matrix of a condition number, its singular values spread evenly over the magnitudes."""
    random = np.random.default_rng(seed)
    left = np.linalg.qr(random.standard_normal((rows, columns)))[0]
    right = np.linalg.qr(random.standard_normal((columns, columns)))[0]
    return left * np.geomspace(1, 1 / condition, columns) @ right.T


def exact_least_squares(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the solution [columns] of the normal equations in 80 digits."""
    with mpmath.workdps(80):
        a, b = mpmath.matrix(matrix.tolist()), mpmath.matrix(values.tolist())
        return np.array([float(x) for x in mpmath.lu_solve(a.T * a, a.T * b)])


def _linear(
    matrix: np.ndarray, values: np.ndarray, dtype: torch.dtype, valid: np.ndarray | None = None
) -> tuple[Tensor, float]:
    """Return coefficients [columns] of one texel by the package's linear solver, and the coverage that it reports."""
    rows = len(matrix)
    directions = np.tile([0.0, 0.0, 1.0], (rows, 1))
    images = np.broadcast_to(values[:, None, None, None], (rows, 3, 1, 1)).astype(np.float32).copy()
    btf = Btf.from_tensors(images, directions, directions, valid)
    used = torch.ones(rows, dtype=torch.bool)
    design = make_design(torch.from_numpy(matrix), used)
    solved = solve_texels(btf, design, stream_moments(btf, design, used, dtype), used)
    return solved.coefficients[:, 0, 0, 0], float(solved.coverage)


def linear_rows(conditions: Sequence[float], seed: int) -> list[dict]:
    """Return the rows of the linear solver: matrices of each condition, units, missing and doubled samples."""
    rows = []
    for condition in conditions:
        matrix = matrix_of(condition, 24, 4, seed)
        values = (matrix @ np.random.default_rng(seed).uniform(0.5, 1, 4)).astype(np.float32).astype(np.float64)
        wanted = exact_least_squares(matrix, values)
        for dtype in DTYPES:
            found, coverage = _linear(matrix, values, dtype)
            full = coverage == 1
            predicted = correct(torch.from_numpy(matrix) @ found.double(), torch.from_numpy(values))
            figure = correct(found, torch.from_numpy(wanted))
            note = (
                "all directions"
                if full
                else f"drops what it cannot tell: coverage {coverage:g}, prediction right to {predicted:.1f} digits"
            )
            # Inputs of float32 carry 7.2 digits, of which the condition takes its own.
            enough = figure >= digits_of(dtype) - np.log10(condition) - 1.5 if full else predicted >= 5
            rows.append(row_of("condition", "linear least squares", dtype, condition, figure, enough, note))
    return rows + _scaled_units(seed) + _missing(seed)


def digits_of(dtype: torch.dtype) -> float:
    """Return the digits of a precision."""
    return 7.2 if dtype == torch.float32 else 15.6


def _scaled_units(seed: int) -> list[dict]:
    rows = []
    for unit in UNITS:
        matrix = matrix_of(3.0, 24, 4, seed) * np.geomspace(1, unit, 4)
        values = (
            (matrix @ (np.random.default_rng(seed).uniform(0.5, 1, 4) / np.geomspace(1, unit, 4)))
            .astype(np.float32)
            .astype(np.float64)
        )
        wanted = exact_least_squares(matrix, values) * np.geomspace(1, unit, 4)
        for dtype in DTYPES:
            found, _ = _linear(matrix, values, dtype)
            figure = correct(found.double() * torch.from_numpy(np.geomspace(1, unit, 4)), torch.from_numpy(wanted))
            enough = figure >= digits_of(dtype) - 1.5
            rows.append(row_of("units", "linear least squares", dtype, unit, figure, enough, ""))
    return rows


def _missing(seed: int) -> list[dict]:
    """Return rows for samples that a texel lacks, and for samples that are there twice."""
    rows = []
    matrix = matrix_of(10.0, 24, 4, seed)
    values = (matrix @ np.random.default_rng(seed).uniform(0.5, 1, 4)).astype(np.float32).astype(np.float64)
    values += np.float32(1e-2) * np.random.default_rng(seed + 1).standard_normal(24).astype(np.float32)
    values = values.astype(np.float32).astype(np.float64)
    for missing in (0, 8, 19, 20, 22):
        there = np.arange(24) >= missing
        wanted = np.linalg.lstsq(matrix[there], values[there], rcond=None)[0]
        if missing < 20:
            wanted = exact_least_squares(matrix[there], values[there])
        for dtype in DTYPES:
            found, coverage = _linear(matrix, values, dtype, there[:, None, None].copy())
            figure = correct(found, torch.from_numpy(wanted))
            # Where samples are missing, a texel is solved by its normal equations, in double precision: those lose the
            # digits of the condition number twice. Inputs of single precision have lost theirs once before.
            loss = np.log10(np.linalg.cond(matrix[there])) * (2 if dtype == torch.float64 else 1)
            note = "" if coverage == 1 else f"least norm, coverage {coverage:g}"
            rows.append(
                row_of(
                    "missing samples",
                    "linear least squares",
                    dtype,
                    missing,
                    figure,
                    figure >= digits_of(dtype) - loss - 2,
                    note,
                )
            )
    doubled, twice = np.concatenate((matrix, matrix[:12])), np.concatenate((values, values[:12]))
    wanted = exact_least_squares(doubled, twice)
    for dtype in DTYPES:
        figure = correct(_linear(doubled, twice, dtype)[0], torch.from_numpy(wanted))
        rows.append(
            row_of("doubled samples", "linear least squares", dtype, 12, figure, figure >= digits_of(dtype) - 2.5, "")
        )
    return rows


def marquardt_rows(conditions: Sequence[float], seed: int) -> list[dict]:
    """Return the rows of Levenberg-Marquardt on exponentials of a linear map of each condition, and on scaled units."""
    rows = []
    for case, numbers in (("condition", conditions), ("units", UNITS)):
        for number in numbers:
            matrix = matrix_of(number if case == "condition" else 3.0, 24, 3, seed)
            scale = np.geomspace(1, number, 3) if case == "units" else np.ones(3)
            truth = np.random.default_rng(seed).uniform(0.5, 1, 3)
            for dtype in DTYPES:
                a, unit = torch.from_numpy(matrix).to(dtype), torch.from_numpy(scale).to(dtype)
                data = torch.exp(torch.from_numpy(matrix) @ torch.from_numpy(truth)).to(dtype)
                start = torch.zeros(1, 3, dtype=dtype)

                def residual(p: Tensor, a=a, unit=unit, data=data) -> Tensor:
                    return torch.exp((p * unit) @ a.T) - data

                solution = levenberg_marquardt(residual, start, max_steps=200)
                found = solution.parameters[0].double() * torch.from_numpy(scale)
                figure = correct(found, torch.from_numpy(truth))
                misfit = float(solution.cost[0].sqrt() / data.norm())
                loss = np.log10(number) if case == "condition" else 0.0
                # What the data cannot tell stays near the start, and the misfit is that of rounding.
                passed = figure >= digits_of(dtype) - 1.5 - 2 * loss or misfit < 30 * torch.finfo(dtype).eps
                note = f"{solution.reasons[0]}, misfit {misfit:.1g}"
                rows.append(row_of(case, "Levenberg-Marquardt", dtype, number, figure, passed, note))
    return rows


def descent_rows(conditions: Sequence[float], seed: int) -> list[dict]:
    """Return the rows of LBFGS on linear least squares of each condition, from zero."""
    from torchmat.solvers import lbfgs

    rows = []
    for condition in conditions:
        matrix = matrix_of(condition, 24, 3, seed)
        truth = np.random.default_rng(seed).uniform(0.5, 1, 3)
        for dtype in DTYPES:
            a, free = torch.from_numpy(matrix).to(dtype), torch.zeros(3, dtype=dtype, requires_grad=True)
            data = torch.from_numpy(matrix @ truth).to(dtype)

            def objective(chosen: Tensor | None, a=a, free=free, data=data) -> float:
                del chosen
                free.grad = None
                value = (a @ free - data).square().mean()
                value.backward()
                return float(value.detach())

            done = lbfgs([free], objective, steps=200, tolerance=1e-12)
            figure, misfit = (
                correct(free.detach(), torch.from_numpy(truth)),
                float((a @ free.detach() - data).norm() / data.norm()),
            )
            note = f"{done.reason}, misfit {misfit:.1g}"
            # From 1e4 on float32 stops on the slope between two singular values: measured, a misfit of up to 1 %.
            bound = 0.02 if dtype == torch.float32 and condition > 1e3 else 1e-4
            rows.append(row_of("condition", "LBFGS", dtype, condition, figure, misfit < bound, note))
    return rows


def row_of(
    case: str, component: str, dtype: torch.dtype, number: float, figure: float, passed: bool, note: str
) -> dict:
    """Return what is reported of one case."""
    name = f"{component}, {str(dtype).removeprefix('torch.')}"
    return {
        "case": case,
        "component": name,
        "count": 1,
        "number": float(number),
        "passed": bool(passed),
        "figure": round(figure, 2),
        "note": note,
    }


def run(count: int = 4, seed: int = 0) -> list[dict]:
    """Return the rows of all solvers at `count` conditions from 1 to 1e12 (13 at most)."""
    from tests.hard_cases import conditioning_maps as maps

    conditions = [CONDITIONS[k] for k in sorted(set(np.linspace(0, 12, min(count, 13)).round().astype(int)))]
    rows = linear_rows(conditions, seed) + marquardt_rows(conditions, seed) + descent_rows(conditions, seed)
    rows += maps.stereo_rows(conditions, seed)
    rows += maps.height_rows(UNITS, seed) + maps.picture_rows(conditions, seed)
    return rows + maps.component_rows(conditions, seed)


def plot(rows: list[dict], path) -> None:
    """Draw correct digits against the condition number and against units, a line for each solver and dtype."""
    from torchmat.report.pictures import plotting, save_figure

    figure, axes = plotting().subplots(1, 2, figsize=(11, 4.5), sharey=True)
    for axis, case in zip(axes, ("condition", "units"), strict=True):
        chosen = [row for row in rows if row["case"] == case]
        for number, component in enumerate(dict.fromkeys(row["component"] for row in chosen)):
            line = [row for row in chosen if row["component"] == component]
            style = "o-" if component.endswith("float64") else "x--"
            axis.plot(
                *zip(*[(row["number"], row["figure"]) for row in line], strict=True),
                style,
                color=f"C{number // 2}",
                markersize=3,
                label=component,
            )
        axis.set_xscale("log")
        axis.set_xlabel(
            {"condition": "condition number", "units": "unit of a column, or of the data"}[case], fontsize=8
        )
        axis.grid(alpha=0.3)
        axis.legend(fontsize=6)
    axes[0].set_ylabel("correct digits", fontsize=8)
    save_figure(figure, path)
