"""What tests share: one tolerance table, directions, a small BTF made by plain NumPy, and files as the readers want them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

# Relative to the largest magnitude of the expected values. A test that needs more states its measured error and why.
TOLERANCE = {torch.float32: 2e-5, torch.float64: 1e-12}

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def assert_close(actual, expected, tolerance: float | None = None) -> None:
    """Assert that the worst element of `actual` lies within the tolerance of `expected`, relative to its largest one."""
    actual, expected = torch.as_tensor(actual), torch.as_tensor(expected)
    assert actual.shape == expected.shape, f"shapes differ: {tuple(actual.shape)} and {tuple(expected.shape)}"
    bound = TOLERANCE[actual.dtype] if tolerance is None else tolerance
    actual, expected = actual.detach(), expected.detach()
    assert bool(torch.isfinite(actual).all()), "not finite"
    scale = max(float(expected.abs().max()), 1e-30)
    worst = float((actual.double() - expected.double()).abs().max()) / scale
    assert worst <= bound, f"worst relative difference {worst:.3g}, allowed {bound:.3g}"


def hemisphere(rings: tuple[tuple[float, int], ...] = ((0, 1), (25, 5), (50, 7), (70, 9))) -> np.ndarray:
    """Return unit directions [n, 3] on rings of (polar degrees, count), azimuths staggered between rings."""
    rows = []
    for number, (polar, count) in enumerate(rings):
        for step in range(count):
            azimuth = 2 * np.pi * step / count + 0.37 * number
            polar_rad = np.deg2rad(polar)
            rows.append((np.sin(polar_rad) * np.cos(azimuth), np.sin(polar_rad) * np.sin(azimuth), np.cos(polar_rad)))
    return np.array(rows)


def all_pairs(lights: np.ndarray, views: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return light and view [n, 3] of every pair, views outermost."""
    return np.tile(lights, (len(views), 1)), np.repeat(views, len(lights), axis=0)


def plausible_images(light: np.ndarray, view: np.ndarray, height: int = 5, width: int = 4, seed: int = 0) -> np.ndarray:
    """Return linear images [n, 3, H, W] of bumpy Lambert plus a Blinn lobe, written in NumPy alone."""
    random = np.random.default_rng(seed)
    albedo = random.uniform(0.1, 0.8, (3, height, width))
    normal = np.stack((*random.uniform(-0.25, 0.25, (2, height, width)), np.ones((height, width))))
    normal /= np.linalg.norm(normal, axis=0)
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    n_dot_l = np.maximum(0, np.einsum("nk,khw->nhw", light, normal))
    n_dot_h = np.maximum(0, np.einsum("nk,khw->nhw", half, normal))
    return albedo * n_dot_l[:, None] + 0.3 * n_dot_h[:, None] ** 20


def shared_path(name: str) -> Path:
    """Return a path in the shared data, or skip the test, saying so."""
    import pytest

    path = SHARED / name
    if not path.exists():
        pytest.skip(f"shared data {name} is not on this machine")
    return path
