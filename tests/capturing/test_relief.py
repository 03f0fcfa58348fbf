"""Far lamps from the shading of a sample's relief: the directions, what they are said to be known to, and what tells none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from tests.capturing.shots import Lamp, Lens, shots_around
from tests.capturing.swatch import Swatch, leather

from torchmat.capturing.board import Board
from torchmat.capturing.observe import CELLS, FINE, Observed, places_of
from torchmat.capturing.paper import Reading
from torchmat.capturing.photographs import Photograph
from torchmat.capturing.relief import NotTold, Shown, lamps_of_relief
from torchmat.capturing.scene import Scene
from torchmat.capturing.shading_lights import lights_of_shading
from torchmat.capturing.view import Camera, Pose
from torchmat.images import Exif

COUNT, SIDE = 12, 64
SWATCH = leather(2 * SIDE, 14)
MATTE = Swatch(SWATCH.normal, SWATCH.albedo.mean(0, keepdim=True).expand(3, -1, -1) * 2)
POLAR, TURN = np.radians(8 + 47 * ((np.arange(COUNT) * 7) % COUNT + 0.5) / COUNT), np.radians(222.5 * np.arange(COUNT))
LAMPS = np.stack((np.sin(POLAR) * np.cos(TURN), np.sin(POLAR) * np.sin(TURN), np.cos(POLAR)), axis=1)
STRENGTH = 1 + 0.06 * np.random.default_rng(1).uniform(-1, 1, COUNT)
SHOTS = shots_around([20 + 3 * i for i in range(COUNT)], [137.5 * i for i in range(COUNT)], 430, [Lamp((0, 0, 1))] * COUNT)


def shaded(swatch, light, view, gloss=True):
    """What the swatch shows over white paper [3, SIDE, SIDE] under a far lamp."""
    planes = [torch.tensor(one).float()[:, None, None].expand(3, 2 * SIDE, 2 * SIDE) for one in (light, view)]
    values = swatch(*planes) if gloss else swatch.albedo * (swatch.normal * planes[0]).sum(0).clamp(min=0)
    return torch.nn.functional.avg_pool2d(values, 2).numpy() / (0.9 * light[2])


def shown(swatch=SWATCH, gloss=True, distance=np.inf, strength=STRENGTH, noise=0.01):
    random = np.random.default_rng(0)
    views = np.array([shot.position for shot in SHOTS]) / 430
    values = np.stack([shaded(swatch, light, view, gloss) for light, view in zip(LAMPS, views, strict=True)])
    values *= 1 + noise * random.standard_normal(values.shape)
    slope = 3 * LAMPS[:, :2] / distance + 5e-5 * random.standard_normal((COUNT, 2))
    return Shown(values, np.ones((COUNT, SIDE, SIDE), bool), strength * LAMPS[:, 2], slope, views)


def errors(lights):
    found = np.stack([light.direction for light in lights])
    return np.degrees(np.arccos(np.clip((found * LAMPS).sum(1), -1, 1)))


@pytest.mark.parametrize(
    "case", [shown(), shown(MATTE, gloss=False, distance=4000.0)], ids=["gloss says which side lamps are on", "the paper does"],
)
def test_lamps_are_right_within_what_is_said(case):
    lights = lamps_of_relief(case, 55)
    off, said = errors(lights), np.array([light.sigma_deg for light in lights])
    assert np.sqrt((off**2).mean()) < 3 and (off < 2 * said).all() and (said < 8).all()
    assert all(light.position is None and "estimate" in light.how and light.residual < 0.15 for light in lights)


@pytest.mark.parametrize(
    ("case", "why"),
    [(shown(MATTE, gloss=False), "do not tell whether the relief rises or sinks"),
     (shown(Swatch(torch.tensor([0, 0, 1.0])[:, None, None].expand(3, 2 * SIDE, 2 * SIDE), MATTE.albedo), gloss=False, distance=4000.0), "directions stay open by|lamps differ|rises or sinks"),
     (shown(strength=STRENGTH * np.tile([1.0, 1.6], COUNT // 2)), "the lamps differ by"),
     (shown(MATTE, distance=4000.0), "gloss|lamps differ|stay open")],
    ids=["matte, and paper says nothing", "flat", "lamps of two strengths", "gloss as grey as the rest"],
)
def test_what_tells_no_lamps_is_named(case, why):
    with pytest.raises(NotTold, match=why):
        lamps_of_relief(case, 55)


def scene(tmp_path, lights, exposures):
    board, lens = Board(spheres=0), Lens((1500, 1000), 1600.0)
    camera = Camera(lens.matrix, np.zeros(5), lens.size)
    photographs = tuple(
        Photograph(tmp_path / f"{n}.jpg", lens.size, 0, Exif(lens.size, 1, "", None, None, exposure, None, None), lambda: None) for n, exposure in enumerate(exposures)
    )
    found = Scene(board, photographs, (camera,) * COUNT, tuple(Pose(shot.rotation, shot.translation) for shot in SHOTS))
    places = places_of(found, sample=True)
    observed = []
    for pose, light, view, strength, exposure in zip(found.poses, lights, shown().view, STRENGTH, exposures, strict=True):
        readings = []
        for points, every in zip(places, (25, 1, 1, 1), strict=True):
            pixels = pose.project(camera, points)
            readings.append(Reading(np.full((len(points), 3), 0.9 * strength * exposure * light[2]), np.arange(len(points)) % every == 0, pixels))
        cells = np.repeat(np.repeat(shaded(SWATCH, light, view), CELLS // SIDE * FINE, axis=1), CELLS // SIDE * FINE, axis=2)
        readings[3] = readings[3]._replace(values=cells.reshape(3, -1).T * 0.9 * strength * exposure * light[2])
        observed.append(Observed(*readings, (), (), ()))
    return found, places, observed


def test_paper_that_is_lit_evenly_leaves_it_to_the_sample_at_the_exposures_of_the_files(tmp_path):
    found, places, observed = scene(tmp_path, LAMPS, np.tile([0.01, 0.02, 0.04], COUNT // 3))
    lights, faults = lights_of_shading(found, places, observed, None)
    assert faults == [""] * COUNT and errors(lights).max() < 5
    few = [dataclasses.replace(one, paper=one.paper._replace(good=one.paper.good & (number < 5))) for number, one in enumerate(observed)]
    lights, faults = lights_of_shading(found, places, few, None)
    assert lights == [None] * COUNT and "5 photographs are of far lamps, and it takes 8" in faults[0] and "at least 50 points" in faults[-1]
