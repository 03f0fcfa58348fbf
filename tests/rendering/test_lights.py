"""Lights: what reaches a place, and environments against the integral that they stand for."""

from __future__ import annotations

import math

import pytest
import torch

from torchmat.errors import RangeError, ShapeError
from torchmat.rendering.lights import Directional, Point, as_light, environment_lights

PLACES = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 0, 2]], dtype=torch.float64).T[:, None]


def test_a_distant_light_is_the_same_everywhere():
    direction, intensity, distance = Directional((0, 0, 7), (1, 2, 3)).reach(PLACES)
    assert direction.shape == intensity.shape == (3, 1, 1) and distance is None
    assert direction.flatten().tolist() == [0, 0, 1] and intensity.flatten().tolist() == [1, 2, 3]


def test_a_point_light_falls_off_with_the_square(dtype):
    direction, intensity, distance = Point((0, 0, 4), (8, 4, 0)).reach(PLACES.to(dtype))
    assert direction.dtype == intensity.dtype == dtype
    assert direction[:, 0, 0].tolist() == [0, 0, 1] and direction[:, 0, 2].tolist() == [0, 0, 1]
    assert intensity[:, 0, 0].tolist() == [0.5, 0.25, 0] and intensity[:, 0, 2].tolist() == [2, 1, 0]
    assert distance[0].tolist() == pytest.approx([4, math.sqrt(17), 2])


def test_a_point_light_in_the_very_surface_leaves_it_dark_and_finite(dtype):
    direction, intensity, _ = Point((1, 0, 0)).reach(PLACES.to(dtype))
    assert bool(torch.isfinite(direction).all()) and bool(torch.isfinite(intensity).all())
    assert not bool(intensity[:, 0, 1].any())


def test_numbers_are_a_distant_light():
    assert as_light((1, 0, 0)) == Directional((1, 0, 0))
    lamp = Point((1, 2, 3))
    assert as_light(lamp) is lamp


def test_bad_lights():
    for kind, name in ((Directional, "light"), (Point, "position")):
        with pytest.raises(ShapeError, match=f"{name} must be x, y, z"):
            kind((1, 2))
        with pytest.raises(RangeError, match=f"{name} must be (a )?finite"):
            kind((1, 2, math.inf))
        with pytest.raises(RangeError, match="intensity must not be negative"):
            kind((1, 2, 3), (1, -1, 1))
        with pytest.raises(ShapeError, match="intensity must be x, y, z"):
            kind((1, 2, 3), (1, 1))


def irradiance(lights, normal) -> torch.Tensor:
    """The value of a white diffuse surface: the sum of intensity times cosine."""
    total = torch.zeros(3, dtype=torch.float64)
    for light in lights:
        cosine = float((torch.tensor(light.direction) * torch.tensor(normal)).sum())
        total += torch.tensor(light.intensity) * max(0.0, cosine)
    return total


@pytest.mark.parametrize("count, tolerance", [(16, 0.13), (64, 0.04), (256, 0.015)])  # measured: 0.121, 0.031, 0.008
@pytest.mark.parametrize("normal", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, -0.8), (0.0, -1.0, 0.0)])
def test_a_white_sky_lights_a_white_surface_to_one(normal, count, tolerance):
    lights = environment_lights(torch.ones(3, 32, 64), count)
    assert len(lights) == count
    assert float((irradiance(lights, normal) - 1).abs().max()) < tolerance


def test_the_sum_of_light_is_kept():
    generator = torch.Generator().manual_seed(1)
    picture = torch.rand(3, 16, 32, generator=generator)
    edges = torch.arange(17, dtype=torch.float64) / 16 * math.pi
    solid_angle = (edges[:-1].cos() - edges[1:].cos())[:, None] * (2 * math.pi / 32)
    wanted = (picture * solid_angle).sum(dim=(1, 2)) / math.pi
    for count in (1, 7, 100):
        found = sum(torch.tensor(light.intensity, dtype=torch.float64) for light in environment_lights(picture, count))
        assert torch.allclose(found, wanted, rtol=1e-6)


@pytest.mark.parametrize(
    "row, column, direction",
    [(8, 16, (0, 0, -1)), (8, 24, (1, 0, 0)), (8, 8, (-1, 0, 0)), (8, 0, (0, 0, 1)), (0, 5, (0, 1, 0)), (15, 5, (0, -1, 0))],
)
def test_a_sun_shines_from_its_pixel(row, column, direction):
    picture = torch.zeros(3, 16, 32)
    picture[:, row, column] = 5
    (light,) = environment_lights(picture, 32)  # one pixel shines, so there is one light
    cosine = float((torch.tensor(light.direction) * torch.tensor(direction)).sum())
    assert cosine > math.cos(math.radians(360 / 32))


def test_turn_takes_the_front_toward_the_right():
    picture = torch.zeros(3, 16, 32)
    picture[:, 8, 0] = 1  # +z
    (light,) = environment_lights(picture, 1, turn=math.pi / 2)
    assert light.direction[0] > 0.98


def test_a_colour_without_luminance_still_shines():
    picture = torch.zeros(3, 4, 8)
    picture[2] = 1e-30
    assert sum(light.intensity[2] for light in environment_lights(picture, 4)) > 0


def test_environment_errors():
    good = torch.ones(3, 4, 8)
    with pytest.raises(ShapeError, match=r"must be \[3, H, W\]"):
        environment_lights(good[:2])
    with pytest.raises(RangeError, match="must be finite"):
        environment_lights(good * math.nan)
    with pytest.raises(RangeError, match="hold light"):
        environment_lights(good * 0)
    with pytest.raises(RangeError, match="hold light"):
        environment_lights(-good)
    with pytest.raises(RangeError, match="count and turn"):
        environment_lights(good, 0)
