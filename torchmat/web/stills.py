"""Pictures of a material for pages that cannot draw it themselves."""

from __future__ import annotations

import base64
import io
import math

import torch
from torch import Tensor

from torchmat import colour
from torchmat.models import Material
from torchmat.rendering import render
from torchmat.web.page import Still

_QUALITY = 85  # of JPEG
_THREE_QUARTER = (0.7, 0.5, 1.0)
_NEUTRAL = 0.2  # behind an object, linear
# Polar angle and azimuth of light and view, degrees: lit from all sides, and seen and lit ever flatter.
_PAIRS = (
    ((45, 135), (0, 0)), ((45, 45), (0, 0)), ((70, 180), (0, 0)), ((70, 0), (0, 0)), ((45, 180), (45, 0)), ((60, 180), (60, 0)), ((30, 0), (60, 0)),
)


def still(picture: Tensor, said: str) -> Still:
    """Return a linear picture [3, H, W] as JPEG in a data URI."""
    from matplotlib.image import imsave

    stream = io.BytesIO()
    pixels = (colour.display(picture.detach().float().nan_to_num(0.0)) * 255).round().to(torch.uint8).permute(1, 2, 0)
    imsave(stream, pixels.contiguous().numpy(), format="jpg", pil_kwargs={"quality": _QUALITY})
    size = (int(picture.shape[1]), int(picture.shape[2]))
    return Still(f"data:image/jpeg;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}", size, said)


def object_stills(material: Material, mesh: object = "teapot", size: int = 280) -> list[Still]:
    """Return one picture of a material on an object."""
    name = mesh if isinstance(mesh, str) else getattr(mesh, "name", "an object")
    view = (0.0, 0.0, 1.0) if mesh in ("quad", "sphere") else _THREE_QUARTER
    return [still(render(material, mesh, view=view, size=size, edges_only=True), f"The material on: {name}")]  # type: ignore[arg-type]


def gallery(material: Material, size: int = 160) -> list[Still]:
    """Return pictures of a material that no page can draw: on a sphere, and its patch from several directions."""
    found = object_stills(material, "sphere", 2 * size)
    for light, view in _PAIRS:
        directions = [_direction(*angles) for angles in (light, view)]
        picture = render(material, "patch", [directions[0]], directions[1], size=size)
        found.append(still(picture, f"Light {light[0]}° / {light[1]}°, view {view[0]}° / {view[1]}°"))
    return found


def _direction(polar_deg: float, azimuth_deg: float) -> tuple[float, float, float]:
    polar, azimuth = math.radians(polar_deg), math.radians(azimuth_deg)
    return math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar)
