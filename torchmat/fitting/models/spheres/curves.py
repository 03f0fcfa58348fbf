"""Sphere images against values: what is not linear, the curves k and the angles of the pictures.

That is a few hundred numbers beside many thousand texels: Gauss-Newton moves both together, on the linearised sum.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.fitting.models.spheres.problem import LookedUp, PictureSystem, Shape, SphereProblem, dot, look_up
from torchmat.models.sphere_geometry import find_knots
from torchmat.repeatable import one_thread

_DAMPING, _MOST_DAMPING = 1e-3, 1e3
_BEND, _STAY = 1e-2, 1e-1  # costs of the squared second derivative, and of leaving the start by 1, over the sine


class CurvePrior(NamedTuple):
    """A quadratic cost, `matrix` [Q, Q], of bent curves, and of leaving `start` [Q] where the data says nothing."""

    matrix: Tensor
    start: Tensor


def curve_prior(turn: Tensor, bend: bool, others: int) -> CurvePrior:
    """Return the prior of a table [1, rows, K] that may `bend`, and of `others` numbers that have none."""
    rows, count = turn.shape[1:] if bend else (0, 1)
    step = 2 / max(count - 1, 1)
    block = _STAY * step * torch.eye(count, dtype=turn.dtype)
    if count > 2:
        second = torch.diff(torch.eye(count, dtype=turn.dtype), n=2, dim=0) / step**2
        block += _BEND * step * second.T @ second
    matrix = torch.block_diag(*[block] * rows, torch.zeros(others, others, dtype=turn.dtype))
    return CurvePrior(matrix, functional.pad(turn.flatten()[: rows * count], (0, others)))


class Derivative:
    """Derivative of all values by the curves' samples and the pictures' angles (but the first): at most six a point.

    Held as `index` [6, P] and `part` [6, 3, P], already times the root of the weight. `bend` False leaves the curves
    out, `place` False the angles.
    """

    def __init__(
        self, problem: SphereProblem, looked_up: LookedUp, images: Tensor, shape: Shape, bend: bool, place: bool
    ) -> None:
        rows, count = shape.turn.shape[1:]
        self.knots, self.others = rows * count if bend else 0, len(shape.angles) - 1 if place else 0
        with torch.enable_grad():
            found = look_up(images, looked_up.grid, looked_up.share)
            wanted = [torch.autograd.grad(c.sum(), (looked_up.k, looked_up.angle), retain_graph=True) for c in found]
        self.value, root = found.detach(), problem.weight.sqrt()
        by_k, by_angle = (torch.stack(parts, dim=1) * root for parts in zip(*wanted, strict=True))  # [2, 3, P]
        starts, share = find_knots((rows, count), problem.sine, looked_up.near.lower)
        starts = starts * (2 // len(starts))
        index, part, after = [], [], min(1, count - 1)
        for side in (0, 1):
            if bend:
                index += [starts[side].long(), starts[side].long() + after]
                part += [by_k[side] * (1 - share), by_k[side] * share]
            if place:
                number = looked_up.near.number[side].long()
                index.append(torch.where(number == 0, self.total, self.knots + number - 1))
                part.append(by_angle[side])
        self.index, self.part = torch.stack(index), torch.stack(part)

    @property
    def total(self) -> int:
        """Number of unknowns; the index past them takes what the first picture's angle would."""
        return self.knots + self.others

    def apply(self, step: Tensor) -> Tensor:
        """Return the change [3, P] of the weighted values for a step [Q]."""
        padded = functional.pad(step, (0, 1))
        total = torch.zeros_like(self.value)
        for index, part in zip(self.index, self.part, strict=True):
            total.addcmul_(part, padded[index])
        return total

    def transpose(self, values: Tensor) -> Tensor:
        """Return [Q] of weighted values [3, P]."""
        with one_thread():
            total = values.new_zeros(self.total + 1)
            for index, part in zip(self.index, self.part, strict=True):
                total.scatter_add_(0, index, (part * values).sum(dim=0))
            return total[: self.total]

    def normal(self) -> Tensor:
        """Return the matrix [Q, Q] of products, in float64."""
        size = self.total + 1
        total = torch.zeros(size * size, dtype=torch.float64)
        with one_thread():
            for index, part in zip(self.index, self.part, strict=True):
                for other, second in zip(self.index, self.part, strict=True):
                    total.scatter_add_(0, index * size + other, (part * second).sum(dim=0).double())
        return total.reshape(size, size)[: self.total, : self.total]


@dataclass
class SphereState:
    """Where Gauss-Newton stands."""

    shape: Shape
    images: Tensor
    error: float
    damping: float = _DAMPING


class GaussNewton:
    """Steps of pictures, curves and angles together (Levenberg's damping, on curves and angles alone).

    `start` is the shape that the curves' prior is about; it is weighed by the error, as a noise of that size would be.
    `bend` and `place` say whether curves and angles move, `closest` how near to each other angles may come.
    """

    def __init__(self, problem: SphereProblem, start: Shape, bend: bool, place: bool, closest: float) -> None:
        self.problem, self.bend, self.place, self.closest = problem, bend, place, closest
        self.prior = curve_prior(start.turn, bend, len(start.angles) - 1 if place else 0)

    def begin(self, shape: Shape, images: Tensor, steps: int = 60) -> SphereState:
        """Return the state with the best pictures for a shape."""
        looked_up = self.problem.look(shape)
        images = self.problem.solve(looked_up, images, steps)
        return SphereState(shape, images, self.problem.error(looked_up, images))

    def step(self, state: SphereState, inner: int = 40) -> SphereState | None:
        """Return a better state, or None when no step is."""
        looked_up = self.problem.look(state.shape, differentiable=True)
        derivative = Derivative(self.problem, looked_up, state.images, state.shape, self.bend, self.place)
        damping = state.damping
        while damping <= _MOST_DAMPING:
            images, move = self._direction(state, looked_up, derivative, damping, inner)
            shape = self._moved(state.shape, move)
            if shape is not None:
                found = self.begin(shape, images, 10)
                if found.error < state.error:
                    found.damping = max(damping * 0.3, 1e-7)
                    return found
            damping = max(10 * damping, 1e-2)
        return None

    def _moved(self, shape: Shape, move: Tensor) -> Shape | None:
        knots = shape.turn.numel() if self.bend else 0
        turn = shape.turn + move[:knots].reshape(shape.turn.shape) if knots else shape.turn
        if not self.place:
            return Shape(shape.angles, turn)
        angles = shape.angles + functional.pad(move[knots:], (1, 0))
        allowed = bool((torch.diff(angles) >= self.closest).all()) and float(angles[-1]) <= math.pi + 1e-6
        return Shape(angles, turn) if allowed else None

    def _direction(
        self, state: SphereState, looked_up: LookedUp, derivative: Derivative, damping: float, inner: int
    ) -> tuple[Tensor, Tensor]:
        """Return the pictures and the move of the rest that the linearised problem asks for.

        The curves and angles are solved for in coordinates in which their own normal matrix is the identity, so that
        conjugate gradients need no more steps with them than without.
        """
        problem, system = self.problem, self.problem.system(looked_up)
        root, dtype = problem.weight.sqrt(), state.images.dtype
        prior = self.prior.matrix.double() * state.error
        normal = derivative.normal()
        prior = prior + (1e-7 * normal.diagonal().max() + 1e-30) * torch.eye(len(normal), dtype=torch.float64)
        with one_thread():
            upper = torch.linalg.cholesky(normal + prior).T
            back = torch.linalg.inv(upper)
        curves = state.shape.turn.flatten()[: derivative.knots]
        away = functional.pad(curves, (0, derivative.others)) - self.prior.start
        pull = (back.T @ (state.error * self.prior.matrix.double() @ away.double())).to(dtype)
        prior, back = (back.T @ prior @ back).to(dtype), back.to(dtype)
        rest = root * (problem.value - derivative.value)

        def apply(images: Tensor, move: Tensor) -> tuple[Tensor, Tensor]:
            change = root * looked_up.apply(images) + derivative.apply(back @ move)
            own = back.T @ derivative.transpose(change) + prior @ move + damping * move
            return looked_up.transpose(root * change) + system.rough(images), own

        downhill = looked_up.transpose(root * rest) - system.rough(state.images)
        right = downhill, back.T @ derivative.transpose(rest) - pull
        images, move = _conjugate_gradients(apply, right, system, 1 + damping, inner)
        return state.images + images, back @ move


def _conjugate_gradients(
    apply: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]], right: tuple[Tensor, Tensor], system: PictureSystem,
    scale: float, steps: int,
) -> tuple[Tensor, Tensor]:
    """Solve for pictures and moves together, from 0."""
    rest_images, rest_move = right
    images, move = torch.zeros_like(rest_images), torch.zeros_like(rest_move)
    way_images, way_move = system.precondition(rest_images), rest_move / scale
    size = dot(rest_images, way_images) + dot(rest_move, way_move)
    for _ in range(steps):
        if not float(size) > 0:
            break
        curved_images, curved_move = apply(way_images, way_move)
        step = size / (dot(way_images, curved_images) + dot(way_move, curved_move))
        images, move = images + step * way_images, move + step * way_move
        rest_images, rest_move = rest_images - step * curved_images, rest_move - step * curved_move
        ahead_images, ahead_move = system.precondition(rest_images), rest_move / scale
        size, before = dot(rest_images, ahead_images) + dot(rest_move, ahead_move), size
        way_images = ahead_images + (size / before) * way_images
        way_move = ahead_move + (size / before) * way_move
    return images, move
