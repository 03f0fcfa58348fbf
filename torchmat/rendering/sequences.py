"""Sequences of pictures: an object on a turntable, a light that goes round it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchmat.errors import RangeError, message
from torchmat.progress import progress
from torchmat.rendering.animate import directions_on_circle, turntable_directions
from torchmat.rendering.as_mesh import as_mesh
from torchmat.rendering.camera import Camera
from torchmat.rendering.files import on_neutral
from torchmat.rendering.lights import DEFAULT_LIGHT, Directional, Light, as_light, unit
from torchmat.rendering.mesh import Mesh
from torchmat.rendering.mipmap import Pyramid, Shader
from torchmat.rendering.objects import shade_visible
from torchmat.rendering.visibility import see

_SWEEP_POLAR = math.radians(55.0)


def turntable(
    material: Shader, mesh: str | Path | Mesh = "teapot", lights: Sequence[Light | Sequence[float]] = (DEFAULT_LIGHT,),
    count: int = 24, elevation: float = math.radians(20.0), size: int | tuple[int, int] = 256, repeat: float = 1.0, *,
    field_of_view: float | None = None, shadows: bool = False, rays: int = 4, edges_only: bool = True,
    show: bool | None = None, background: float = 0.0,
) -> Iterator[Tensor]:
    """Yield `count` linear pictures of the object turning once about its vertical axis, camera and lights at rest.

    The camera looks down on it by `elevation` radians; `lights` stand in the camera's frame (x right, y up, z toward
    it), so only distant ones are taken. The other arguments are those of `render`; `show` the progress bar, `background` the even linear grey behind the object.
    """
    body = as_mesh(mesh)
    pyramid = Pyramid(material)
    lamps = [as_light(light) for light in lights]
    for direction in progress(turntable_directions(count, elevation, dtype=torch.float64), "turntable", count, show):
        camera = Camera.framing(body.centre, body.radius, direction, field_of_view)
        seen = see(body, camera, size, rays, edges_only, repeat, pyramid.dtype)
        picture = shade_visible(pyramid, seen, [_turned(lamp, camera) for lamp in lamps], shadows, soften=True)
        yield on_neutral(picture, seen.coverage, background)


def _turned(light: Light, camera: Camera) -> Directional:
    """Return a distant light of the camera's frame in the scene's."""
    if not isinstance(light, Directional):
        step = "Use Directional lights, or `render` one camera after the other."
        raise RangeError(message("turntable", "the lights", "be distant", f"one is {light}", step))
    direction = unit("turntable", "light", light.direction)
    return Directional(tuple((direction @ camera.axes()).tolist()), light.intensity)


def light_sweep(
    material: Shader, mesh: str | Path | Mesh = "teapot", count: int = 24, polar: float = _SWEEP_POLAR,
    view: Sequence[float] = (0.0, 0.0, 1.0), size: int | tuple[int, int] = 256, repeat: float = 1.0, *,
    field_of_view: float | None = None, shadows: bool = False, rays: int = 4, edges_only: bool = True,
    show: bool | None = None, background: float = 0.0,
) -> Iterator[Tensor]:
    """Yield `count` linear pictures of an object at rest, a distant light going once round the line of sight.

    The light stands `polar` radians from the direction to the camera. What is seen is found once. The other arguments are
    those of `render`; `show` the progress bar, `background` the even linear grey behind the object.
    """
    body = as_mesh(mesh)
    pyramid = Pyramid(material)
    camera = Camera.framing(body.centre, body.radius, view, field_of_view)
    seen = see(body, camera, size, rays, edges_only, repeat, pyramid.dtype)
    coverage = seen.coverage
    around = directions_on_circle(count, polar, dtype=torch.float64) @ camera.axes()
    for direction in progress(around, "light sweep", count, show):
        picture = shade_visible(pyramid, seen, [Directional(tuple(direction.tolist()))], shadows, soften=True)
        yield on_neutral(picture, coverage, background)
