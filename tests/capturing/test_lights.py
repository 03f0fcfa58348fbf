"""Lights that are given: the flash, tables, domes; and a near lamp from the paper's shading."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.capturing.shots import Lamp, Shot, beside_lens

from torchmat.capturing.board import Board
from torchmat.capturing.light import Light, blocked
from torchmat.capturing.lights import flash, lights_of_table
from torchmat.capturing.paper import white_points
from torchmat.capturing.shading import lamp_of_shading
from torchmat.capturing.view import Pose
from torchmat.errors import DataError, RangeError

NAMES = ["IMG_1.jpg", "IMG_2.jpg", "IMG_10.jpg"]
VECTORS = np.array([[0, 0.6, 0.8], [0.6, 0, 0.8], [0, 0, 1.0]])


def test_a_near_lamp_by_hand_and_a_far_one():
    near = Light(np.array([0, 0, 1.0]), 1, np.array([0, 0, 300.0]))
    points = np.array([[0, 0, 0], [400.0, 0, 0]])
    assert near.directions(points) == pytest.approx(np.array([[0, 0, 1], [-0.8, 0, 0.6]]))
    assert near.strength(points) == pytest.approx([1, 0.36]) and near.irradiance(points) == pytest.approx([1, 0.36 * 0.6])
    far = Light(np.array([0, 0.6, 0.8]), 1)
    assert far.strength(points) == pytest.approx([1, 1]) and far.irradiance(points) == pytest.approx([0.8, 0.8]) and far.distance is None


def test_spheres_stand_in_the_way_of_what_is_behind_them():
    points = np.array([[-30.0, 0, 0], [30, 0, 0], [-30, 20, 0]])
    along = np.broadcast_to([0.8, 0, 0.6], (3, 3))
    assert blocked(points, along, np.array([[0, 0, 12.5]]), 12.5).tolist() == [True, False, False]


def test_the_flash_is_beside_the_lens():
    shot = Shot((120, -90, 400), Lamp((0, 0, 1)), roll=30)
    found = flash(Pose(shot.rotation, shot.translation), (40, 5, 0))
    assert found.position == pytest.approx(beside_lens(shot, (40, 5, 0)).position)
    assert found.sigma_deg == pytest.approx(np.degrees(5 / found.distance), rel=0.01)
    with pytest.raises(RangeError, match="three numbers"):
        flash(Pose(shot.rotation, shot.translation), (1, 2))


def test_tables_are_read_by_name_and_stand_near_where_a_distance_is_given(tmp_path):
    path = tmp_path / "lights.lp"
    path.write_text("3\nimages\\IMG_10.JPG 0 0 2\nIMG_1.JPG 0 0.6 0.8\nIMG_2.JPG 0.6 0 0.8\n")
    far = lights_of_table(path, NAMES)
    assert np.stack([one.direction for one in far]) == pytest.approx(VECTORS) and far[0].position is None and far[0].how == "lights.lp"
    near = lights_of_table(path, NAMES, distance=400)
    assert near[0].position == pytest.approx([0, 240, 320]) and near[0].sigma_deg == pytest.approx(1, rel=0.01)
    path.write_text("0 60 80\n60 0 80\n0 0 100\n")
    assert lights_of_table(path, NAMES, positions=True)[1].position == pytest.approx([60, 0, 80])


@pytest.mark.parametrize(
    ("text", "expected"),
    [("IMG_1.jpg 0 0 1\nIMG_2.jpg 0 0 1\n", "1 of 3 have none, the first is 'IMG_10.jpg'"),
     ("IMG_1.jpg 0 0 1\nIMG_2.jpg 0 0.6 -0.8\nIMG_10.jpg 0 0 1\n", "line 2: the light must be above the sample's plane"),
     ("IMG_1.jpg 0 0 1\nIMG_1.png 0 0 1\nIMG_10.jpg 0 0 1\n", "'IMG_1.jpg' and 'IMG_1.png' are one name"),
     ("0 0 1\n0 0 1\n", "2 lights for 3 photographs")],
)
def test_bad_tables_are_named(tmp_path, text, expected):
    path = tmp_path / "lights.lp"
    path.write_text(text)
    with pytest.raises(DataError, match=expected):
        lights_of_table(path, NAMES)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [({"lightConfiguration": "directional", "domeDiameter": 600}, None),
     ({"lightConfiguration": "spherical", "domeDiameter": 600, "verticalOffset": 10}, [0, 180, 250]),
     ({"lightConfiguration": "lights3d", "positions3d": [[1, 2, 300], [0, 0, 310], [5, 5, 320]]}, [1, 2, 300]),
     ({"lightConfiguration": "spherical", "positions": [{"x": 0, "y": 1, "z": 200}] * 3}, [0, 1, 200])],
    ids=["directional", "spherical", "positions", "an earlier release"],
)
def test_domes_of_relight_are_read(tmp_path, fields, expected):
    path = tmp_path / "lab.dome"
    path.write_text(json.dumps({"directions": [dict(zip("xyz", one, strict=True)) for one in VECTORS.tolist()], **fields}))
    found = lights_of_table(path, NAMES)
    if expected is None:
        assert found[0].position is None and found[0].direction == pytest.approx(VECTORS[0])
    else:
        assert found[0].position == pytest.approx(expected)


@pytest.mark.parametrize("content", ["{}", "[]", '{"directions": [[0, 0]]}', '{"directions": [{"x": 1}]}', '{"directions": [[0, 0, 0]]}'])
def test_bad_domes_are_named(tmp_path, content):
    path = tmp_path / "lab.dome"
    path.write_text(content)
    with pytest.raises(DataError, match="lab.dome"):
        lights_of_table(path, NAMES)


def paper(lamp, noise=0.01, seed=0):
    points = white_points(Board())
    away = lamp - points
    distance = np.linalg.norm(away, axis=1)
    random = np.random.default_rng(seed)
    return points, 0.37 * lamp[2] / distance**3 * 1e7 * (1 + noise * random.standard_normal(len(points)))


@pytest.mark.parametrize("lamp", [(-150.0, 100, 300), (20, 10, 250), (300, -200, 250), (0, 150, 500)])
def test_the_papers_shading_tells_a_near_lamp_within_its_uncertainty(lamp):
    points, values = paper(np.array(lamp))
    values[: len(values) // 10] *= 0.3  # a shadow
    found = lamp_of_shading("a.jpg", points, values)
    away = found.position - lamp
    assert away @ np.linalg.solve(found.covariance, away) < 11.3  # 99 % of chi squared with three degrees of freedom
    assert found.sigma_deg < 3 and "estimate" in found.how and found.residual < 0.05


def test_paper_that_is_lit_evenly_tells_no_lamp():
    with pytest.raises(DataError, match="a.jpg: the shading of the paper must tell where the lamp is"):
        lamp_of_shading("a.jpg", *paper(np.array([0.0, 3000, 9000])))
    points, values = paper(np.array([0, 0, 300.0]))
    with pytest.raises(DataError, match="at least 50 points"):
        lamp_of_shading("a.jpg", points[:20], values[:20])
