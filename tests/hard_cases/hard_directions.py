"""Directions where formulas break, as light and view: beside those of `brdf.directions`."""

from __future__ import annotations

import math

import torch
from tests.brdf.directions import graze
from tests.models.examples import per_image
from torch import Tensor


def rows_of(pairs, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor]:
    """Return pairs of directions as light and view [n, 3, 1, 1]."""
    both = torch.tensor(list(pairs), dtype=dtype)
    return per_image(both[:, 0]), per_image(both[:, 1])


def parabolic(x: float, y: float) -> tuple[float, float, float]:
    """Return the direction at a place of the parabolic disc."""
    squared = x * x + y * y
    return 2 * x / (1 + squared), 2 * y / (1 + squared), (1 - squared) / (1 + squared)


def half_pairs() -> list[tuple]:
    """Return pairs whose half vector is the centre, a texel's edge or the rim of a parabolic map of any even size."""
    found = [(graze(a, 0.7), graze(a + math.pi, 0.7)) for a in (0.0, 0.4, 2.0, math.pi)]
    edges = [(0.0, 1 / 3), (1 / 3, 1 / 3), (-1 / 3, 2 / 3), (0.5, 0.0), (-0.25, -0.5), (2 / 3, 0.0)]
    found += [(parabolic(x, y),) * 2 for x, y in edges]  # light and view along it
    return found + [(graze(a, 1e-6), graze(a + 0.4, 1e-6)) for a in (0.0, 1.0, math.pi / 2, 3.0)]


HARD = torch.tensor([[0, 0, 1.0], [0.6, 0, 0.8], [-0.6, 0, 0.8], [1, 0, 1e-4], [-1, 0, 1e-4], [0, 0.8, 0.6]])


def hard_grid(dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Return every pair of a few hard directions [36, 3, 1, 1]."""
    rows = HARD.to(dtype)
    return per_image(rows.repeat(len(rows), 1)), per_image(rows.repeat_interleave(len(rows), 0))
