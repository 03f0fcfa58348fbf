"""Sphere images against values: the best pictures for given k and angles.

A look-up is linear in the pictures, so they are a linear least squares, solved by conjugate gradients on its normal
equations: one `grid_sample` and its transpose a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.models.sphere_geometry import (
    Neighbours, atlas_grid, find_look_ups, find_neighbours, find_turns, place_on_sphere, sine_to_half,
)
from torchmat.repeatable import one_thread

_SMOOTHNESS = 1e-3  # cost of a difference between neighbouring texels, relative to what a typical texel is seen


class Shape(NamedTuple):
    """What is not linear: `angles` of the pictures [n] from 0, in radians, and `turn` [1, rows, K]."""

    angles: Tensor
    turn: Tensor


@dataclass
class LookedUp:
    """The look-ups of all points for one Shape, and the transpose of looking up.

    `grid` [2, 1, P, 2] and `share` [P] carry the gradient to `k` and `angle` [2, P] of each point where that is wanted.
    """

    near: Neighbours
    k: Tensor
    angle: Tensor
    grid: Tensor
    share: Tensor
    count: int
    size: int

    def __post_init__(self) -> None:
        fixed = self.grid.detach(), self.share.detach()
        # Looking up is linear, so one graph serves to transpose it for any residual.
        with torch.enable_grad():
            self._zero = torch.zeros(1, 3, self.count * self.size, self.size, dtype=self.grid.dtype, requires_grad=True)
            self._found = look_up(self._zero, *fixed)

    def apply(self, images: Tensor) -> Tensor:
        """Return the values [3, P] of pictures [1, 3, n S, S]."""
        return look_up(images, self.grid.detach(), self.share.detach())

    def transpose(self, values: Tensor) -> Tensor:
        """Return the pictures [1, 3, n S, S] that values [3, P] add up to, each spread on the texels it came from."""
        return torch.autograd.grad(self._found, self._zero, values, retain_graph=True)[0]


def look_up(images: Tensor, grid: Tensor, share: Tensor) -> Tensor:
    """Return the blended values [3, P] of pictures [1, 3, n S, S] at `grid` [2, 1, P, 2]."""
    found = functional.grid_sample(
        images.expand(2, -1, -1, -1), grid, mode="bilinear", padding_mode="border", align_corners=False
    )[:, :, 0]
    return torch.lerp(found[0], found[1], share)


def dot(one: Tensor, other: Tensor) -> Tensor:
    """Return the sum of products, of the same bits whatever the number of threads."""
    with one_thread():
        return (one * other).sum()


class SphereProblem:
    """Points with true values [3, P] and weights [P], to be met by pictures of `size` texels."""

    def __init__(self, light: Tensor, view: Tensor, value: Tensor, weight: Tensor, size: int) -> None:
        place = place_on_sphere(light, view)
        self.place = type(place)(*(plane.expand_as(place.angle).reshape(-1) for plane in place))
        self.value, self.weight, self.size = value, weight, size
        self.sine = sine_to_half(self.place)

    def black(self, count: int) -> Tensor:
        """Return `count` black pictures, [1, 3, n S, S]."""
        return self.value.new_zeros(1, 3, count * self.size, self.size)

    def look(self, shape: Shape, differentiable: bool = False) -> LookedUp:
        """Return the look-ups for a shape."""
        near = find_neighbours(self.place.angle, shape.angles.tolist())
        k = find_turns(shape.turn, self.sine, near.lower).expand(2, -1)
        angle = shape.angles[near.number.long()]
        with torch.set_grad_enabled(differentiable):
            if differentiable:
                k, angle = k.clone().requires_grad_(), angle.clone().requires_grad_()
            look_ups = find_look_ups(self.place, near._replace(angle=angle), k)
            grid = atlas_grid(look_ups, len(shape.angles), self.size)[:, None]
        return LookedUp(near, k, angle, grid, look_ups.share, len(shape.angles), self.size)

    def system(self, looked_up: LookedUp, smoothness: float = _SMOOTHNESS, fade: float = 0.0) -> PictureSystem:
        """Return the normal equations of the pictures."""
        return PictureSystem(looked_up, self.weight, smoothness, fade)

    def error(self, looked_up: LookedUp, images: Tensor) -> float:
        """Return the weighted sum of squared errors."""
        return float(dot(self.weight * (looked_up.apply(images) - self.value), looked_up.apply(images) - self.value))

    def solve(
        self, looked_up: LookedUp, images: Tensor, steps: int, smoothness: float = _SMOOTHNESS, fade: float = 0.0
    ) -> Tensor:
        """Return the pictures after at most `steps` of conjugate gradients from `images`; the rest as in `PictureSystem`.

        Each step lowers the squared error, so the last pictures are the best. It ends where the rest is rounding, or
        where a direction has no curvature: there the numbers of the precision are used up, and a step would undo others.
        """
        system = self.system(looked_up, smoothness, fade)
        wanted = looked_up.transpose(self.weight * self.value)
        rest = wanted - system.apply(images)
        way = ahead = system.precondition(rest)
        size, enough = dot(rest, ahead), float(dot(wanted, system.precondition(wanted))) * torch.finfo(rest.dtype).eps ** 2
        for _ in range(steps):
            if not float(size) > enough:
                break
            curved = system.apply(way)
            curvature = dot(way, curved)
            if not 0 < float(curvature) < math.inf:
                break
            step = size / curvature
            images, rest = images + step * way, rest - step * curved
            ahead = system.precondition(rest)
            size, before = dot(rest, ahead), size
            way = ahead + (size / before) * way
        return images


class PictureSystem:
    """Normal equations of the pictures: squared errors, and squared differences between neighbouring texels.

    `smoothness` is what a squared difference costs, relative to what a typical texel is seen; it settles texels that no
    point sees. With `fade` > 0 these tend to 0 over 1 / fade texels. A normal matrix without negative entries is at
    most the diagonal of its row sums, which one transposed look-up gives: that is the preconditioner.
    """

    def __init__(self, looked_up: LookedUp, weight: Tensor, smoothness: float, fade: float) -> None:
        self.looked_up, self.weight, self.fade = looked_up, weight, fade
        seen = looked_up.transpose(weight.expand(3, -1))
        positive = seen[:, :1][seen[:, :1] > 0]
        self.smoothness = smoothness * float(positive.median()) if len(positive) else 1.0
        self.diagonal = seen + (8 + fade**2) * self.smoothness

    def apply(self, images: Tensor) -> Tensor:
        """Return the matrix times pictures."""
        return self.looked_up.transpose(self.weight * self.looked_up.apply(images)) + self.rough(images)

    def rough(self, images: Tensor) -> Tensor:
        """Return the smoothness part alone."""
        parts = images.unflatten(2, (self.looked_up.count, self.looked_up.size))
        total = parts * (self.smoothness * self.fade**2)
        for dim in (-1, -2):
            step = torch.diff(parts, dim=dim) * self.smoothness
            length = parts.shape[dim] - 1
            total.narrow(dim, 1, length).add_(step)
            total.narrow(dim, 0, length).sub_(step)
        return total.reshape(images.shape)

    def precondition(self, images: Tensor) -> Tensor:
        """Return pictures divided by the diagonal."""
        return images / self.diagonal
