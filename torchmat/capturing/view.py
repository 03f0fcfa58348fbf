"""Camera and pose as numbers: from millimetres to pixels and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_STEPS = 20  # of the inversion of the distortion; six do for a lens of a phone


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole with a lens, in OpenCV's model: pixel centres are whole numbers, the camera looks along +z, y is down.

    Args:
        matrix: [3, 3] of focal lengths and principal point, in pixels.
        distortion: [5], k1, k2, p1, p2, k3.
        size: width and height in pixels.
    """

    matrix: np.ndarray
    distortion: np.ndarray
    size: tuple[int, int]

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels [..., 2] (column, row) of points [..., 3] in the camera's frame; NaN behind it."""
        depth = points[..., 2:]
        distorted = self.distort(points[..., :2] / np.where(depth > 0, depth, np.nan))
        return distorted @ self.matrix[:2, :2].T + self.matrix[:2, 2]

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Return the unit directions [..., 3], in the camera's frame, from the camera to what pixels [..., 2] show."""
        distorted = (pixels - self.matrix[:2, 2]) @ np.linalg.inv(self.matrix[:2, :2]).T
        plane = self.undistort(distorted)
        ray = np.concatenate((plane, np.ones_like(plane[..., :1])), axis=-1)
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True)

    def distort(self, plane: np.ndarray) -> np.ndarray:
        """Return where the lens puts points [..., 2] of the plane at distance 1."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = plane[..., 0], plane[..., 1]
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        across = 2 * x * y
        return np.stack((x * radial + p1 * across + p2 * (square + 2 * x * x), y * radial + p1 * (square + 2 * y * y) + p2 * across), axis=-1)

    def undistort(self, distorted: np.ndarray) -> np.ndarray:
        """Return the points [..., 2] of the plane at distance 1 that the lens puts to `distorted` (fixed-point iteration)."""
        plane = distorted
        for _ in range(_STEPS):
            plane = plane - (self.distort(plane) - distorted)
        return plane


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the camera stands: a point p in millimetres of the board is `rotation` @ p + `translation` in its frame.

    Args:
        rotation: [3, 3].
        translation: [3] in millimetres.
    """

    rotation: np.ndarray
    translation: np.ndarray

    @property
    def position(self) -> np.ndarray:
        """The camera's position [3] in millimetres of the board's frame."""
        return -self.rotation.T @ self.translation

    def to_camera(self, points: np.ndarray) -> np.ndarray:
        """Return points [..., 3] of the board's frame in the camera's."""
        return points @ self.rotation.T + self.translation

    def project(self, camera: Camera, points: np.ndarray) -> np.ndarray:
        """Return the pixels [..., 2] of points [..., 3] in millimetres of the board's frame."""
        return camera.project(self.to_camera(points))

    def rays(self, camera: Camera, pixels: np.ndarray) -> np.ndarray:
        """Return the unit directions [..., 3], in the board's frame, from the camera to what pixels [..., 2] show."""
        return camera.rays(pixels) @ self.rotation

    def views(self, points: np.ndarray) -> np.ndarray:
        """Return the unit directions [..., 3] from points [..., 3] towards the camera, in the board's frame."""
        towards = self.position - points
        return towards / np.linalg.norm(towards, axis=-1, keepdims=True)
