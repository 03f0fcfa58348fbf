"""Lamps from shading alone: near ones from the board's paper, far ones, which light it evenly, from the sample's own relief."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchmat.capturing.develop import exposure_of
from torchmat.capturing.evenness import Vignetting, fit_courses, vignetting_terms
from torchmat.capturing.light import Light
from torchmat.capturing.observe import CELLS, FINE, Observed, Places
from torchmat.capturing.relief import FEWEST, NotTold, Shown, lamps_of_relief
from torchmat.capturing.scene import Scene
from torchmat.capturing.shading import lamps_of_shading

_LEAST_PAPER = 50  # points
_STEEP = 0.002  # per mm of the paper's logarithm: lamps that make it so are within a metre, and no far ones


def lights_of_shading(
    scene: Scene, places: Places, observed: Sequence[Observed], known: Vignetting | None
) -> tuple[list[Light | None], list[str]]:
    """Return the lamp of each photograph, and why it has none ("" where it has).

    Paper tells near lamps. Of the photographs whose paper is lit too evenly for that, if there are at least 8, the sample's relief tells far ones.

    Args:
        scene: photographs with their cameras and poses.
        places: where they were read, the sample too (`places_of`).
        observed: what they show.
        known: vignetting from a flat field; None finds it on the paper.
    """
    names = [one.name for one in scene.photographs]
    goods = [one.paper.good for one in observed]
    pixels = [one.paper.pixels[good] for one, good in zip(observed, goods, strict=True)]
    values = [one.paper.values[good] for one, good in zip(observed, goods, strict=True)]
    points = [places.paper[good] for good in goods]
    even = [np.ones(len(pixel)) if known is None else known.at(pixel) for pixel in pixels]
    size = scene.cameras[0].size
    terms = [vignetting_terms(size, pixel, True) if known is None else np.zeros((len(pixel), 0)) for pixel in pixels]
    lights, faults = lamps_of_shading(names, points, [value.mean(1) / by for value, by in zip(values, even, strict=True)], terms)
    far = [index for index, light in enumerate(lights) if light is None and len(points[index]) >= _LEAST_PAPER]
    if not far:
        return lights, faults
    place, pixel, value = ([column[index] for index in far] for column in (points, pixels, values))
    courses, vignetting, _ = fit_courses(size, place, pixel, value, [np.ones(len(one)) for one in place], known)
    some = [number for number, course in enumerate(courses) if np.hypot(*course.slope) < _STEEP]
    far, courses = [far[number] for number in some], [courses[number] for number in some]
    try:
        if len(far) < FEWEST:
            raise NotTold(f"{len(far)} photographs are of far lamps, and it takes {FEWEST}")
        left, bottom, right, top = scene.board.window
        found = lamps_of_relief(_shown(scene, places, observed, far, courses, vignetting), max(right - left, top - bottom) / 2)
    except NotTold as error:
        for index in far:
            faults[index] += f" The sample's relief tells no far lamp either: {error}."
        return lights, faults
    for index, light in zip(far, found, strict=True):
        lights[index], faults[index] = light, ""
    return lights, faults


def _shown(scene: Scene, places: Places, observed: Sequence[Observed], far: Sequence[int], courses, vignetting: Vignetting | None) -> Shown:
    """Return what photographs, by their numbers, show of the sample over white paper, in square cells."""
    values, good = [], []
    for index, course in zip(far, courses, strict=True):
        sample = observed[index].sample
        paper = course.at(places.sample) * (1.0 if vignetting is None else vignetting.at(sample.pixels))
        ratio = sample.values / (paper[:, None] * course.level)
        values.append(np.moveaxis(ratio.reshape(CELLS, FINE, CELLS, FINE, 3).mean((1, 3)), -1, 0))
        good.append(sample.good.reshape(CELLS, FINE, CELLS, FINE).all((1, 3)))
    exposures = [exposure_of(scene.photographs[index].exif) for index in far]
    said = np.array([1.0 if None in exposures else float(one or 1) for one in exposures])
    level = np.array([course.level.mean() for course in courses]) / said
    views = np.stack([scene.poses[index].position for index in far])
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    return Shown(np.stack(values), np.stack(good), level, np.stack([course.slope for course in courses]), views)
