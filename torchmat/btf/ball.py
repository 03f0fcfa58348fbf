"""Lights from photographs of a chrome ball, each checked: its circle, its one highlight, its light above the surface."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.btf.lit import in_order
from torchmat.btf.photographs import read_linear
from torchmat.btf.source import Folder
from torchmat.errors import DataError, RangeError, message
from torchmat.geometry.photometric_stereo import find_highlight, lights_from_ball
from torchmat.progress import progress

_OUTSIDE = 0.05  # of the radius may the circle leave the picture
_STEP = "Check the circle (column, row, radius in pixels of the photographs as they are shown)."


class BallLights(NamedTuple):
    """What photographs of a ball show: `files` [n] in their order, `highlight` [n, 2] (column, row), `light` [n, 3] unit;
    `good` [n], bool, says which are to be trusted, `faults` what is wrong with the others, each the text of an error."""

    files: list[str]
    highlight: Tensor
    light: Tensor
    good: Tensor
    faults: tuple[str, ...]


def ball_lights(
    folder: str | Path, centre: tuple[float, float], radius: float, show: bool | None = None
) -> BallLights:
    """Return the lights that the photographs of a chrome ball in `folder` show; `centre` (column, row), in pixels.

    Raises DataError or RangeError, which names the photograph, where the circle does not lie in it or no one highlight
    stands out; a highlight that puts the light below the surface is a fault.
    """
    source = Folder(Path(folder))
    files, _ = in_order(source)
    highlights, lights, faults = [], [], []
    for file in progress(files, "looking at the ball", show=show):
        where = f"{folder}: {file}"
        image = read_linear(source.path / file)
        _check_circle(where, image, centre, radius)
        try:
            highlight = find_highlight(image, centre, radius)
            light = lights_from_ball(highlight[None], centre, radius)[0]
        except (DataError, RangeError) as error:
            raise type(error)(f"{where}: {error}") from error
        if float(light[2]) <= 0:
            fact = f"the highlight is at column {float(highlight[0]):.0f}, row {float(highlight[1]):.0f}: its light has z {float(light[2]):.2f}"
            step = f"{_STEP} skip_bad_lights=True (--skip-bad-lights) leaves such photographs out."
            faults.append(message(where, "the ball's light", "be above the surface", fact, step))
        highlights.append(highlight)
        lights.append(light)
    light = torch.stack(lights)
    return BallLights(files, torch.stack(highlights), light, light[:, 2] > 0, tuple(faults))


def _check_circle(where: str, image: Tensor, centre: tuple[float, float], radius: float) -> None:
    height, width = image.shape[-2:]
    reach = radius * (1 - _OUTSIDE) - 1
    sides = (centre[0] - reach, centre[1] - reach, width - 1 - centre[0] - reach, height - 1 - centre[1] - reach)
    if not radius > 1 or min(sides) < 0:
        fact = f"centre ({centre[0]:g}, {centre[1]:g}), radius {radius:g} for a picture {width} wide and {height} high"
        raise RangeError(message(where, "the ball's circle", "lie inside the photograph", fact, _STEP))
