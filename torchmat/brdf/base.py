"""Brdf: the reflectance of one homogeneous surface, as a function of light and view."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchmat import safe
from torchmat.errors import RangeError, ShapeError, message


class Brdf:
    """A homogeneous surface in its tangent frame (z the normal), measured or given by a formula.

    Subclasses implement `value`; `dtype` is the precision of their numbers, and one call has one precision.
    `isotropic`: turning light and view together about the normal changes nothing. `reciprocal`: light and view may
    change places without changing ``f_r``.
    """

    name: str
    isotropic: bool = True
    reciprocal: bool = False
    dtype: torch.dtype = torch.float32

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        """Return ``pi * f_r * cos(light)`` for light and view above the horizon; what it says below is never used."""
        raise NotImplementedError

    def shade(self, light: Tensor, view: Tensor) -> Tensor:
        """Return ``pi * f_r * cos(light)``, linear RGB, never negative, as `Material.shade` does.

        `light`, `view`: unit vectors [..., 3, H, W] that broadcast; the result is [..., 3, H, W]. Exactly 0, with
        gradient 0, where the light or the view is not above z = 0. Raises ShapeError unless vectors lie on dimension
        -3, RangeError when they have another precision.
        """
        self._check(light, view)
        above = (light[..., 2:3, :, :] > 0) & (view[..., 2:3, :, :] > 0)
        if bool(above.all()):
            return self.value(light, view).clamp(min=0)
        # Below the horizon the formula sees the pole instead, where it is finite, so that the gradient is 0, not NaN.
        pole = torch.zeros(3, 1, 1, dtype=light.dtype)
        pole[2] = 1
        value = self.value(torch.where(above, light, pole), torch.where(above, view, pole))
        return torch.where(above, value.clamp(min=0), torch.zeros((), dtype=value.dtype))

    def reflectance(self, light: Tensor, view: Tensor) -> Tensor:
        """Return ``f_r`` in 1/sr, [..., 3, H, W]; 0 below the horizon."""
        return safe.divide(self.shade(light, view), math.pi * light[..., 2:3, :, :].clamp(min=0))

    def shade_at(self, uv: Tensor, light: Tensor, view: Tensor) -> Tensor:
        """Return the value at texture coordinates, the same at all: so a renderer takes a Brdf for a material."""
        return self.shade(light, view)

    def _check(self, light: Tensor, view: Tensor) -> None:
        for label, direction in (("light", light), ("view", view)):
            if direction.ndim < 3 or direction.shape[-3] != 3:
                fact = f"it is {tuple(direction.shape)}"
                raise ShapeError(message(self.name, label, "be [..., 3, H, W]", fact, "Vectors lie on dimension -3."))
            if direction.dtype != self.dtype:
                step = "Convert it with .to(dtype); one call has one precision."
                raise RangeError(message(self.name, label, f"be {self.dtype}", f"it is {direction.dtype}", step))
