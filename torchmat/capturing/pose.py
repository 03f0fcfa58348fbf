"""Where the camera stood: the pose of each photograph in millimetres of the board, as large as it was printed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from torchmat.capturing.board import Board
from torchmat.capturing.detect import Detection
from torchmat.capturing.extra import opencv
from torchmat.capturing.view import Camera, Pose
from torchmat.errors import RangeError, message

_STATION = 0.003  # of its distance, 0.17 degrees: nobody who means another view moves less, and corners do not tell a pose better by far
_OFF, _FAR_OFF = 0.02, 0.25  # of the nominal length: what is said, and what is more likely a mistake in measuring


class Seen(NamedTuple):
    """Corners of the board in one photograph: `places` [k, 2] in mm, and the `pixels` [k, 2] that show them."""

    places: np.ndarray
    pixels: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """The places as points [k, 3] of the board's plane."""
        return np.column_stack((self.places, np.zeros(len(self.places))))

    def errors(self, camera: Camera, pose: Pose) -> np.ndarray:
        """Return by how many pixels [k] the corners are beside where a camera in a pose would show them."""
        return np.linalg.norm(pose.project(camera, self.points) - self.pixels, axis=1)


def seen(board: Board, detection: Detection) -> Seen:
    """Return the corners that a detection found."""
    return Seen(board.corners[detection.corners], detection.pixels)


def solve_pose(corners: Seen, camera: Camera) -> Pose:
    """Return the pose in which a camera sees corners at their pixels.

    Of the two poses that a plane has nearly alike (Collins and Bartoli 2014) the one with the smaller residual, refined.
    """
    cv2 = opencv()
    _, turns, shifts, _ = cv2.solvePnPGeneric(corners.points, corners.pixels, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE)
    poses = []
    for turn, shift in zip(turns, shifts, strict=True):
        turn, shift = cv2.solvePnPRefineLM(corners.points, corners.pixels, camera.matrix, camera.distortion, turn.astype(float), shift.astype(float))
        poses.append(Pose(cv2.Rodrigues(turn)[0], shift.reshape(3)))
    above = [pose for pose in poses if pose.position[2] > 0] or poses
    return min(above, key=lambda pose: float((corners.errors(camera, pose) ** 2).sum()))


def stations(positions: np.ndarray) -> np.ndarray:
    """Return positions [n, 3] of cameras in mm, those of a camera that stood still as one, their mean.

    On a stand each pose comes out a little different by its corners' noise; taken as they are, they would be as many views.
    """
    if len(positions) < 2:
        return positions
    limit = _STATION * float(np.median(np.linalg.norm(positions, axis=1)))
    station = fcluster(linkage(positions, "complete"), limit, "distance")
    return np.stack([positions[station == one].mean(axis=0) for one in station])


def printed(board: Board, measured: float | None) -> tuple[Board, str]:
    """Return the board as it was printed, from the `measured` length of its scale bar in mm, and what is to be said of that.

    Raises RangeError where the length cannot be that of a printed board.
    """
    nominal = board.bar_length
    if measured is None:
        return board, f"the scale bar was not measured: its {nominal:g} mm are taken as printed at 100 %"
    share = measured / nominal
    if not abs(share - 1) <= _FAR_OFF:
        fact = f"it is {measured:g}, {share:.0%} of its nominal {nominal:g} mm"
        step = "Measure the bar below the board from end to end, in millimetres; check the paper's size (--size) too."
        raise RangeError(message("capture", "the measured length of the scale bar", "be within a quarter of the nominal one", fact, step))
    off = f": {abs(share - 1):.1%} {'larger' if share > 1 else 'smaller'} than it should be, and all lengths follow" if abs(share - 1) > _OFF else ""
    return board.measured(measured), f"the scale bar has {measured:g} of its {nominal:g} mm{off}"
