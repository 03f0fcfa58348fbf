"""Conditioning of what works on maps and images: photometric stereo, integration, sphere pictures, components."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from tests.hard_cases.conditioning import CONDITIONS, DTYPES, PICTURE_STEPS, UNITS, correct, digits_of, row_of
from tests.support import hemisphere
from torch import Tensor

from torchmat import Btf
from torchmat.geometry import frankot_chellappa, photometric_stereo, poisson


def stereo_rows(conditions: Sequence[float], seed: int) -> list[dict]:
    """Return the rows of photometric stereo: lights ever nearer to one plane, and images of any brightness."""
    random, rows = np.random.default_rng(seed), []
    normal = np.stack((*random.uniform(-0.3, 0.3, (2, 4, 4)), np.ones((4, 4))))
    normal /= np.linalg.norm(normal, axis=0)
    wide = hemisphere(((0, 1), (30, 6), (50, 6)))
    for condition in conditions:
        light = wide * np.array([1, 1 / condition, 1])
        light /= np.linalg.norm(light, axis=1, keepdims=True)
        rows += _stereo("condition", condition, light, normal, 1.0)
    return rows + [row for unit in UNITS for row in _stereo("units", unit, wide, normal, unit)]


def _stereo(case: str, number: float, light: np.ndarray, normal: np.ndarray, brightness: float) -> list[dict]:
    from torchmat.errors import RangeError

    rows = []
    shading = 0.5 * brightness * np.einsum("nk,khw->nhw", light, normal).clip(0)
    for dtype in DTYPES:
        images = torch.from_numpy(np.repeat(shading[:, None], 3, axis=1)).to(dtype)
        try:
            found = photometric_stereo(images, torch.from_numpy(light).to(dtype))
        except RangeError:
            rows.append(
                row_of(case, "photometric stereo", dtype, number, 0.0, True, "says so: the lights lie in one plane")
            )
            continue
        figure = correct(found.normal, torch.from_numpy(normal))
        # Weights are found in the images' precision; a trace of 1e-9 keeps every texel solvable.
        loss = 2 * np.log10(number) if case == "condition" else 0.0
        passed = figure >= min(digits_of(dtype), 9.0) - 2.5 - loss
        rows.append(
            row_of(
                case,
                "photometric stereo",
                dtype,
                number,
                figure,
                passed,
                f"confidence {float(found.confidence.mean()):.2g}",
            )
        )
    return rows


def height_rows(units: Sequence[float], seed: int) -> list[dict]:
    """Return the rows of the integrations: slopes of any size, and trust that differs by up to 1e12 between texels."""
    random, rows = np.random.default_rng(seed), []
    slopes = torch.from_numpy(random.standard_normal((2, 8, 6)))
    solvers: dict[str, Callable[[Tensor], Tensor]] = {"frankot_chellappa": frankot_chellappa, "poisson": poisson}
    for name, solve in solvers.items():
        for tiles in (True, False):
            wanted = solve(slopes, tiles=tiles)
            for unit in units:
                for dtype in DTYPES:
                    found = solve((slopes * unit).to(dtype), tiles=tiles)
                    figure = correct(found.double() / unit, wanted)
                    component = f"{name}, {'tiles' if tiles else 'open'}"
                    rows.append(row_of("units", component, dtype, unit, figure, figure >= digits_of(dtype) - 1.5, ""))
    return rows + _trust(slopes)


def _trust(slopes: Tensor) -> list[dict]:
    """Return rows of poisson() where half of the texels are trusted ever less, against a dense solution."""
    rows = []
    for ratio in CONDITIONS[::3]:
        weight = torch.ones(1, 8, 6, dtype=torch.float64)
        weight[:, :, 3:] = 1 / ratio
        wanted = _dense_poisson(slopes, weight[0])
        found = poisson(slopes, weight, tiles=False)
        figure = correct(found[0], wanted)
        rows.append(
            row_of(
                "condition",
                "poisson, trust",
                torch.float64,
                ratio,
                figure,
                figure >= 3.5,
                "keeps 1e-3 of the largest trust",
            )
        )
    return rows


def _dense_poisson(slopes: Tensor, weight: Tensor) -> Tensor:
    """Return the height of least weighted distance to slopes, edge by edge, by one dense factorisation."""
    rows, columns = weight.shape
    trust = (weight / weight.max() + 1e-3).numpy()
    rise = (slopes / columns).numpy()
    left, right = [], []
    for i in range(rows):
        for j in range(columns):
            for k, (m, n) in enumerate(((i, j + 1), (i - 1, j))):
                if m < 0 or n >= columns:
                    continue
                root = np.sqrt(min(trust[i, j], trust[m, n]))
                line = np.zeros(rows * columns)
                line[m * columns + n], line[i * columns + j] = root, -root
                left.append(line)
                right.append(root * (rise[k, i, j] + rise[k, m, n]) / 2)
    found = np.linalg.lstsq(np.array(left), np.array(right), rcond=None)[0].reshape(rows, columns)
    return torch.from_numpy(found - found.mean())


def picture_rows(conditions: Sequence[float], seed: int, steps: int = PICTURE_STEPS) -> list[dict]:
    """Return the rows of the sphere pictures: points that weigh ever less, against a dense solution."""
    from torchmat.fitting.models.spheres.problem import Shape, SphereProblem

    rows = []
    light, view = (torch.from_numpy(_directions(120, seed + k)).T[:, :, None] for k in (0, 1))
    value = torch.rand(3, 120, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    shape = Shape(torch.tensor([0.0, 1.0], dtype=torch.float64), torch.full((1, 1, 3), 0.5, dtype=torch.float64))
    for condition in conditions:
        weight = torch.from_numpy(np.geomspace(1, 1 / condition, 120))
        answers = []
        for dtype in (torch.float64, *DTYPES):
            problem = SphereProblem(*(x.to(dtype) for x in (light, view, value, weight)), 4)
            looked_up = problem.look(Shape(*(x.to(dtype) for x in shape)))
            system = problem.system(looked_up)
            right = looked_up.transpose(problem.weight * problem.value)
            if not answers:
                unit = torch.eye(3 * 2 * 16, dtype=dtype).reshape(-1, 1, 3, 8, 4)
                matrix = torch.stack([system.apply(one).flatten() for one in unit], dim=1)
                answers.append(torch.linalg.solve(matrix, right.flatten()))
                continue
            found = problem.solve(looked_up, problem.black(2), steps)
            figure = correct(found.flatten(), answers[0])
            residual = float((system.apply(found) - right).norm() / right.norm())
            passed = figure >= min(digits_of(dtype) - 3.5, 9) or residual < 1e3 * torch.finfo(dtype).eps
            rows.append(
                row_of(
                    "condition",
                    "sphere pictures",
                    dtype,
                    condition,
                    figure,
                    passed,
                    f"residual {residual:.1g}; smoothness damps",
                )
            )
    return rows


def _directions(count: int, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    z, azimuth = random.uniform(0.2, 1, count), random.uniform(0, 2 * np.pi, count)
    radius = np.sqrt(1 - z * z)
    return np.stack((radius * np.cos(azimuth), radius * np.sin(azimuth), z), axis=1)


def component_rows(conditions: Sequence[float], seed: int) -> list[dict]:
    """Return the rows of PCA: images whose components fade by each factor, kept whole, against what was put in."""
    import torchmat as tm

    rows = []
    light = hemisphere(((0, 1), (30, 7), (55, 9)))
    view = np.tile([0.0, 0.0, 1.0], (len(light), 1))
    for condition in conditions:
        random = np.random.default_rng(seed)
        left = np.linalg.qr(random.uniform(0, 1, (len(light), 3)))[0]
        right = np.linalg.qr(random.uniform(0, 1, (48, 3)))[0].T
        matrix = left * np.geomspace(1, 1 / condition, 3) @ right
        images = (matrix - matrix.min()).astype(np.float32)  # a constant more: rank 4
        btf = Btf.from_tensors(images.reshape(-1, 3, 4, 4), light, view)
        for dtype in DTYPES:
            material = tm.fit(
                btf, "pca", components=4, dtype=dtype, measure=False, progress=False, holdout=0.0
            ).material
            weight, component = (material.maps[key].detach().double() for key in ("weight", "component"))
            found = weight[:, 0].T @ component.reshape(4, -1)
            figure = correct(found, torch.from_numpy(images.reshape(len(light), -1)))
            rows.append(
                row_of(
                    "condition",
                    "principal components",
                    dtype,
                    condition,
                    figure,
                    figure >= 5.5,
                    "of the images, which are float32",
                )
            )
    return rows
