"""The lamps of a scene from its mirror spheres: where the spheres stand, and what each photograph's highlights say."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from torchmat.capturing.light import Light
from torchmat.capturing.observe import Observed
from torchmat.capturing.outline import Standing, common_centre, outline
from torchmat.capturing.scene import Scene
from torchmat.capturing.spheres import find_highlight, lamp_of_rays, lamp_ray
from torchmat.errors import DataError, message


_MANY = 0.3  # of the photographs, whose spheres do not go together: it is not they that are at fault


class SphereLights(NamedTuple):
    """The `lights` [n] of photographs, None where a `fault` [n] says why not ("" for none); where the spheres stand; the
    `highlights` [n, spheres, 2] in pixels, NaN where none was found; and `notes`."""

    lights: list[Light | None]
    faults: list[str]
    standing: list[Standing]
    highlights: np.ndarray
    notes: list[str]


def lights_of_spheres(scene: Scene, observed: Sequence[Observed]) -> SphereLights:
    """Return the lamp of each photograph from the highlights on the board's mirror spheres.

    A photograph on which only one of two spheres can be used has a direction alone, and says so.
    """
    board = scene.board
    standing = [common_centre([one.placed[number] for one in observed], centre) for number, centre in enumerate(board.sphere_centres)]
    notes = _standing_notes(scene, standing)
    lights: list[Light | None] = []
    faults: list[str] = []
    highlights = np.full((len(observed), len(standing), 2), np.nan)
    for index in range(len(observed)):
        name = scene.photographs[index].name
        rays, wrong = [], []
        for number, one in enumerate(standing):
            try:
                highlight, ray = _ray(scene, observed[index], index, number, one)
            except DataError as error:
                wrong.append(str(error))
                continue
            highlights[index, number] = highlight
            rays.append(ray)
        light, fault = None, wrong[0] if wrong else ""
        if rays:
            try:
                light, fault = lamp_of_rays(name, rays), ""
                notes += [f"{name}: {note}" for note in light.notes] + [f"{one} (the other sphere tells the lamp)" for one in wrong]
            except DataError as error:
                fault = str(error)
        lights.append(light)
        faults.append(fault)
    odd = sum(light is not None and bool(light.notes) for light in lights)
    if odd > _MANY * len(lights):
        notes.insert(0, f"in {odd} of {len(lights)} photographs the two spheres do not go together: check the spheres' --diameter, the board's --size, and the length of its scale bar (--measured)")
    return SphereLights(lights, faults, standing, highlights, notes)


def _ray(scene: Scene, observed: Observed, index: int, number: int, standing: Standing):
    """Return a highlight's pixel and the ray that it reflects; raises DataError, which names the photograph."""
    where = f"{scene.photographs[index].name}: sphere {number + 1}"
    cutout = observed.spheres[number]
    if cutout is None:
        step = "Photograph all of the board, or give the lights."
        raise DataError(message(where, "the sphere", "lie in the photograph", "it is outside", step))
    camera, pose, radius = scene.cameras[index], scene.poses[index], scene.board.diameter / 2
    around = outline(camera, pose, standing.centre, radius)
    found = find_highlight(where, cutout.linear, cutout.clipped, around - cutout.corner)
    found = found._replace(pixel=found.pixel + cutout.corner)
    return found.pixel, lamp_ray(camera, pose, standing.centre, radius, found, standing.sigma)


def _standing_notes(scene: Scene, standing: Sequence[Standing]) -> list[str]:
    notes = []
    for number, (one, meant) in enumerate(zip(standing, scene.board.sphere_centres, strict=True), 1):
        if one.moved:
            away = one.centre - meant
            notes.append(
                f"sphere {number} stands {np.hypot(*away[:2]):.1f} mm beside its ring (x {away[0]:+.2f}, y {away[1]:+.2f} mm, give or take {one.sigma:.2f}): its own place is taken"
            )
        if len(one.elsewhere) > 0.2 * len(scene.photographs):
            names = ", ".join(scene.photographs[index].name for index in one.elsewhere[:4])
            notes.append(f"sphere {number} seems to stand elsewhere in {len(one.elsewhere)} photographs ({names} ...): was it pushed?")
    return notes
