"""Rays of cameras, against directions by hand."""

from __future__ import annotations

import math

import pytest
import torch

from torchmat.errors import RangeError, ShapeError
from torchmat.rendering.camera import Camera


def near(actual, expected, tolerance=1e-12) -> bool:
    actual, expected = (torch.as_tensor(x, dtype=torch.float64) for x in (actual, expected))
    return torch.allclose(actual, expected, rtol=0, atol=tolerance)


def rays(camera: Camera, x: float, y: float, columns: int = 10):
    return camera.rays(torch.tensor([x]), torch.tensor([y]), columns)


def test_axes_of_the_default_view_are_the_scenes():
    assert near(Camera((0, 0, 5)).axes(), torch.eye(3))


def test_axes_are_a_right_handed_frame_from_anywhere():
    generator = torch.Generator().manual_seed(0)
    for position in torch.randn(50, 3, generator=generator, dtype=torch.float64):
        axes = Camera(position).axes()
        assert near(axes @ axes.T, torch.eye(3))
        assert float(torch.linalg.det(axes)) > 0.999
        assert near(axes[2], position / position.norm())
        assert float(axes[1, 1]) >= 0  # up stays up


@pytest.mark.parametrize("up", [(0, 1, 0), (1, 0, 0), (0, 0, 1)])
@pytest.mark.parametrize("side", [1, -1])
def test_a_camera_that_looks_along_up_has_a_frame_all_the_same(up, side):
    axes = Camera([4 * side * k for k in up], up=up).axes()
    assert near(axes @ axes.T, torch.eye(3))
    assert float(torch.linalg.det(axes)) > 0.999


def test_seen_from_above_right_is_right():
    assert near(Camera((0, 3, 0)).axes()[0], [1, 0, 0])


def test_perspective_rays_span_the_field_of_view():
    camera = Camera((0, 0, 2), field_of_view=math.radians(60))
    found = rays(camera, 1, 0)
    assert near(found.origin, [[0, 0, 2]])
    assert near(found.direction, [[math.sin(math.pi / 6), 0, -math.cos(math.pi / 6)]])
    assert near(rays(camera, 0, 0).direction, [[0, 0, -1]])
    up = rays(camera, 0, 1).direction[0]
    assert float(up[1]) > 0 and near(up.norm(), 1)
    # A pixel of ten is a tenth of what lies at distance 1 across the picture.
    assert near(found.width_per_distance, 2 * math.tan(math.pi / 6) / 10) and found.width_at_origin == 0


def test_orthographic_rays_are_parallel():
    camera = Camera((0, 0, 2), width=3)
    found = rays(camera, -1, 0.5)
    assert near(found.origin, [[-1.5, 0.75, 2]]) and near(found.direction, [[0, 0, -1]])
    assert near(found.width_at_origin, 0.3) and found.width_per_distance == 0


@pytest.mark.parametrize("field_of_view", [None, 0.3, 1.5])
def test_framing_just_holds_the_sphere(field_of_view):
    camera = Camera.framing((1, 2, 3), 2.0, (1, 1, 0), field_of_view)
    centre = torch.tensor([[1.0, 2.0, 3.0]], dtype=torch.float64)
    found = rays(camera, 0, 0)
    assert float(torch.linalg.cross(found.direction, centre - found.origin).norm()) < 1e-12
    edge = rays(camera, 1, 0)
    away = float(torch.linalg.cross(edge.direction, centre - edge.origin).norm())
    assert 2.0 < away < 2.0 * 1.03


def test_errors():
    with pytest.raises(RangeError, match="position must differ from target"):
        Camera((1, 2, 3), (1, 2, 3))
    with pytest.raises(ShapeError, match="position must be x, y, z"):
        Camera((1, 2))
    with pytest.raises(RangeError, match="position must be finite"):
        Camera((1, 2, math.nan))
    with pytest.raises(RangeError, match="up must be a finite direction"):
        Camera((1, 2, 3), up=(0, 0, 0))
    for angle in (0.0, math.pi, -1.0, math.nan):
        with pytest.raises(RangeError, match="field_of_view must lie between 0 and pi"):
            Camera((0, 0, 1), field_of_view=angle)
    for width in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(RangeError, match="width must be positive"):
            Camera((0, 0, 1), width=width)
    for radius in (0.0, math.inf, math.nan):
        with pytest.raises(RangeError, match="radius must be positive"):
            Camera.framing((0, 0, 0), radius)
