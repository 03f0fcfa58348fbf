"""Pictures of objects: the visible points of a mesh, shaded under each light that reaches them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchmat.rendering.lights import Light, Point
from torchmat.rendering.mesh import Mesh
from torchmat.rendering.mipmap import Pyramid, Shader
from torchmat.rendering.visibility import Visible, check_outside

_FLATTEST = math.cos(math.radians(80.0))  # flatter light than that is hardly ever measured


def shade_visible(
    shader: Shader | Pyramid, visible: Visible, lights: Sequence[Light], shadows: bool = False, gradient: bool = False,
    soften: bool = False,
) -> Tensor:
    """Return the linear picture [3, rows, columns] of visible points under all `lights` together.

    Only points above whose horizon a light stands are shaded for it; with `shadows` only those that no other part of
    the mesh hides from it. Give a Pyramid to keep its smaller copies from one picture to the next.
    Models that stay bright up to the horizon (`Material.bright_at_horizon`) were fitted to no light there and end in a
    hard arc where it sets: with `soften` they fade over the last 10 degrees as the cosine does.
    With `gradient` the picture has one, in the maps of the shader.
    Raises RangeError when a light stands inside of the mesh.
    """
    pyramid = shader if isinstance(shader, Pyramid) else Pyramid(shader, gradient)
    check_lights(visible.mesh, lights)
    with torch.set_grad_enabled(gradient):
        values = torch.zeros(3, 1, len(visible.pixel), dtype=visible.position.dtype)
        parts = pyramid.parts(visible.footprint)
        for light in lights:
            _add_light(values, parts, visible, light, shadows, soften)
        return visible.resolve(values)


def check_lights(mesh: Mesh, lights: Sequence[Light]) -> None:
    """Raise RangeError when a light stands inside of the mesh."""
    for light in lights:
        if isinstance(light, Point):
            check_outside(mesh, "the light", light.position)


def reach(visible: Visible, light: Light, shadows: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Return a light's direction in each point's frame [3, 1, P], its intensity, and which points it reaches, bool [P].

    With `shadows` only those that no other part of the mesh hides from it.
    """
    direction, intensity, _ = light.reach(visible.position, visible.mesh.origin)
    local = _in_frame(visible.frame, direction)
    lit = (visible.view[2, 0] > 0) & (local[2, 0] > 0)
    if shadows:
        facing = lit.nonzero()[:, 0]
        lit[facing] = visible.reached_by(light, facing)
    return local, intensity, lit


def _add_light(values: Tensor, parts: list, visible: Visible, light: Light, shadows: bool, soften: bool) -> None:
    local, intensity, lit = reach(visible, light, shadows)
    for shader, which, weight in parts:
        chosen = lit.nonzero()[:, 0] if isinstance(which, slice) else which[lit[which]]
        if not len(chosen):
            continue
        above = _picked(local, chosen)
        shaded = shader.shade_at(_picked(visible.uv, chosen), above, _picked(visible.view, chosen))
        if soften and getattr(shader, "bright_at_horizon", False):
            shaded = _times(shaded, (above[2:] / _FLATTEST).clamp(max=1))
        shaded = _times(shaded, _picked(intensity, chosen) if intensity.shape[-1] > 1 else intensity)
        if weight is not None:
            shaded = _times(shaded, weight[lit[which]])
        values[:, 0].index_add_(1, chosen, shaded[:, 0])


def _times(shaded: Tensor, factor: Tensor) -> Tensor:
    """Return the product, in place where no gradient needs what was there."""
    return shaded * factor if shaded.requires_grad else shaded.mul_(factor)


def _in_frame(frame: Tensor, direction: Tensor) -> Tensor:
    """Return directions [3, 1, 1 or P] of the scene in frames [3, 3, 1, P]: one pass an axis, no product of them all."""
    x, y, z = direction
    return torch.addcmul(torch.addcmul(frame[:, 0] * x, frame[:, 1], y), frame[:, 2], z)


def _picked(plane: Tensor, which: Tensor) -> Tensor:
    """Return some points of [C, 1, P]; in two dimensions, where torch is 25 times as fast as in three."""
    return plane[:, 0].index_select(1, which)[:, None]
