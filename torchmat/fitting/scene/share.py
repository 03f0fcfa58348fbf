"""How much of the data a fit for a scene looked at."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SceneShare:
    """Samples and texels that were fitted, as numbers and as shares of all.

    The images were halved `halved` times; `window` is top, left, height, width in texels, None for all of them;
    `outside_measured_share` the share of the use that lies beyond the measured directions.
    """

    samples: int
    samples_share: float
    texels: int
    texels_share: float
    halved: int
    window: tuple[int, int, int, int] | None
    outside_measured_share: float
