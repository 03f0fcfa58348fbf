"""Vignetting, uneven light, exposure and white balance from points of paper whose truth is made by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.capturing.shots import Lamp, Lens, shots_around

from torchmat.capturing.board import Board
from torchmat.capturing.evenness import fit_courses, flat_field
from torchmat.capturing.sheen import mirrored
from torchmat.capturing.light import Light
from torchmat.capturing.paper import patch_points, read_paper, white_points
from torchmat.capturing.view import Camera, Pose
from torchmat.capturing.white import calibrate_white
from torchmat.errors import RangeError

BOARD = Board()
LENS = Lens(size=(900, 600), focal=1000.0)
SIZE, LOST = LENS.size, 0.3


def fall(pixels):
    away = (pixels - (np.array(SIZE) - 1) / 2) / (np.hypot(*SIZE) / 2)
    return 1 - LOST * (away**2).sum(-1)


@pytest.fixture(scope="module")
def papers():
    """Six photographs of paper: points, pixels, values and the irradiance by their lamps; 2 % of the points are in shadow."""
    lamps = [Lamp((x, y, 350.0)) for x, y in [(-200, 50), (150, 200), (0, -250), (220, -60), (-90, 180), (30, 20)]]
    points, pixels, values, expected = [], [], [], []
    for number, shot in enumerate(shots_around([10, 35, 25, 40, 20, 30], [0, 70, 130, 200, 260, 320], 420, lamps)):
        camera, pose = Camera(LENS.matrix, np.array(LENS.distortion), SIZE), Pose(shot.rotation, shot.translation)
        place = white_points(BOARD)
        at = pose.project(camera, place)
        place, at = (one[((at > 0) & (at < np.array(SIZE) - 1)).all(1)] for one in (place, at))
        lit = Light(np.array([0, 0, 1.0]), 1, np.array(shot.lamp.position)).irradiance(place)
        random = np.random.default_rng(number)
        course = np.exp(place[:, :2] @ [0.0004, -0.0003 * number])
        value = lit * course * fall(at) * (1 + 0.01 * random.standard_normal(len(lit)))
        value[random.random(len(lit)) < 0.02] *= 0.2
        points.append(place), pixels.append(at), expected.append(lit)
        values.append(value[:, None] * 0.9 * np.array([0.5, 0.7, 0.4]) * (1 + 0.1 * number))
    return points, pixels, values, expected


def test_vignetting_is_told_from_light_that_is_stronger_to_one_side(papers):
    courses, vignetting, _ = fit_courses(SIZE, *papers)
    corners = np.array([[0.0, 0], [899, 0], [450, 300]])
    assert vignetting.at(corners) == pytest.approx(fall(corners), abs=0.015) and vignetting.corner == pytest.approx(1 - LOST, abs=0.015)
    assert vignetting.sigma < 0.1
    for number, course in enumerate(courses):
        assert course.slope == pytest.approx([0.0004, -0.0003 * number], abs=3e-5)
        assert course.level == pytest.approx(0.9 * np.array([0.5, 0.7, 0.4]) * (1 + 0.1 * number), rel=0.005)
        assert course.residual == pytest.approx(0.01, abs=0.003)
    assert courses[0].at(np.array([100.0, 0, 0])) == pytest.approx(np.exp(0.04), abs=0.01)


def test_vignetting_that_is_known_is_divided_out(papers):
    rows, columns = np.indices(SIZE[::-1])
    even = fall(np.stack((columns, rows), axis=-1))
    known = flat_field(torch.from_numpy(0.6 * even).float().expand(3, -1, -1), torch.zeros(even.shape, dtype=torch.bool))
    assert known.corner == pytest.approx(1 - LOST, abs=2e-3)
    courses, same, _ = fit_courses(SIZE, *papers, known)
    assert same is known and courses[2].level == pytest.approx(0.9 * 1.2 * np.array([0.5, 0.7, 0.4]), rel=0.005)
    planes = torch.from_numpy(even).expand(3, -1, -1)
    assert float((known.taken_out(planes) - 1).abs().max()) < 2e-3
    with pytest.raises(RangeError, match="have the size of the flat field"):
        known.taken_out(planes[..., 1:])


@pytest.mark.parametrize(("strength", "exponent"), [(0.0, 40), (0.3, 40), (0.4, 28)])
def test_paper_that_is_glossy_tells_white_all_the_same(strength, exponent):
    """By hand: gloss over matte is s (n . h)^e / (n . l); a third more light on half of the paper would be levels a tenth too high."""
    lamps = [Lamp((x, y, 400.0)) for x, y in [(-200, 50), (150, 200), (0, -250), (220, -60), (-90, 180), (30, 20)]]
    points, pixels, values, expected, mirror = [], [], [], [], []
    for number, shot in enumerate(shots_around([30, 35, 25, 40, 20, 30], [10, 230, 90, 160, 300, 200], 420, lamps)):
        camera, pose = Camera(LENS.matrix, np.array(LENS.distortion), SIZE), Pose(shot.rotation, shot.translation)
        place = white_points(BOARD)[::3]
        at = pose.project(camera, place)
        place, at = (one[((at > 0) & (at < np.array(SIZE) - 1)).all(1)] for one in (place, at))
        light = Light(np.array([0, 0, 1.0]), 1, np.array(shot.lamp.position))
        towards, view = (np.array(one) - place for one in (shot.lamp.position, shot.position))
        towards, view = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (towards, view))
        half = (towards + view) / np.linalg.norm(towards + view, axis=1, keepdims=True)
        lit = 0.9 * light.irradiance(place) * (1 + strength * half[:, 2] ** exponent / towards[:, 2])
        noisy = lit * fall(at) * (1 + 0.005 * np.random.default_rng(number).standard_normal(len(lit)))
        points.append(place), pixels.append(at), expected.append(light.irradiance(place)), values.append(np.tile(noisy[:, None], 3))
        mirror.append(mirrored(pose, light, place))
    courses, _, sheen = fit_courses(SIZE, points, pixels, values, expected, mirror=mirror)
    assert np.stack([course.level for course in courses]) == pytest.approx(np.full((6, 3), 0.9), rel=0.02)
    assert (sheen is None) == (strength == 0)
    if sheen is not None:
        assert 0.7 * exponent < sheen.exponent < 1.5 * exponent and sheen.strength == pytest.approx(strength, rel=0.2)
        plain = fit_courses(SIZE, points, pixels, values, expected)[0]
        assert max(abs(course.level[0] / 0.9 - 1) for course in plain) > 0.05  # what it would be without


def test_a_highlight_or_a_lamp_beside_is_no_flat_field():
    rows, columns = torch.meshgrid(torch.linspace(-1, 1, 120), torch.linspace(-1.5, 1.5, 180), indexing="ij")
    clear, lens = torch.zeros(120, 180, dtype=torch.bool), 0.6 * (1 - 0.1 * (rows**2 + columns**2))
    assert flat_field((lens * (1 + 0.01 * columns)).expand(3, -1, -1), clear).corner < 0.75
    for uneven in (1 + 0.15 * columns, 1 + 0.2 * torch.exp(-((columns - 0.5) ** 2 + rows**2) / 0.5)):
        with pytest.raises(RangeError, match="flat field: the photograph must be evenly lit; about pixel"):
            flat_field((lens * uneven).expand(3, -1, -1), clear)


def test_what_is_no_flat_field_is_refused():
    clear = torch.zeros(60, 90, dtype=torch.bool)
    with pytest.raises(RangeError, match="not be clipped; 100.0% is"):
        flat_field(torch.ones(3, 60, 90), ~clear)
    with pytest.raises(RangeError, match="be of lit white"):
        flat_field(torch.zeros(3, 60, 90), clear)
    checks = ((torch.arange(60)[:, None] // 10 + torch.arange(90) // 10) % 2).float()
    with pytest.raises(RangeError, match="be of even white"):
        flat_field((0.3 + 0.5 * checks).expand(3, -1, -1), clear)


def test_paper_is_white_where_it_is_read_and_spheres_hide_it():
    points = white_points(BOARD)
    assert len(points) > 1000 and (BOARD.reflectance(points[:, 0], points[:, 1]) == np.float32(0.9)).all()
    assert not ((np.abs(points[:, 0]) < 56) & (np.abs(points[:, 1]) < 56)).any()
    for name, level in (("white", 0.9), ("grey", 0.2)):
        patch = patch_points(BOARD, name)
        assert patch.shape == (2, 144, 3) and (BOARD.reflectance(patch[..., 0], patch[..., 1]) == np.float32(level)).all()
    camera, pose = Camera(np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]), np.zeros(5), (101, 81)), Pose(np.diag([1.0, -1, -1]), np.array([0, 0, 100.0]))
    linear = np.stack([np.tile(np.arange(101.0), (81, 1))] * 3)
    clipped = np.zeros((81, 101), bool)
    clipped[40, 70] = True
    points = np.array([[10.25, 0, 0], [20, 0, 0], [-20, 0, 0], [60, 0, 0]])
    reading = read_paper(linear, clipped, camera, pose, points, np.array([[-15, 0, 30.0]]), 5.0)
    # Column 50 + x; the second is clipped, a sphere hides the third, the fourth is outside.
    assert reading.values[0] == pytest.approx([60.25] * 3) and reading.good.tolist() == [True, False, False, False]


LEVEL = np.array([[0.3, 0.5, 0.2], [0.6, 1.0, 0.4], [0.2, 0.3, 0.1], [0.4, 0.6, 0.3], [0.5, 0.8, 0.3]])


def test_the_patch_tells_the_papers_reflectance_and_the_scale():
    patch = np.full((5, 3), 1.1)
    patch[1] = np.nan
    white = calibrate_white(LEVEL, patch, np.full((5, 3), 0.25), 0.99)
    assert white.paper == pytest.approx([0.9] * 3) and white.scale == pytest.approx(LEVEL / 0.9)
    assert white.grey == pytest.approx([0.225] * 3) and white.spread < 1e-9 and abs(white.bend) < 1e-9 and white.notes == ()


def test_paper_stands_for_a_patch_that_is_clipped_everywhere_and_says_so():
    white = calibrate_white(LEVEL, np.full((5, 3), np.nan), np.full((5, 3), np.nan))
    assert white.scale == pytest.approx(LEVEL / 0.9) and len(white.notes) == 2 and "the paper is taken for 0.9" in white.notes[0]


def test_a_curve_in_the_values_is_shown_by_the_grey_patch():
    # A response that is bent between grey and white: the share of grey changes with the exposure.
    share = 0.2 * LEVEL ** 0.3
    white = calibrate_white(LEVEL, np.ones((5, 3)), share)
    assert white.bend == pytest.approx(0.3, abs=0.03) and "may not be linear light" in white.notes[0]
    with pytest.raises(RangeError, match="show its reflectance within 10 %; it shows 0.450 where 0.2"):
        calibrate_white(LEVEL, np.ones((5, 3)), np.full((5, 3), 0.5), grey_reflectance=0.2)
    with pytest.raises(RangeError, match="be at most 1; it is 90"):
        calibrate_white(LEVEL, np.ones((5, 3)), share, 90.0)


def test_a_grey_patch_without_light_is_said():
    white = calibrate_white(LEVEL, np.ones((5, 3)), np.full((5, 3), -0.01))
    assert np.isnan(white.spread) and "the grey patch shows no light" in white.notes[0] and white.scale == pytest.approx(LEVEL / 0.9)
