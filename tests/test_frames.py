"""Directions and tangent frames."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.support import assert_close, hemisphere

from torchmat import frames


def _normals(count: int, dtype, most_deg: float = 89.9) -> torch.Tensor:
    """Return `count` normals [3, count] evenly over the hemisphere's cap, the last ones at the given tilt."""
    index = np.arange(count)
    z = np.cos(np.deg2rad(most_deg)) + (1 - np.cos(np.deg2rad(most_deg))) * (1 - index / (count - 1))
    azimuth = index * math.pi * (3 - math.sqrt(5))
    radius = np.sqrt(np.maximum(0, 1 - z * z))
    return torch.tensor(np.stack((radius * np.cos(azimuth), radius * np.sin(azimuth), z)), dtype=dtype)


def test_known_directions(dtype):
    polar = torch.tensor([0, math.pi / 2, math.pi / 2, math.pi / 4], dtype=dtype)
    azimuth = torch.tensor([1.0, 0, math.pi / 2, math.pi], dtype=dtype)
    half = math.sqrt(0.5)
    expected = torch.tensor([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-half, 0, half]], dtype=dtype)
    assert_close(frames.from_polar(polar, azimuth), expected)


def test_dimension_of_the_vector(dtype):
    polar = torch.rand(4, 5, dtype=dtype)
    planes = frames.from_polar(polar, polar, dim=-3)
    assert planes.shape == (3, 4, 5)
    assert_close(planes.movedim(0, -1), frames.from_polar(polar, polar))
    assert_close(torch.stack(frames.to_polar(planes, dim=-3)), torch.stack((polar, polar)))


def test_round_trip(dtype):
    rows = torch.tensor(hemisphere(((0, 1), (1, 8), (45, 13), (89.9, 24))), dtype=dtype)
    polar, azimuth = frames.to_polar(rows)
    assert_close(frames.from_polar(polar, azimuth), rows)
    assert bool(((azimuth >= 0) & (azimuth < 2 * math.pi)).all())


def test_azimuth_of_a_full_turn_is_zero(dtype):
    polar = torch.tensor(0.7, dtype=dtype)
    for full in (0.0, 2 * math.pi):
        _, azimuth = frames.to_polar(frames.from_polar(polar, torch.tensor(full, dtype=dtype)))
        assert min(float(azimuth), 2 * math.pi - float(azimuth)) < 1e-6
        assert 0 <= float(azimuth) < 2 * math.pi
    # A hair below 0 would round up to a full turn in float32.
    _, azimuth = frames.to_polar(torch.tensor([1.0, -1e-9, 0.0]))
    assert float(azimuth) == 0


@pytest.mark.parametrize("x, y", [(0.0, 0.0), (-0.0, 0.0), (-0.0, -0.0), (1e-44, -1e-44)])
def test_azimuth_at_the_pole_is_zero_with_gradient_zero(x, y):
    direction = torch.tensor([x, y, 1.0], requires_grad=True)
    polar, azimuth = frames.to_polar(direction)
    assert float(azimuth.detach()) == 0
    (polar + azimuth).backward()
    assert bool(torch.isfinite(direction.grad).all())


def test_gradient_of_the_azimuth_near_the_pole(dtype):
    # x^2 + y^2 underflows in float32.
    direction = torch.tensor([3e-25, 4e-25, 1.0], dtype=dtype, requires_grad=True)
    _, azimuth = frames.to_polar(direction)
    azimuth.backward()
    assert_close(azimuth.detach(), torch.tensor(math.atan2(4, 3), dtype=dtype))
    assert_close(direction.grad, torch.tensor([-0.16e25, 0.12e25, 0], dtype=dtype))


def test_gradcheck_of_angles():
    direction = torch.tensor([[0.3, -0.4, 0.8], [-0.5, 0.2, 0.1]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(frames.to_polar, direction)
    assert torch.autograd.gradcheck(frames.from_polar, (direction[:, 0], direction[:, 1]))


def test_half_vector(dtype):
    light = torch.tensor([0.6, 0, 0.8], dtype=dtype)[:, None, None]
    view = torch.tensor([-0.6, 0, 0.8], dtype=dtype)[:, None, None]
    assert_close(frames.half_vector(light, view)[:, 0, 0], torch.tensor([0, 0, 1.0], dtype=dtype))
    assert_close(frames.half_vector(light, light), light)


def test_half_vector_of_opposite_directions_is_zero_with_gradient_zero(dtype):
    light = torch.tensor([0.6, 0, 0.8], dtype=dtype)[:, None, None].requires_grad_()
    half = frames.half_vector(light, -light.detach())
    assert not bool(half.any())
    half.sum().backward()
    assert not bool(light.grad.any())


def test_tangent_frame_is_orthonormal_and_right_handed(dtype):
    normal = _normals(10_000, dtype)[:, :, None]
    tangent, bitangent = frames.tangent_frame(normal)
    frame = torch.stack((tangent, bitangent, normal))[..., 0]
    gram = torch.einsum("ikn,jkn->nij", frame, frame)
    assert_close(gram, torch.eye(3, dtype=dtype).expand_as(gram))
    assert_close(torch.linalg.cross(tangent, bitangent, dim=-3), normal)


def test_tangent_frame_of_the_pole_and_by_hand(dtype):
    tangent, bitangent = frames.tangent_frame(torch.tensor([0, 0, 1.0], dtype=dtype), dim=0)
    assert tangent.tolist() == [1, 0, 0]
    assert bitangent.tolist() == [0, 1, 0]
    # The shortest rotation from z to 0.6, 0, 0.8 turns about y alone.
    tangent, bitangent = frames.tangent_frame(torch.tensor([0.6, 0, 0.8], dtype=dtype), dim=0)
    assert_close(tangent, torch.tensor([0.8, 0, -0.6], dtype=dtype))
    assert_close(bitangent, torch.tensor([0, 1.0, 0], dtype=dtype))


def test_tangent_frame_moves_with_the_normal():
    normal = _normals(10_000, torch.float64)
    step = 1e-5
    for axis in range(2):
        moved = normal.clone()
        moved[axis] += step
        moved = moved / moved.norm(dim=0)
        for one, other in zip(frames.tangent_frame(normal, 0), frames.tangent_frame(moved, 0), strict=True):
            # The turn that shares the half angle moves the frame at most 1.5 times as far as the normal, here by 2.
            assert float((one - other).norm(dim=0).max()) < 2 * step


def test_tangent_frame_is_continuous_round_the_rim_and_through_the_pole():
    turn = torch.linspace(0, 2 * math.pi, 2001, dtype=torch.float64)
    rim = frames.from_polar(torch.full_like(turn, math.radians(89.9)), turn, dim=0)
    through = frames.from_polar(torch.linspace(-1.569, 1.569, 2001, dtype=torch.float64), torch.full_like(turn, 0.7), dim=0)
    for path in (rim, through):
        for axis in frames.tangent_frame(path, 0):
            assert float((axis[:, 1:] - axis[:, :-1]).norm(dim=0).max()) < 0.01


def test_tangent_frame_stays_finite_at_the_opposite_pole(dtype):
    normal = torch.tensor([0, 0, -1.0], dtype=dtype, requires_grad=True)
    tangent, bitangent = frames.tangent_frame(normal, 0)
    (tangent + bitangent).sum().backward()
    assert bool(torch.isfinite(tangent).all())
    assert bool(torch.isfinite(normal.grad).all())


def test_tangent_frame_gradcheck():
    normal = _normals(9, torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda n: frames.tangent_frame(n, 0), normal)
