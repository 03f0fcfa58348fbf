"""The simulated studio: its lens against OpenCV's, its light, mirrors and noise against what is worked out by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from tests.capturing.simulated import BLACK, MIRROR, WHITE, Lamp, Lens, Shot, Studio, beside_lens, matte_grey, shots_around, write

from torchmat.images import read_image, read_tags

cv2 = pytest.importorskip("cv2")
SMALL = Lens(size=(240, 160), focal=260.0)


@pytest.fixture(scope="module")
def studio():
    return Studio(matte_grey(0.4), lens=SMALL, texels=(8, 8), bits=16)


@pytest.fixture(scope="module")
def taken(studio):
    return studio.one(Shot((120.0, -60.0, 480.0), Lamp((-150.0, 100.0, 420.0), radius=30.0), exposure=0.5, roll=90))


def test_pixels_are_where_opencv_projects_them(studio, taken):
    points = np.c_[studio.board.corners, np.zeros(len(studio.board.corners))]
    turn, shift = cv2.Rodrigues(taken.shot.rotation)[0], taken.shot.translation
    expected = cv2.projectPoints(points, turn, shift, SMALL.matrix, np.array(SMALL.distortion))[0][:, 0]
    assert np.abs(studio.pixels_of(taken.shot, points) - expected).max() < 1e-9


def test_the_lens_is_inverted(studio):
    columns, rows = np.arange(0, 240, 7) + 0.25, np.arange(0, 160, 5) - 0.25
    u, v = SMALL.bent(*(one.astype(float) for one in SMALL.straight(columns, rows)))
    assert np.abs(u * SMALL.focal + SMALL.matrix[0, 2] - columns).max() < 1e-3
    assert np.abs(v * SMALL.focal + SMALL.matrix[1, 2] - rows[:, None]).max() < 1e-3


@pytest.mark.parametrize(("place", "reflectance"), [((0.0, 0.0), 0.4), ((-48.0, 120.0), WHITE), ((-80.0, 128.0), BLACK)])
def test_what_a_pixel_shows_is_albedo_cosine_and_inverse_square(studio, taken, place, reflectance):
    point = np.array([*place, 0.0])
    lamp = np.array(taken.shot.lamp.position)
    away = np.linalg.norm(lamp - point)
    expected = 0.5 * reflectance * lamp[2] / away * (np.linalg.norm(lamp) / away) ** 2
    column, row = np.round(studio.pixels_of(taken.shot, point)).astype(int)
    assert taken.linear[row, column] == pytest.approx(expected, rel=0.02)
    assert taken.pixels[row, column] / 65535 == pytest.approx(taken.linear[row, column], abs=1e-5)


def test_truths_of_texels_are_unit_and_of_the_middle(studio, taken):
    points = studio.texel_points()
    assert points[0, 0] == pytest.approx([-49, 49, 0]) and points[-1, -1] == pytest.approx([49, -49, 0])
    assert np.linalg.norm(taken.view, axis=0) == pytest.approx(np.ones((8, 8)), abs=1e-6)
    middle = taken.view.mean((1, 2))
    assert middle / np.linalg.norm(middle) == pytest.approx(np.array([120, -60, 480]) / np.linalg.norm([120, -60, 480]), abs=2e-3)
    assert taken.value == pytest.approx(0.4 * taken.light[2][None].repeat(3, 0), abs=1e-6)


def test_the_highlight_lies_where_the_mirror_says(studio, taken):
    centre = studio.board.sphere_centres[0]
    near = dataclasses.replace(studio, lens=Lens(size=(160, 120), focal=2200.0), supersampling=1)
    taken = near.one(dataclasses.replace(taken.shot, target=tuple(centre)))
    bright = np.maximum(taken.linear[..., 0] - 0.5, 0)
    rows, columns = np.indices(bright.shape)
    found = np.array([(columns * bright).sum(), (rows * bright).sum()]) / bright.sum()
    # The mirror's point is where the normal halves the angle between camera and lamp: found by going there step by step.
    normal = np.array([0.0, 0, 1])
    for _ in range(50):
        point = centre + studio.board.diameter / 2 * normal
        towards = [np.array(place) - point for place in (taken.shot.position, taken.shot.lamp.position)]
        normal = sum(one / np.linalg.norm(one) for one in towards)
        normal /= np.linalg.norm(normal)
    assert np.abs(found - near.pixels_of(taken.shot, centre + studio.board.diameter / 2 * normal)).max() < 0.15
    assert bright.max() > 1 and MIRROR < 1


def test_noise_is_that_of_photons_and_the_same_each_time(taken):
    noisy = Studio(matte_grey(0.4), lens=SMALL, texels=(8, 8), bits=16, full_well=1000.0, read_noise=3.0, supersampling=1)
    first, again, other = noisy.one(taken.shot), noisy.one(taken.shot), noisy.one(taken.shot, 1)
    assert (first.pixels == again.pixels).all() and (first.pixels != other.pixels).mean() > 0.5
    flat = (first.linear > 0.02) & (first.linear < 0.5)
    wanted = np.sqrt(first.linear[flat] * 1000 + 9) / 1000
    assert ((first.pixels[flat] / 65535 - first.linear[flat]) / wanted).std() == pytest.approx(1, abs=0.03)


def test_lamps_beside_the_lens_far_and_uneven():
    shot = shots_around([30], [0], 500, [Lamp((0, 0, 1))])[0]
    flash = beside_lens(shot, (40.0, 0.0, 0.0))
    away = np.array(flash.position) - shot.position
    assert np.linalg.norm(away) == pytest.approx(40) and shot.rotation @ away == pytest.approx([40, 0, 0])
    light, _, strength = Lamp((0, 3, 4), far=True, gradient=(2.0, 0.0)).at(np.array([[100.0, 0, 0]]))
    assert light[0] == pytest.approx([0, 0.6, 0.8]) and strength[0] == pytest.approx(1.2)


def test_photographs_are_written_with_what_cameras_say(taken, tmp_path):
    path, = write(tmp_path, [taken], ".png", {"Orientation": 3})
    assert (read_image(path) == taken.pixels[::-1, ::-1]).all() and read_tags(path).orientation == 3
