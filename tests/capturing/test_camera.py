"""Camera and poses from corners: what is recovered, what too few or too alike views cannot tell, and what does not fit."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from tests.capturing.corners import BOARD, around, degrees_apart, seen_from
from tests.capturing.shots import Lens
from tests.capturing.simulated import Studio, matte_grey

from torchmat.capturing.board import Board
from torchmat.capturing.camera import calibrate, check_one_camera
from torchmat.capturing.detect import Detection
from torchmat.capturing.pose import printed, seen, solve_pose, stations
from torchmat.capturing.view import Camera, Pose
from torchmat.errors import DataError, FitError, RangeError

cv2 = pytest.importorskip("cv2")


def test_thirty_views_tell_the_lens_and_where_the_camera_stood():
    shots = around(30, 20, 60)
    found = calibrate(BOARD, *seen_from(shots))
    assert found.camera.matrix[0, 0] == pytest.approx(1000, rel=2e-3) and found.focal_error < 2e-3
    assert found.rms == pytest.approx(0.15 * np.sqrt(2), rel=0.1) and not found.outliers and not found.notes
    assert max(degrees_apart(np.array(shots[index].position), pose.position) for index, pose in found.poses.items()) < 0.1
    # The lens as it acts where boards were: what a turn of the camera makes of an offset is in its pose.
    columns, rows = np.linspace(120, 780, 10), np.linspace(90, 510, 8)
    rays = found.camera.rays(np.stack(np.meshgrid(columns, rows), axis=-1))
    beside = rays[..., :2] / rays[..., 2:] - np.stack(Lens().straight(columns, rows), axis=-1)
    assert np.abs(beside - beside.mean((0, 1))).max() < 1e-3 and np.abs(beside).max() < 4e-3


@pytest.mark.parametrize(("count", "least", "most"), [(3, 20, 50), (5, 10, 50), (8, 0, 40)])
def test_few_views_make_no_wild_lens(count, least, most):
    shots = around(count, least, most, seed=count)
    found = calibrate(BOARD, *seen_from(shots))
    assert found.camera.matrix[0, 0] == pytest.approx(1000, rel=0.02) and np.abs(found.camera.distortion).max() < 0.4
    assert max(degrees_apart(np.array(shots[index].position), pose.position) for index, pose in found.poses.items()) < 0.3


def test_views_from_straight_above_tell_no_focal_length_and_exif_does():
    shots = around(10, 0, 3)
    with pytest.raises(FitError, match="views are too alike. Take some photographs from 30 to 50 degrees"):
        calibrate(BOARD, *seen_from(shots))
    found = calibrate(BOARD, *seen_from(shots, focal_35=40.0))
    assert found.camera.matrix[0, 0] == pytest.approx(1000) and "EXIF" in found.notes[0] and found.model == "k1, focal length of EXIF"
    with pytest.raises(FitError, match="name no focal length"):
        calibrate(BOARD, *seen_from(shots[:2]))


def test_a_board_that_was_bent_is_named_and_the_others_go_on():
    photographs, detections = seen_from(around(12, 10, 55))
    bent = detections[4].pixels.copy()
    bent[:, 0] += 0.06 * (bent[:, 1] - 300) ** 2 / 300
    detections[4] = dataclasses.replace(detections[4], pixels=bent)
    strayed = detections[7].pixels.copy()
    strayed[3] += (6, -4)  # one corner, as behind the rim of a sphere
    detections[7] = dataclasses.replace(detections[7], pixels=strayed)
    found = calibrate(BOARD, photographs, detections)
    assert list(found.outliers) == [4] and "does not lie in it as in the others" in found.outliers[4] and 4 not in found.poses
    assert found.rms == pytest.approx(0.21, abs=0.03) and found.residuals[4] > 1 and len(found.poses) == 11


def test_bad_photographs_do_not_count_and_none_at_all_is_an_error():
    photographs, detections = seen_from(around(4, 10, 50))
    detections[1] = Detection(np.zeros(0, int), np.zeros((0, 2)), np.nan, "no board")
    assert sorted(calibrate(BOARD, photographs, detections).poses) == [0, 2, 3]
    with pytest.raises(FitError, match="none of 1 does; the first, .*--series"):
        calibrate(BOARD, photographs[:1], detections[1:2])


@pytest.mark.parametrize("change", [{"camera": "other"}, {"focal": 50.0}])
def test_photographs_of_two_cameras_are_named(change):
    photographs, _ = seen_from(around(3, 0, 30))
    photographs[1] = dataclasses.replace(photographs[1], path=Path("b.jpg"), exif=photographs[1].exif._replace(**change))
    with pytest.raises(DataError, match="photo_0.jpg, photo_2.jpg; .*b.jpg"):
        check_one_camera(photographs)
    other = dataclasses.replace(photographs[0], size=(600, 400))
    with pytest.raises(DataError, match="600 x 400"):
        check_one_camera([photographs[0], other])


def test_a_pose_is_that_of_the_studio():
    shot = around(1, 50, 50)[0]
    _, (detection,) = seen_from([shot], noise=0)
    lens = Lens()
    camera = Camera(lens.matrix, np.array(lens.distortion), lens.size)
    pose = solve_pose(seen(BOARD, detection), camera)
    assert pose.position == pytest.approx(np.array(shot.position), abs=1e-3) and pose.rotation == pytest.approx(shot.rotation, abs=1e-6)
    assert seen(BOARD, detection).errors(camera, pose).max() < 1e-4


def test_camera_and_pose_as_numbers():
    lens, shot = Lens(), around(1, 40, 40)[0]
    camera, pose = Camera(lens.matrix, np.array(lens.distortion), lens.size), Pose(shot.rotation, shot.translation)
    points = np.random.default_rng(0).uniform(-60, 60, (5, 7, 3))
    pixels = pose.project(camera, points)
    assert pixels == pytest.approx(Studio(matte_grey(), lens=lens, texels=(2, 2)).pixels_of(shot, points), abs=1e-9)
    assert pose.position == pytest.approx(np.array(shot.position)) and pose.views(points) == pytest.approx(-pose.rays(camera, pixels), abs=1e-7)
    assert np.isnan(camera.project(np.array([0.0, 0, -1]))).all()


def test_the_scale_bar_is_never_passed_over_in_silence():
    board, said = printed(Board(), None)
    assert board == Board() and "not measured" in said
    board, said = printed(Board(), 150.4)
    assert board.scale == pytest.approx(150.4 / 150) and said == "the scale bar has 150.4 of its 150 mm"
    board, said = printed(Board(), 141.0)
    assert board.scale == pytest.approx(0.94) and "6.0% smaller" in said
    with pytest.raises(RangeError, match="in millimetres"):
        printed(Board(), 15.0)


def test_a_camera_on_a_stand_is_one_view_and_moved_ones_are_their_own():
    rng = np.random.default_rng(0)
    stood, moved = np.array([30.0, -200.0, 350.0]), np.array([[0.0, 0.0, 400.0], [5.0, 0.0, 400.0], [-250.0, 40.0, 310.0]])
    jittered = stood + rng.normal(scale=0.1, size=(12, 3))
    found = stations(np.concatenate((jittered[:5], moved, jittered[5:])))
    shared = np.delete(found, [5, 6, 7], axis=0)
    assert (shared == shared[0]).all() and np.allclose(shared[0], jittered.mean(axis=0))
    assert (found[5:8] == moved).all() and len(np.unique(found, axis=0)) == 4
    assert (stations(moved[:1]) == moved[:1]).all()
