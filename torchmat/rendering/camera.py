"""Cameras: from a picture's pixels to rays of the scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.errors import RangeError, check_positive, message
from torchmat.rendering.lights import unit, vector

_UP = (0.0, 1.0, 0.0)
_MARGIN = 1.02  # a framed object's bounding sphere fills all but so much of the picture


class Rays(NamedTuple):
    """`origin` and `direction` (unit) [P, 3] float64, and the pixel's width `spread` as a + b * distance."""

    origin: Tensor
    direction: Tensor
    width_at_origin: float
    width_per_distance: float


@dataclass(frozen=True)
class Camera:
    """A camera at a place of the scene that looks at another.

    Args:
        position: x, y, z in the scene's frame (x right, y up) and unit of length.
        target: the point that it looks at.
        up: the direction that is up in the picture; not along the line of sight.
        field_of_view: the angle, in radians, that the picture's width spans, above 0 and below pi.
        width: how much of the scene the picture's width spans, which makes the camera orthographic; None for perspective.
    """

    position: Sequence[float]
    target: Sequence[float] = (0.0, 0.0, 0.0)
    up: Sequence[float] = _UP
    field_of_view: float = math.radians(30.0)
    width: float | None = None

    def __post_init__(self) -> None:
        where = "Camera"
        position, target = vector(where, "position", self.position), vector(where, "target", self.target)
        unit(where, "up", self.up)
        if not bool((position - target).norm() > 0):
            step = "Move the camera away from what it looks at."
            raise RangeError(message(where, "position", "differ from target", f"both are {position.tolist()}", step))
        if not 0 < self.field_of_view < math.pi:
            fact = f"it is {self.field_of_view}"
            raise RangeError(message(where, "field_of_view", "lie between 0 and pi", fact, "It is in radians."))
        if self.width is not None and not 0 < self.width < math.inf:
            raise RangeError(message(where, "width", "be positive", f"it is {self.width}"))

    def axes(self) -> Tensor:
        """Return right, up and backward (toward the camera) as rows [3, 3] of unit vectors."""
        position, target = vector("Camera", "position", self.position), vector("Camera", "target", self.target)
        back = unit("Camera", "position", position - target)
        right = torch.linalg.cross(unit("Camera", "up", self.up), back)
        if float(right.norm()) < 1e-6:
            # Looking along `up`: the picture's right is +x, or +z where that is what is looked along.
            axis = torch.tensor([1.0, 0.0, 0.0] if abs(float(back[0])) < 0.9 else [0.0, 0.0, 1.0], dtype=back.dtype)
            right = axis - back * (axis * back).sum()
        right = right / right.norm()
        return torch.stack((right, torch.linalg.cross(back, right), back))

    def rays(self, x: Tensor, y: Tensor, columns: int) -> Rays:
        """Return the rays through picture positions `x` and `y` [P], in half widths from the centre, x right and y up."""
        right, up, back = self.axes()
        position = vector("Camera", "position", self.position)
        x, y = x.double(), y.double()
        if self.width is not None:
            origin = position + (x[:, None] * right + y[:, None] * up) * (self.width / 2)
            return Rays(origin, -back.expand(len(x), 3), self.width / columns, 0.0)
        half = math.tan(self.field_of_view / 2)
        direction = (x[:, None] * right + y[:, None] * up) * half - back
        direction = direction / direction.norm(dim=1, keepdim=True)
        return Rays(position.expand(len(x), 3), direction, 0.0, 2 * half / columns)

    def place(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return where `points` [P, 3] float64 lie in the picture, as `rays` takes it, and how far ahead of the camera.

        Of a perspective camera what lies behind it has no place: its numbers mean nothing.
        """
        x, y, z = ((points - vector("Camera", "position", self.position)) @ self.axes().T).unbind(dim=1)
        if self.width is not None:
            return x / (self.width / 2), y / (self.width / 2), -z
        half = -z * math.tan(self.field_of_view / 2)
        return x / half, y / half, -z

    @classmethod
    def framing(
        cls, centre: Sequence[float] | Tensor, radius: float, direction: Sequence[float] | Tensor = (0.0, 0.0, 1.0),
        field_of_view: float | None = None, up: Sequence[float] = _UP,
    ) -> Camera:
        """Return a camera in `direction` from a sphere that just fills its picture; orthographic without a field of view."""
        check_positive("Camera.framing", "radius", radius)
        middle, way = vector("Camera.framing", "centre", centre), unit("Camera.framing", "direction", direction)
        if field_of_view is None:
            far = middle + way * (4 * radius)
            return cls(tuple(far.tolist()), tuple(middle.tolist()), up, width=2 * _MARGIN * radius)
        if not 0 < field_of_view < math.pi:
            raise RangeError(message("Camera.framing", "field_of_view", "lie between 0 and pi", f"it is {field_of_view}"))
        far = middle + way * (_MARGIN * radius / math.sin(field_of_view / 2))
        return cls(tuple(far.tolist()), tuple(middle.tolist()), up, field_of_view)
