"""What the steps of a capture hand to each other: the photographs with their cameras and poses, and what a step says of itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from torch import Tensor

from torchmat.capture.board import Board
from torchmat.capture.photographs import Photograph
from torchmat.capture.view import Camera, Pose


@dataclass(frozen=True, eq=False)
class Scene:
    """Photographs of a board whose camera and pose are known: one of each for every photograph, in the same order."""

    board: Board
    photographs: tuple[Photograph, ...]
    cameras: tuple[Camera, ...]
    poses: tuple[Pose, ...]


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

    steps: Sequence[Step]
    light: np.ndarray  # [n, 3], unit directions from the window's centre
    position: np.ndarray | None  # [n, 3] in mm where lamps are near
    keep: Sequence[bool]  # [n], false for photographs that cannot be used; a step's notes say why

    def correct(self, index: int, pixels: Tensor) -> Tensor:
        """Return a photograph's pixels [3, H, W] without vignetting, in common exposure, white and colour."""
        ...

    def irradiance(self, index: int, points: np.ndarray) -> np.ndarray:
        """Return by what values at points [..., 3] in mm are divided: the lamp's irradiance [..., 1 or 3] there, 1 on average."""
        ...
