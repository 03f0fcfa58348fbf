"""Pictures of a material that no page can draw: `render`'s, of the camera and the lights that a page has."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch

from torchmat import colour
from torchmat.errors import RangeError, check_option, message
from torchmat.models import Material
from torchmat.rendering.camera import Camera
from torchmat.rendering.lights import Directional, Light, Point
from torchmat.rendering.mipmap import Pyramid
from torchmat.rendering.objects import shade_visible
from torchmat.rendering.scene import Scene
from torchmat.rendering.shapes import SHAPES, make_mesh
from torchmat.rendering.visibility import Visible

MOST_SIDE, MOST_LIGHTS = 1024, 12
_FIELD_OF_VIEW = math.radians(30)  # of the page's camera (js/camera.js), over the shorter side
_DARK = Directional((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
_FAST = 1  # of PNG's compressions: it goes no farther than to this machine's browser


class Pictured:
    """Makes pictures, and keeps what the last one has in common with the next."""

    def __init__(self) -> None:
        self._pyramid: Pyramid | None = None
        self._seen: tuple[Any, Visible] | None = None

    def picture(
        self, material: Material, mesh: str, view: Sequence[float], zoom: float, perspective: bool,
        lights: Sequence[tuple[Sequence[float], Sequence[float]]], repeat: float, exposure: float, size: Sequence[int],
    ) -> bytes:
        """Return a PNG with alpha: 0 where the object is not.

        Args:
            mesh: one of SHAPES.
            view: x, y, z toward the camera; `zoom` 1 frames the object; `perspective` is a field of view of 30 degrees.
            lights: of each x, y, z and 0 of a direction or 1 of a place, and linear RGB; at most 12.
            repeat: factor on the texture coordinates.
            exposure: stops, -20 to 20.
            size: rows and columns, 1 to 1024.

        Raises RangeError for what lies outside.
        """
        check_option("studio picture", "mesh", mesh, SHAPES)
        _check(zoom, exposure, lights, size)
        key = (mesh, tuple(view), zoom, bool(perspective), repeat, tuple(size), material.dtype)
        if self._seen is None or self._seen[0] != key:
            scene = Scene(mesh, [_DARK], camera_of(mesh, view, zoom, perspective, size), size=(size[0], size[1]), repeat=repeat, rays=1)
            self._seen = key, scene.visible(material.dtype)
        if self._pyramid is None or self._pyramid.levels[0] is not material:
            self._pyramid = Pyramid(material)
        visible = self._seen[1]
        linear = shade_visible(self._pyramid, visible, [_light(*one) for one in lights], soften=True) * 2.0**exposure
        return _png(torch.cat((colour.display(linear.detach().float().nan_to_num(0.0)), visible.coverage.float().reshape(1, *size))))


def camera_of(mesh: str, view: Sequence[float], zoom: float, perspective: bool, size: Sequence[int]) -> Camera:
    """Return the camera of a page (js/camera.js): one that frames the object along the shorter side of the picture."""
    shape, wide = make_mesh(mesh), size[1] / min(size)
    framing = Camera.framing(shape.centre, shape.radius, view, _FIELD_OF_VIEW if perspective else None)
    if framing.width is not None:
        return replace(framing, width=framing.width * wide / zoom)
    near = [middle + (place - middle) / zoom for place, middle in zip(framing.position, framing.target, strict=True)]
    return replace(framing, position=tuple(near), field_of_view=2 * math.atan(wide * math.tan(_FIELD_OF_VIEW / 2)))


def _light(place: Sequence[float], shine: Sequence[float]) -> Light:
    return Point(place[:3], shine) if place[3] else Directional(place[:3], shine)


def _check(zoom: float, exposure: float, lights: Sequence[Any], size: Sequence[int]) -> None:
    for name, value, low, high in (("zoom", zoom, 1e-3, 1e3), ("exposure", exposure, -20, 20)):
        if not isinstance(value, int | float) or not low <= value <= high:
            raise RangeError(message("studio picture", name, f"lie in [{low:g}, {high}]", f"it is {value!r}"))
    if len(lights) > MOST_LIGHTS or not all(len(place) == 4 and len(shine) == 3 for place, shine in lights):
        requirement = f"be at most {MOST_LIGHTS} pairs of four and three numbers"
        raise RangeError(message("studio picture", "lights", requirement, f"they are {lights!r}"[:200]))
    if len(size) != 2 or not all(isinstance(one, int) and 1 <= one <= MOST_SIDE for one in size):
        raise RangeError(message("studio picture", "size", f"be rows and columns, 1 to {MOST_SIDE}", f"it is {size!r}"[:200]))


def _png(planes: torch.Tensor) -> bytes:
    from matplotlib.image import imsave

    stream = io.BytesIO()
    pixels = (planes * 255).round().to(torch.uint8).permute(1, 2, 0).contiguous().numpy()
    imsave(stream, pixels, format="png", pil_kwargs={"compress_level": _FAST})
    return stream.getvalue()
