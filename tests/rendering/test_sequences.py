"""Turntables and light sweeps: each picture is what render gives for that camera or light."""

from __future__ import annotations

import math

import pytest
import torch
from tests.support import assert_close

from torchmat.errors import RangeError
from torchmat.models import Texture
from torchmat.rendering import Camera, Directional, Point, render
from torchmat.rendering.as_mesh import as_mesh
from torchmat.rendering.sequences import light_sweep, turntable

LIGHT = (0.3, 0.4, 0.8)


@pytest.fixture(scope="module")
def material() -> Texture:
    generator = torch.Generator().manual_seed(0)
    return Texture({"albedo": torch.rand(3, 8, 8, generator=generator)})


def test_a_turntable_starts_in_front_with_the_lights_as_given(material):
    first = next(turntable(material, "cube", [LIGHT], 4, elevation=0.0, size=16, rays=1))
    assert_close(first, render(material, "cube", [LIGHT], size=16, rays=1), 1e-5)


def test_a_turntable_turns_the_cube_to_its_other_sides(material):
    # Each side of the cube carries the same texture, and the light goes with the camera.
    pictures = list(turntable(material, "cube", [LIGHT], 4, elevation=0.0, size=24, rays=1))
    assert len(pictures) == 4
    for picture in pictures[1:]:
        # Rays that meet a texel's border may fall to either side of it.
        assert float((picture - pictures[0]).abs().median()) < 1e-6
        assert float((picture - pictures[0]).abs().mean()) < 1e-3


def test_a_turntable_shows_the_back_of_a_quad_as_black(material):
    front, _, back, _ = turntable(material, "quad", [LIGHT], 4, elevation=0.0, size=8)
    assert float(front.max()) > 0.1 and not bool(back.any())


def test_a_sweep_is_render_under_each_light(material):
    polar, view = 0.9, (0.4, 0.2, 1.0)
    pictures = list(light_sweep(material, "torus", 3, polar, view, size=16, rays=4, edges_only=False, shadows=True))
    mesh = as_mesh("torus")
    axes = Camera.framing(mesh.centre, mesh.radius, view).axes()
    for step, picture in enumerate(pictures):
        azimuth = 2 * math.pi * step / 3
        local = torch.tensor([math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar)])
        expected = render(material, mesh, [Directional(local.double() @ axes)], view, 16, rays=4, shadows=True)
        assert_close(picture, expected, 1e-5)


def test_a_turntable_wants_distant_lights(material):
    with pytest.raises(RangeError, match="the lights must be distant; one is Point"):
        next(turntable(material, "cube", [Point((0, 0, 5))], 2, size=4))


def test_errors_come_before_any_picture(material):
    with pytest.raises(RangeError, match="count must be at least 1"):
        next(turntable(material, "cube", [LIGHT], 0))
    with pytest.raises(RangeError, match="count must be at least 1"):
        next(light_sweep(material, "cube", 0))
    with pytest.raises(RangeError, match="size and repeat must be positive"):
        next(light_sweep(material, "cube", 2, size=0))
