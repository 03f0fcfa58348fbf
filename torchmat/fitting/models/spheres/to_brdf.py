"""Fit of sphere images: to a BRDF at all lights, and to the mean reflectance of a BTF."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import FitError, RangeError, check_option, message
from torchmat.fitting.models.spheres.curves import GaussNewton, SphereState
from torchmat.fitting.models.spheres.points import sphere_errors, sphere_points, unseen_lights
from torchmat.fitting.models.spheres.problem import Shape, SphereProblem
from torchmat.fitting.training import Fitted
from torchmat.models.sphere_images import (
    LARGEST_TURN, PAPER_ANGLES_DEG, SphereImages, below_each_other, check_isotropic, checked_angles, render_spheres,
)
from torchmat.progress import in_command, phase, progress
from torchmat.solvers.stop_reasons import CONVERGED, STEP_LIMIT

CURVES = ("each", "one", "paper")
_COARSEST, _SHARP = 64, 0.015  # texels across, and the error above which they are too few for the highlight
_MOST_POINTS = 131_072
_CLOSEST_DEG = 3.0


def fit_sphere_images(
    brdf: Any, angles_deg: Sequence[float] = PAPER_ANGLES_DEG, size: int = 256, *, curves: str = "each",
    samples: int = 33, place: bool = True, lights: int = 27, coarse: int | None = None, steps: int = 8, seed: int = 0,
    storage: str = "half",
) -> Fitted:
    """Return the sphere images that meet a `Brdf` best at all lights from 0 to the last of `angles_deg`.

    The paper renders the pictures at their own lights and takes what blending gives between them. Here pictures of
    `size` texels, the curves k and, with `place`, the angles of the pictures are what makes the relative error least,
    averaged over `lights` whole spheres at lights in between. `curves` "each" has a curve of `samples` for either
    side of each interval, "one" a common one, "paper" keeps the paper's. Pictures are solved for in closed form; curves
    and angles take up to `steps` of Gauss-Newton on smaller pictures: of `coarse` texels, by default the least of 64,
    128, ... and `size` that show the highlight, so that its shape is judged and not the texels'. Angles keep 3 degrees
    between them, or what the closest of `angles_deg` have.
    """
    check_option("fit_sphere_images", "curves", curves, CURVES)
    _check_numbers(size=size, samples=samples, lights=lights, coarse=coarse or 1)
    check_isotropic("fit_sphere_images", brdf)
    start, angles = time.perf_counter(), checked_angles("fit_sphere_images", angles_deg)
    if len(angles) < 2:
        step = "One picture has nothing in between; use SphereImages.from_brdf."
        raise RangeError(message("fit_sphere_images", "angles_deg", "hold at least 2", f"they are {len(angles)}", step))
    shape = Shape(torch.tensor(angles, dtype=brdf.dtype), _start_turn(curves, samples, len(angles), brdf.dtype))
    seen = [(number + 0.5) * math.degrees(angles[-1]) / lights for number in range(lights)]
    reason = CONVERGED
    history: list[tuple[float, float]] = []
    with torch.no_grad():
        if curves != "paper" or place:
            with phase("finding where the highlights lie"):
                solver, state = _begin(brdf, shape, seen, size, coarse, (curves != "paper", place), seed)
            shape, reason, history = _fit_shape(solver, state, steps)
            history = [(seconds - start, error / lights) for seconds, error in history]
        with phase("fitting the pictures"):
            images, error = _fit_pictures(brdf, shape, seen, size, seed)
    history.append((time.perf_counter() - start, error / lights))
    material = _material(images, shape, storage)
    figures = {"angles_deg": material.options["angles_deg"], "error_at_fitted_lights": error / lights}
    return Fitted(material, reason, None, figures, history=history)


def fewest_angles(
    brdf: Any, error: float, size: int = 256, *, most: int = 8, last_deg: float = 135.0, **options: Any
) -> Fitted:
    """Return fitted sphere images of the fewest pictures whose relative error at unseen lights is at most `error`.

    From 2 to `most` pictures, evenly from 0 to `last_deg` at the start; measured after export, as the mean over 16 or
    more lights that no fit has seen (those next to a picture's own left out). `options` are those of `fit_sphere_images`. The figures list what each number reached.
    Raises FitError, with the best error, when `most` are not enough.
    """
    if not 0 < error < math.inf or not 2 <= most:
        fact = f"they are {error} and {most}"
        raise RangeError(message("fewest_angles", "error and most", "be positive, and at least 2", fact))
    # Middles of an even and of an odd number of parts never coincide, nor do those of a number of parts and its double.
    fitted_lights = options.get("lights", 27)
    probes = 16 if fitted_lights % 2 else 2 * fitted_lights
    reached: dict[int, float] = {}
    for count in range(2, most + 1):
        angles = [number * last_deg / (count - 1) for number in range(count)]
        fitted = fit_sphere_images(brdf, angles, size, **options)
        lights = unseen_lights(fitted.material.options["angles_deg"], probes, last_deg)
        errors = sphere_errors(fitted.material.as_exported().to(brdf.dtype), brdf, lights)
        reached[count] = sum(errors) / len(errors)
        if reached[count] <= error:
            return replace(fitted, figures={**fitted.figures, "error_at_unseen_lights": reached})
    best = min(reached, key=reached.__getitem__)
    fact = f"the least is {reached[best]:.3g}, of {best} pictures of {size} x {size}"
    step = "Allow a larger error, more pictures or a larger size."
    requirement = f"come down to {error} with at most {most} pictures"
    raise FitError(message("fewest_angles", "the error", requirement, fact, step))


def _check_numbers(**numbers: int) -> None:
    for name, number in numbers.items():
        if not isinstance(number, int) or isinstance(number, bool) or number < 1:
            raise RangeError(message("fit_sphere_images", name, "be a whole number of at least 1", f"it is {number!r}"))


def _start_turn(curves: str, samples: int, count: int, dtype: torch.dtype) -> Tensor:
    """Return the paper's k as a table of the shape that is fitted."""
    if curves == "paper":
        samples = 3
    places = torch.linspace(-1, 1, samples, dtype=dtype) if samples > 1 else torch.zeros(1, dtype=dtype)
    return (0.5 + 0.5 * places.abs()).expand(1, 2 * (count - 1) if curves == "each" else 1, -1).clone()


def _problem(brdf: Any, seen: Sequence[float], size: int, seed: int) -> SphereProblem:
    # One point a texel of each sphere; with half of that the felt's pictures fit the points and not what lies between.
    points = sphere_points(brdf, seen, min(max(1500, size * size), _MOST_POINTS), seed)
    return SphereProblem(points.light, points.view, points.value, points.weight, size)


def _begin(
    brdf: Any, shape: Shape, seen: Sequence[float], size: int, coarse: int | None, free: tuple[bool, bool], seed: int
) -> tuple[GaussNewton, SphereState]:
    """Return a solver and its start on pictures of `coarse` texels, or of as many as the start's error asks for."""
    trial = min(size, coarse or _COARSEST)
    while True:
        problem = _problem(brdf, seen, trial, seed)
        closest = min(math.radians(_CLOSEST_DEG), float(shape.angles.diff().min()) * (1 - 1e-5))
        solver = GaussNewton(problem, shape, *free, closest)
        state = solver.begin(shape, problem.black(len(shape.angles)))
        if coarse or trial == size or state.error <= _SHARP * len(seen):
            return solver, state
        trial = min(size, 2 * trial)


def _fit_shape(
    solver: GaussNewton, state: SphereState, steps: int
) -> tuple[Shape, str, list[tuple[float, float]]]:
    """Return the shape after up to `steps`, why they stopped, and (time, error) after each."""
    history = [(time.perf_counter(), state.error)]
    for _ in progress(range(steps), "fitting curves and angles", show=in_command()):
        found = solver.step(state)
        if found is None:
            return state.shape, CONVERGED, history
        gain, state = 1 - found.error / state.error, found
        history.append((time.perf_counter(), state.error))
        if gain < 3e-3:
            return state.shape, CONVERGED, history
    return state.shape, STEP_LIMIT, history


def _fit_pictures(brdf: Any, shape: Shape, seen: Sequence[float], size: int, seed: int) -> tuple[Tensor, float]:
    problem = _problem(brdf, seen, size, seed + 1)
    looked_up = problem.look(shape)
    start = below_each_other(render_spheres(brdf, torch.rad2deg(shape.angles).tolist(), size))
    images = problem.solve(looked_up, start, 40).clamp(min=0)
    return images, problem.error(looked_up, images)


def _material(images: Tensor, shape: Shape, storage: str) -> SphereImages:
    count = len(shape.angles)
    angles = [round(math.degrees(angle), 2) for angle in shape.angles.tolist()]
    maps = {
        "images": images[0].unflatten(1, (count, -1)).transpose(0, 1).flatten(0, 1).contiguous(),
        "turn": shape.turn.clamp(-LARGEST_TURN, LARGEST_TURN), "tint": images.new_ones(3, 1, 1),
    }
    return SphereImages(maps, angles_deg=angles, storage=storage)
