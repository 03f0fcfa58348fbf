"""What the steps of a capture hand to each other: the photographs with their cameras and poses, and what a step says of itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from torch import Tensor

from torchmat.capturing.board import Board
from torchmat.capturing.photographs import Photograph
from torchmat.capturing.view import Camera, Pose


@dataclass(frozen=True, eq=False)
class Scene:
    """Photographs of a board whose camera and pose are known: one of each for every photograph, in the same order."""

    board: Board
    photographs: tuple[Photograph, ...]
    cameras: tuple[Camera, ...]
    poses: tuple[Pose, ...]

    def picked(self, kept: Sequence[int]) -> Scene:
        """Return the scene of some of the photographs, by their numbers."""
        photographs = tuple(self.photographs[index] for index in kept)
        return Scene(self.board, photographs, tuple(self.cameras[index] for index in kept), tuple(self.poses[index] for index in kept))


@dataclass(frozen=True, eq=False)
class Step:
    """What a step of a capture found.

    Args:
        name: of the step, as the table shows it.
        found: what it found, in one line.
        residual: the figure that would show that it went wrong, with its unit.
        figures: for ``capture.json``.
        header, rows: a table of it for the page, "" and () for none.
        pictures: planes [3, H, W] as display values 0 to 1, by their captions.
        notes: what was guessed, left out or taken otherwise; one sentence each.
    """

    name: str
    found: str
    residual: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)
    header: Sequence[str] = ()
    rows: Sequence[Sequence[Any]] = ()
    pictures: Mapping[str, Tensor] = field(default_factory=dict)
    notes: Sequence[str] = ()


class Photometry(Protocol):
    """Light and colour of photographs: the other half of a capture, which asks for a `Scene` and is asked for this."""

    @property
    def steps(self) -> Sequence[Step]:
        """What was found, for the table and the page."""
        ...

    @property
    def light(self) -> np.ndarray:
        """Unit directions [n, 3] from the window's centre."""
        ...

    @property
    def position(self) -> np.ndarray | None:
        """Positions [n, 3] in mm of lamps, NaN of far ones; None where all are far."""
        ...

    @property
    def keep(self) -> Sequence[bool]:
        """Which photographs have a light; a step's notes say why others have none."""
        ...

    def correct(self, index: int, pixels: Tensor) -> Tensor:
        """Return a photograph's pixels [3, H, W] without vignetting, in common exposure, white and colour."""
        ...

    def irradiance(self, index: int, points: np.ndarray) -> np.ndarray:
        """Return by what values at points [..., 3] in mm are divided: the lamp's irradiance [..., 1 or 3] there, 1 on average."""
        ...
