"""Mirror spheres: outlines, highlights, rays and lamps against geometry that is worked out by hand, and in the simulated studio."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from tests.capturing.simulated import Lamp, Lens, Shot, Studio, matte_grey

from torchmat.capturing.board import Board
from torchmat.capturing.outline import common_centre, outline, refined_centre
from torchmat.capturing.spheres import Highlight, Ray, find_highlight, lamp_of_rays, lamp_ray
from torchmat.capturing.view import Camera, Pose
from torchmat.errors import DataError

RADIUS = 12.5
LENS = Lens(size=(240, 180), focal=2200.0)
BOARD = Board()


def seen(shot: Shot, lens: Lens = LENS) -> tuple[Camera, Pose]:
    return Camera(lens.matrix, np.array(lens.distortion), lens.size), Pose(shot.rotation, shot.translation)


def shots(lamps, centre):
    places = [(60, -80, 500), (200, 60, 420), (-150, 300, 380), (260, -200, 330), (0, 240, 460), (-220, -60, 400)]
    return [Shot(place, lamp, exposure=0.6, target=tuple(centre)) for place, lamp in zip(places, lamps, strict=False)]


def mirror_point(camera_at: np.ndarray, lamp_at: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return where a sphere reflects a lamp: the normal halves the angle between the two, found by going there step by step."""
    normal = np.array([0.0, 0, 1])
    for _ in range(80):
        towards = [place - (centre + RADIUS * normal) for place in (camera_at, lamp_at)]
        normal = sum(one / np.linalg.norm(one) for one in towards)
        normal /= np.linalg.norm(normal)
    return centre + RADIUS * normal


def test_the_outline_of_a_sphere_on_the_axis_is_a_circle_by_hand():
    lens = Lens(size=(400, 400), focal=800.0, distortion=(0, 0, 0, 0, 0))
    camera, pose = seen(Shot((0, 0, 500), Lamp((0, 0, 1))), lens)
    around = outline(camera, pose, np.array([0, 0, 100.0]), 30.0)
    wanted = 800 * 30 / np.sqrt(400**2 - 30**2)
    assert np.linalg.norm(around - 199.5, axis=1) == pytest.approx(np.full(240, wanted), abs=1e-6)


def test_all_of_a_sphere_lies_within_its_outline_and_touches_it():
    lens = Lens(size=(1500, 1000), focal=1700.0)
    camera, pose = seen(Shot((300, -200, 350), Lamp((0, 0, 1))), lens)
    centre = BOARD.sphere_centres[0]
    around = outline(camera, pose, centre, RADIUS, 720)
    random = np.random.default_rng(0).standard_normal((200_000, 3))
    dots = pose.project(camera, centre + RADIUS * random / np.linalg.norm(random, axis=1, keepdims=True))
    for turn in np.linspace(0, 2 * np.pi, 7):
        along = np.array([np.cos(turn), np.sin(turn)])
        assert -0.05 < (around @ along).max() - (dots @ along).max() < 0.15


def test_a_highlight_reflects_back_to_its_lamp():
    shot = Shot((300, -200, 350), Lamp((0, 0, 1)))
    camera, pose = seen(shot, Lens(size=(1500, 1000), focal=1700.0))
    lamp, centre = np.array([-200.0, 150, 400]), BOARD.sphere_centres[1]
    point = mirror_point(np.array(shot.position, float), lamp, centre)
    ray = lamp_ray(camera, pose, centre, RADIUS, Highlight(pose.project(camera, point), 0.15, 2.0), 0.1)
    assert ray.point == pytest.approx(point, abs=1e-4)
    assert ray.direction == pytest.approx((lamp - point) / np.linalg.norm(lamp - point), abs=1e-5)
    # By hand: a place that is wrong by s turns the normal by s / r, and the reflected ray twice as far.
    assert 0.5 * 0.2 / RADIUS < ray.sigma < 1.5 * 0.2 / RADIUS


def rays_to(lamp, sigma=0.01, spread=0.0, seed=0):
    random, rays = np.random.default_rng(seed), []
    for centre in BOARD.sphere_centres:
        direction = (lamp - centre) / np.linalg.norm(lamp - centre) + spread * random.standard_normal(3)
        rays.append(Ray(centre, direction / np.linalg.norm(direction), sigma))
    return rays


def test_two_rays_meet_at_the_lamp_and_one_tells_its_direction():
    lamp = np.array([-200.0, 150, 400])
    found = lamp_of_rays("a.jpg", rays_to(lamp))
    assert found.position == pytest.approx(lamp, abs=1e-6) and found.distance == pytest.approx(np.linalg.norm(lamp)) and found.residual < 1e-6
    one = lamp_of_rays("a.jpg", rays_to(lamp)[:1])
    assert one.position is None and one.direction @ (lamp - BOARD.sphere_centres[0]) > 0.999 * np.linalg.norm(lamp - BOARD.sphere_centres[0])
    assert one.sigma_deg == pytest.approx(np.degrees(0.01))


def test_parallel_rays_are_of_a_far_lamp():
    lamp = np.array([-2e6, 1.5e6, 4e6])
    found = lamp_of_rays("a.jpg", rays_to(lamp, 0.01, 0.002))
    assert found.position is None and np.degrees(np.arccos(found.direction @ lamp / np.linalg.norm(lamp))) < 0.3


def test_errors_of_positions_are_as_large_as_they_say():
    lamp = np.array([-200.0, 150, 400])
    square = []
    for seed in range(200):
        found = lamp_of_rays("a.jpg", rays_to(lamp, 0.005, 0.005, seed))
        away = found.position - lamp
        square.append(away @ np.linalg.solve(found.covariance, away))
    assert np.mean(square) == pytest.approx(3, abs=0.6)  # chi squared with three degrees of freedom


def test_rays_that_miss_each_other_are_said_and_lamps_below_the_plane_named():
    first, second = rays_to(np.array([0.0, 0, 400]), 0.002)
    tilted = Ray(second.point, (second.direction + [0.1, -0.1, 0]) / np.linalg.norm(second.direction + [0.1, -0.1, 0]), 0.002)
    assert "a sphere stands elsewhere" in lamp_of_rays("a.jpg", [first, tilted]).notes[0]
    with pytest.raises(DataError, match="a.jpg: the lamp must be above the sample's plane"):
        lamp_of_rays("a.jpg", rays_to(np.array([0.0, 300, -80])))
    with pytest.raises(DataError, match="a.jpg: the lamp must be above the sample's plane"):
        lamp_of_rays("a.jpg", rays_to(np.array([0.0, 300, -80]))[:1])


def disc(*spots, size=120, radius=50):
    """Paint a dark disc with spots (column, row, radius, value), sharp; return planes, clipped pixels and the outline."""
    rows, columns = np.indices((size, size))
    picture = np.where(np.hypot(rows - 60, columns - 60) < radius, 0.05, 0.6)
    for column, row, reach, value in spots:
        picture += value * np.clip(reach + 0.5 - np.hypot(rows - row, columns - column), 0, 1)
    turn = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    picture = np.minimum(picture, 1)
    return np.stack([picture] * 3), picture >= 1, np.stack((60 + radius * np.cos(turn), 60 + radius * np.sin(turn)), axis=1)


def test_highlights_are_found_between_pixels_and_beside_weaker_spots():
    found = find_highlight("a.jpg", *disc((50.3, 70.6, 4, 30.0), (80, 50, 2, 0.3)))
    assert found.pixel == pytest.approx([50.3, 70.6], abs=0.2) and found.radius == pytest.approx(4.5, abs=0.5)
    unclipped = find_highlight("a.jpg", *disc((50.3, 70.6, 4, 0.5)))
    assert unclipped.pixel == pytest.approx([50.3, 70.6], abs=0.05)


@pytest.mark.parametrize(
    ("spots", "expected"),
    [([(50, 70, 4, 30), (80, 50, 4, 30)], "show one highlight; there are two"), ([(50, 60, 25, 0.5)], "be a mirror with one compact highlight"),
     ([(60, 60, 40, 30)], "be a mirror with one compact highlight"), ([(50, 70, 3, 0.02)], "be a mirror with one compact highlight"),
     ([(60, 60, 45, 0.75), (50, 70, 3, 0.3)], "be a mirror with a highlight that stands out")],
    ids=["two lamps", "matte", "clipped", "nothing", "in the bright"],
)
def test_what_is_no_mirror_under_one_lamp_is_refused(spots, expected):
    with pytest.raises(DataError, match=rf"a\.jpg: the sphere must {expected}"):
        find_highlight("a.jpg", *disc(*spots))


def test_a_sphere_outside_of_the_photograph_is_named():
    linear, clipped, around = disc((50, 70, 4, 30.0))
    with pytest.raises(DataError, match="lie in the photograph"):
        find_highlight("a.jpg", linear, clipped, around - 200)


@pytest.fixture(scope="module")
def studio():
    board = Board()
    # The sphere was put down beside its ring.
    vars(board)["sphere_centres"] = BOARD.sphere_centres + [[0.7, -0.5, 0], [0, 0, 0]]
    return Studio(matte_grey(0.4), board=board, lens=LENS, texels=(4, 4), supersampling=1)


@pytest.fixture(scope="module")
def lamps():
    return [Lamp(place) for place in [(-200, 150, 400), (150, 200, 380), (-100, -250, 350), (250, 50, 300), (30, -120, 450), (-260, 0, 330)]]


@pytest.fixture(scope="module")
def taken(studio, lamps):
    return [studio.one(shot) for shot in shots(lamps, BOARD.sphere_centres[0])]


def test_photographs_together_show_where_a_sphere_stands(studio, taken):
    placed = [
        refined_centre(one.linear.clip(0, 1).mean(2), *seen(one.shot), BOARD.sphere_centres[0], RADIUS, BOARD.reflectance) for one in taken
    ]
    standing = common_centre(placed, BOARD.sphere_centres[0])
    assert standing.moved and standing.centre == pytest.approx(studio.board.sphere_centres[0], abs=0.15)
    assert common_centre(placed, studio.board.sphere_centres[0]).moved is False
    assert common_centre([None] * 9, BOARD.sphere_centres[0]).centre == pytest.approx(BOARD.sphere_centres[0])


def test_directions_from_one_sphere_are_right_within_a_degree(studio, taken):
    centre = studio.board.sphere_centres[0]
    for one in taken:
        camera, pose = seen(one.shot)
        linear = np.moveaxis(one.linear.clip(0, 1), -1, 0)
        highlight = find_highlight("a.jpg", linear, linear.max(0) >= 1, outline(camera, pose, centre, RADIUS))
        ray = lamp_ray(camera, pose, centre, RADIUS, highlight)
        towards = np.array(one.shot.lamp.position) - ray.point
        away = np.arccos(ray.direction @ towards / np.linalg.norm(towards))
        assert away < np.radians(1) and away < 4 * ray.sigma


def test_matte_spheres_are_named(studio, taken):
    one = dataclasses.replace(studio, matte_spheres=True).one(taken[0].shot)
    linear = np.moveaxis(one.linear.clip(0, 1), -1, 0)
    around = outline(*seen(one.shot), studio.board.sphere_centres[0], RADIUS)
    with pytest.raises(DataError, match="be a mirror with one compact highlight"):
        find_highlight("a.jpg", linear, linear.max(0) >= 1, around)
