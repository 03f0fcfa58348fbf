"""One lamp as it lights the board: near or far, its directions and its fall-off at points, and which of them spheres shade."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Light:
    """A lamp: its `direction` [3] (unit) as seen from the window's middle, known to `sigma_deg` degrees.

    `position` [3] in mm with the `covariance` [3, 3] in mm^2 where it is near; None where it is taken for infinitely far.
    `how` says what it was found by, and `residual` is what would show a wrong guess: of mirror spheres the mm by which their
    rays miss each other, of shading the relative deviation of the paper's brightness.
    """

    direction: np.ndarray
    sigma_deg: float
    position: np.ndarray | None = None
    covariance: np.ndarray | None = None
    residual: float | None = None
    how: str = ""
    notes: tuple[str, ...] = ()

    @property
    def distance(self) -> float | None:
        """The distance in mm from the window's middle; None where it is far."""
        return None if self.position is None else float(np.linalg.norm(self.position))

    def directions(self, points: np.ndarray) -> np.ndarray:
        """Return the unit directions [..., 3] to the lamp from points [..., 3] in mm."""
        if self.position is None:
            return np.broadcast_to(self.direction, points.shape)
        towards = self.position - points
        return towards / np.linalg.norm(towards, axis=-1, keepdims=True)

    def strength(self, points: np.ndarray) -> np.ndarray:
        """Return the irradiance [...] across the direction to the lamp at points [..., 3], 1 at the window's middle.

        A near lamp falls off with the square of the distance, (d0 / d)^2 with the distance d0 of the middle, so that a lamp
        that moves away changes nothing.
        """
        if self.position is None:
            return np.ones(points.shape[:-1])
        return self.position @ self.position / ((self.position - points) ** 2).sum(-1)

    def irradiance(self, points: np.ndarray) -> np.ndarray:
        """Return the irradiance [...] of the paper at points [..., 3]: the strength times the cosine, at least 0."""
        return self.strength(points) * np.maximum(self.directions(points)[..., 2], 0)


def blocked(points: np.ndarray, directions: np.ndarray, centres: np.ndarray, radius: float) -> np.ndarray:
    """Return which points [..., 3] have one of the spheres (`centres` [n, 3], mm) in the way of their `directions` [..., 3]."""
    found = np.zeros(points.shape[:-1], bool)
    for centre in centres:
        towards = centre - points
        along = (towards * directions).sum(-1)
        found |= (along > 0) & ((towards**2).sum(-1) - along**2 < radius**2)
    return found
