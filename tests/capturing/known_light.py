"""The light of simulated photographs as it is, for tests of the steps before and after it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from tests.capturing.shots import Shot
from torch import Tensor

from torchmat.capturing.scene import Scene, Step


class KnownLight:
    """A photometry that knows the shots, by the photographs' names."""

    def __init__(self, shots: dict[str, Shot], scene: Scene, unlit: Sequence[str] = ()) -> None:
        self._shots = [shots[one.name] for one in scene.photographs]
        self.steps = [Step("light", "as it is")]
        self.position = np.array([shot.lamp.position for shot in self._shots])
        self.light = self.position / np.linalg.norm(self.position, axis=1, keepdims=True)
        self.keep = [one.name not in unlit for one in scene.photographs]

    def correct(self, index: int, pixels: Tensor) -> Tensor:
        return pixels / self._shots[index].exposure

    def irradiance(self, index: int, points: np.ndarray) -> np.ndarray:
        _, _, strength = self._shots[index].lamp.at(points)
        return strength[..., None] * np.array(self._shots[index].lamp.colour)
