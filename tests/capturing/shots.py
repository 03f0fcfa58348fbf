"""The lens, the lamps and the shots of the simulated studio."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import RectBivariateSpline

_STEP = 16  # pixels between the nodes at which the lens is inverted exactly


@dataclass(frozen=True)
class Lens:
    """A camera: `size` (width, height), `focal` and `principal` in pixels (None: the middle), `distortion` k1, k2, p1, p2, k3."""

    size: tuple[int, int] = (900, 600)
    focal: float = 1000.0
    principal: tuple[float, float] | None = None
    distortion: tuple[float, float, float, float, float] = (-0.12, 0.05, 0.0008, -0.0006, 0.0)

    @property
    def matrix(self) -> np.ndarray:
        cx, cy = self.principal or ((self.size[0] - 1) / 2, (self.size[1] - 1) / 2)
        return np.array([[self.focal, 0, cx], [0, self.focal, cy], [0, 0, 1.0]])

    def bent(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where points of the plane at distance 1 come to lie behind the lens (Brown's model)."""
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y

    def straight(self, columns: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points [rows, columns] of the plane at distance 1 that a grid of pixels shows."""
        return tuple(one(rows, columns).astype(np.float32) for one in _inverse(self))


@lru_cache(maxsize=8)
def _inverse(lens: Lens) -> tuple[RectBivariateSpline, RectBivariateSpline]:
    """Return splines, of row and column, of the points of the plane at distance 1 that pixels show."""
    nodes = [np.linspace(-1, size, math.ceil(size / _STEP) + 2) for size in lens.size]
    bent = [(nodes[0][None] - lens.matrix[0, 2]) / lens.focal, (nodes[1][:, None] - lens.matrix[1, 2]) / lens.focal]
    x, y = (np.broadcast_to(one, (len(nodes[1]), len(nodes[0]))).copy() for one in bent)
    for _ in range(30):
        u, v = lens.bent(x, y)
        x, y = x + bent[0] - u, y + bent[1] - v
    return RectBivariateSpline(nodes[1], nodes[0], x), RectBivariateSpline(nodes[1], nodes[0], y)


@dataclass(frozen=True)
class Lamp:
    """A lamp at a `position` in mm, or with `far` in its direction; its `colour` is the irradiance at the window's centre.

    `radius` in mm is what spheres see of it; `lobe` is the exponent of the cosine by which it is dimmer beside its axis, and `gradient`
    by how much more it gives per metre to the right and up: uneven light.
    """

    position: tuple[float, float, float]
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    radius: float = 15.0
    far: bool = False
    lobe: float = 0.0
    gradient: tuple[float, float] = (0.0, 0.0)

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return unit directions [..., 3] to the lamp, its distance in mm and its irradiance [...] where it shines straight, by points in mm."""
        place = np.asarray(self.position, points.dtype)
        reach = np.linalg.norm(place)
        towards = np.broadcast_to(place, points.shape) if self.far else place - points
        distance = np.linalg.norm(towards, axis=-1)
        light = towards / distance[..., None]
        strength = np.ones_like(distance) if self.far else (reach / distance) ** 2 * np.maximum(light @ (place / reach), 0) ** self.lobe
        return light, distance, strength * (1 + (points[..., :2] @ np.asarray(self.gradient, points.dtype)) / 1000)


@dataclass(frozen=True)
class Shot:
    """One photograph to take: where the camera is in mm, what it looks at, its roll in degrees, the lamp, and the exposure.

    `sample_moved` is how far the sample was moved on the board: (x, y) in mm, and an angle in degrees about the window's centre.
    """

    position: tuple[float, float, float]
    lamp: Lamp
    exposure: float = 0.8
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    roll: float = 0.0
    sample_moved: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def rotation(self) -> np.ndarray:
        """[3, 3], of the board's frame to the camera's: x right, y down, z forward."""
        forward = np.asarray(self.target, float) - self.position
        forward /= np.linalg.norm(forward)
        up = np.array([0.0, 1, 0]) if abs(forward[1]) < 0.99 else np.array([0.0, 0, 1])
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        c, s = math.cos(math.radians(self.roll)), math.sin(math.radians(self.roll))
        return np.stack((c * right + s * down, c * down - s * right, forward))

    @property
    def translation(self) -> np.ndarray:
        return -self.rotation @ np.asarray(self.position, float)


def beside_lens(shot: Shot, offset: tuple[float, float, float] = (40.0, 0.0, 0.0), **lamp) -> Lamp:
    """Return a flash at an offset in mm from the lens, in the camera's frame."""
    return Lamp(tuple(np.asarray(shot.position) + np.asarray(offset) @ shot.rotation), **lamp)


def shots_around(polar_deg: list[float], azimuth_deg: list[float], distance: float, lamps: list[Lamp], **more) -> list[Shot]:
    """Return shots from directions as seen from the window's centre, at a distance in mm, one for each lamp."""
    shots = []
    for polar, azimuth, lamp in zip(np.radians(polar_deg), np.radians(azimuth_deg), lamps, strict=True):
        place = distance * np.array([math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar)])
        shots.append(Shot(tuple(place), lamp, **more))
    return shots
