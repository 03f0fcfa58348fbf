"""Light and colour of a whole scene, from photographs of the simulated studio under vignetting, colour, uneven light and noise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from tests.capturing.shots import beside_lens
from tests.capturing.simulated import Lamp, Lens, Studio, matte_grey, shots_around, write

import torchmat as tm
from torchmat.capturing.board import Board
from torchmat.capturing.capture import capture
from torchmat.capturing.photographs import photograph
from torchmat.capturing.photometry import PhotometryOptions, photometry
from torchmat.capturing.scene import Scene
from torchmat.capturing.view import Camera, Pose
from torchmat.errors import FitError, RangeError

LENS = Lens(size=(840, 560), focal=940.0)
STUDIO = Studio(matte_grey(0.4), Board(diameter=40.0), LENS, texels=(8, 8), vignetting=0.25, gains=(0.8, 1.0, 0.6), full_well=20000.0, blur=0.6)
LAMPS = [
    Lamp((-220, 120, 420), (1.0, 0.95, 0.8), gradient=(0.2, -0.1)), Lamp((150, 260, 350), (0.8, 0.76, 0.64)), Lamp((40, -300, 380), (1.1, 1.0, 0.7)),
    Lamp((-60, 30, 480), (1.05, 1.0, 0.85)),
]
SHOTS = shots_around([5, 30, 45, 35], [40, 120, 210, 300], 560, LAMPS, exposure=0.75)


def scene_of(folder, studio, taken, suffix=".png"):
    paths = write(folder, taken, suffix)
    camera = Camera(studio.lens.matrix, np.array(studio.lens.distortion), studio.lens.size)
    poses = tuple(Pose(one.shot.rotation, one.shot.translation) for one in taken)
    return Scene(studio.board, tuple(photograph(path) for path in paths), (camera,) * len(taken), poses)


@pytest.fixture(scope="module")
def taken():
    return STUDIO.take(SHOTS)


@pytest.fixture(scope="module")
def scene(taken, tmp_path_factory):
    return scene_of(tmp_path_factory.mktemp("scene"), STUDIO, taken)


@pytest.fixture(scope="module")
def found(scene):
    return photometry(scene)


def degrees_between(light, lamp):
    return float(np.degrees(np.arccos(light.direction @ np.array(lamp.position) / np.linalg.norm(lamp.position))))


def scale_errors(found, index, one):
    """Return by how much values come out wrong [3, texels], relatively, for a photograph of which all is known."""
    irradiance = found.irradiance(index, STUDIO.texel_points())[..., 0]
    mine = found.whites.scale[index][:, None, None] * irradiance
    true = one.irradiance * (one.shot.exposure * np.array(STUDIO.gains, np.float32))[:, None, None]
    return (mine / true - 1)[:, irradiance > 0]


def test_lamps_are_right_within_their_errors_and_white_within_two_percent(found, taken):
    assert found.keep == [True] * 4 and found.position.shape == (4, 3)
    for index, one in enumerate(taken):
        # A pixel is half a millimetre here, and half a pixel half a degree on a sphere.
        off = degrees_between(found.lights[index], LAMPS[index])
        assert off < min(1.5, 2 * found.lights[index].sigma_deg) and found.lights[index].sigma_deg < 1
        # Within two percent beside what the direction's error does to the cosine.
        tangent = np.hypot(*LAMPS[index].position[:2]) / LAMPS[index].position[2]
        assert np.abs(scale_errors(found, index, one)).max() < 0.02 + tangent * np.radians(off)
    assert found.vignetting.corner == pytest.approx(0.75, abs=0.06)
    assert found.whites.grey == pytest.approx([0.2] * 3, abs=0.01) and found.whites.spread < 0.02


def test_corrected_photographs_are_the_values_of_measured_btfs(found, taken, scene):
    """A matte surface of reflectance rho under the irradiance 1 reads rho times the cosine, wherever it is in the picture."""
    for index, one in enumerate(taken[:2]):
        corrected = found.correct(index, scene.photographs[index].linear())
        points = np.array([[-56.0, 120, 0], [56, -120, 0], [-8.0, 120, 0]])  # the white patches, and the upper grey one
        column, row = np.round(STUDIO.pixels_of(one.shot, points)).astype(int).T
        light, _, _ = one.shot.lamp.at(points)
        shown = corrected[:, row, column].numpy() / found.irradiance(index, points)[:, 0]
        white = STUDIO.board.reflectance(points[:, 0], points[:, 1])
        assert shown == pytest.approx(np.tile(white * light[:, 2], (3, 1)), rel=0.05)


def test_each_step_says_what_it_found_and_its_residual(found):
    names = [step.name for step in found.steps]
    assert names == ["lights", "evenness", "white"] and all(step.residual for step in found.steps)
    lights, evenness, white = found.steps
    assert "4 of 4 lamps, 4 of them near; from two mirror spheres" in lights.found and "rays miss each other by" in lights.residual
    assert len(lights.rows) == 4 and len(lights.figures) == 4 and all(float(picture.max()) <= 1 for picture in lights.pictures.values())
    assert "from the board's white paper" in evenness.found and "no colour profile: taken as sRGB" in white.notes


def test_shading_alone_is_an_estimate_within_what_it_says(scene, taken):
    found = photometry(scene, PhotometryOptions(lights="shading"))
    told = [index for index in range(4) if found.keep[index]]
    assert len(told) >= 3 and all("must tell where the lamp is" in fault for fault in found.faults if fault)
    for index in told:
        off = degrees_between(found.lights[index], LAMPS[index])
        assert off < 3 * found.lights[index].sigma_deg and off < 6
    assert "an estimate" in found.steps[0].found and "% of the paper's brightness" in found.steps[0].residual
    assert found.vignetting.corner == pytest.approx(0.75, abs=min(0.2, 3 * found.vignetting.sigma))


def test_lights_that_do_not_explain_the_paper_are_refused(scene):
    with pytest.raises(FitError, match="the lights must explain how the board's paper is lit"):
        photometry(scene, PhotometryOptions(lights="flash"))
    with pytest.raises(RangeError, match="lights must be one of .* Did you mean 'spheres'"):
        photometry(scene, PhotometryOptions(lights="sphere"))


def test_given_lights_and_a_flat_field_are_used(scene, taken, tmp_path):
    table = tmp_path / "lamps.csv"
    table.write_text("name,x,y,z\n" + "".join(f"photo_0{number}.png,{x},{y},{z}\n" for number, (x, y, z) in enumerate((lamp.position for lamp in LAMPS), 1)))
    rows, columns = np.indices((560, 840))
    away = ((columns - 419.5) ** 2 + (rows - 279.5) ** 2) / (419.5**2 + 279.5**2)
    flat = dataclasses.replace(taken[0], pixels=np.round(np.repeat((0.6 * (1 - 0.25 * away))[..., None], 3, 2) * 65535).astype(np.uint16))
    path, = write(tmp_path / "flat", [flat])
    found = photometry(scene, PhotometryOptions(lights=str(table), positions=True, flat=path, encoding="linear"))
    assert degrees_between(found.lights[1], LAMPS[1]) < 1e-3 and found.vignetting.how == "a flat field" and found.vignetting.corner == pytest.approx(0.75, abs=0.01)
    assert max(np.abs(scale_errors(found, index, one)).max() for index, one in enumerate(taken)) < 0.02


def test_matte_spheres_and_photographs_without_paper_are_named(tmp_path, taken):
    studio = dataclasses.replace(STUDIO, matte_spheres=True)
    with pytest.raises(FitError, match=r"photographs must have a light that can be found; the first of 1: photo_01\.png: sphere 1: the sphere must be a mirror"):
        photometry(scene_of(tmp_path / "matte", studio, [studio.one(SHOTS[0])]))
    white = dataclasses.replace(taken[1], pixels=np.full_like(taken[1].pixels, 255))
    found = photometry(scene_of(tmp_path / "white", STUDIO, [taken[0], white, taken[2]]))
    assert found.keep == [True, False, True] and "photo_02.png" in found.faults[1]
    assert any("photo_02.png" in note for note in found.steps[0].notes) and np.isnan(found.light[1]).all()


def test_a_photograph_with_a_shadow_on_the_board_is_named(tmp_path, taken):
    shaded = dataclasses.replace(taken[1], pixels=taken[1].pixels.copy())
    shaded.pixels[:, :420] //= 2  # half of the light in sRGB codes, over half of the paper
    found = photometry(scene_of(tmp_path, STUDIO, [taken[0], shaded, taken[2], taken[3]]))
    assert found.keep == [True, False, True, True] and "photo_02.png: the board's white paper must be lit as its lamp explains" in found.faults[1]
    assert max(np.abs(scale_errors(found, index, taken[index])).max() for index in (0, 2, 3)) < 0.04
    assert any("photo_02.png" in note for note in found.steps[0].notes)


def test_the_flash_beside_the_lens_without_spheres(tmp_path):
    board = Board(spheres=0)
    studio = dataclasses.replace(STUDIO, board=board)
    shots = [dataclasses.replace(shot, lamp=beside_lens(shot, (30.0, 5.0, 0.0), colour=(0.9, 1.0, 0.7))) for shot in SHOTS[:2]]
    taken = studio.take(shots)
    found = photometry(scene_of(tmp_path, studio, taken), PhotometryOptions(lights="flash", flash_offset=(30, 5, 0)))
    for index, one in enumerate(taken):
        assert degrees_between(found.lights[index], one.shot.lamp) < 1e-3
        assert np.abs(scale_errors(found, index, one)).max() < 0.03
    assert found.light.shape == (2, 3) and torch.isfinite(found.correct(0, torch.rand(3, 560, 840))).all()


def test_a_fit_from_photographs_gives_the_samples_reflectance(scene, tmp_path):
    """From files alone: the camera, the poses, the lamps and the white are found, and the matte grey of 0.4 comes out."""
    pytest.importorskip("cv2")
    captured = capture(scene.photographs[0].path.parent, tmp_path / "btf", STUDIO.board, measured=150.0, texel=2.0, progress=False)
    assert captured.used == tuple(one.name for one in scene.photographs) and captured.left_out == {}
    btf = tm.load_btf(captured.folder, cache=False, progress=False)
    lamps = np.array([lamp.position for lamp in LAMPS])
    cosine = (btf.light.numpy() * lamps / np.linalg.norm(lamps, axis=1, keepdims=True)).sum(1)
    assert np.degrees(np.arccos(cosine)).max() < 1.5
    material = tm.fit(btf, "lambert", holdout=0, measure=False).material
    up = torch.tensor([0.0, 0, 1])[:, None, None]
    with torch.no_grad():
        shown = material.shade(up, up)
    assert shown.mean((1, 2)).numpy() == pytest.approx([0.4] * 3, rel=0.02)
    assert float((shown / 0.4 - 1).abs().quantile(0.98)) < 0.05
