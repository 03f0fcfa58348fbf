"""Many pictures together: side by side on a sheet, or one after the other in an animated file; and how to turn."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchmat import colour
from torchmat.errors import RangeError, ShapeError, check_finite, check_positive, message
from torchmat.frames import from_polar
from torchmat.images import write_frames


def contact_sheet(
    pictures: Sequence[Tensor], columns: int | None = None, gap: int = 4, background: float | Sequence[float] = 1.0
) -> Tensor:
    """Return linear pictures [3, H, W] of one size side by side, row by row, as one picture [3, H', W'].

    `columns` defaults to as many as make the grid square; `gap` pixels of `background`, a linear grey or RGB, lie
    between them, and the background fills a last row that is not full. Raises RangeError without pictures and for a
    grid that cannot be, ShapeError for pictures of different sizes.
    """
    where = "contact_sheet"
    pictures = list(pictures)
    if not pictures:
        raise RangeError(message(where, "pictures", "be at least one", "there is none"))
    columns = math.ceil(math.sqrt(len(pictures))) if columns is None else columns
    if columns < 1 or gap < 0:
        fact = f"they are {columns} and {gap}"
        raise RangeError(message(where, "columns and gap", "be at least 1 and at least 0", fact))
    for number, picture in enumerate(pictures):
        _check_picture(where, number, picture, pictures[0].shape)
    shade = torch.as_tensor(background, dtype=pictures[0].dtype)
    if shade.shape not in ((), (3,)):
        fact = f"its shape is {tuple(shade.shape)}"
        raise ShapeError(message(where, "background", "be one number or three", fact))
    height, width = pictures[0].shape[-2:]
    columns = min(columns, len(pictures))
    rows = math.ceil(len(pictures) / columns)
    size = (3, rows * (height + gap) - gap, columns * (width + gap) - gap)
    sheet = shade.reshape(-1, 1, 1).expand(size).clone()
    for number, picture in enumerate(pictures):
        top, left = number // columns * (height + gap), number % columns * (width + gap)
        sheet[:, top : top + height, left : left + width] = picture
    return sheet


def _check_picture(where: str, number: int, picture: Tensor, first: torch.Size) -> None:
    if picture.ndim != 3 or picture.shape[0] != 3 or 0 in picture.shape:
        raise ShapeError(message(where, f"picture {number}", "be [3, H, W]", f"it is {tuple(picture.shape)}"))
    if picture.shape != first:
        fact = f"picture {number} is {tuple(picture.shape[1:])} and picture 0 is {tuple(first[1:])}"
        raise ShapeError(message(where, "pictures", "have one size", fact, "Render all at the same size."))


def write_animation(
    pictures: Iterable[Tensor], path: str | Path, seconds_per_frame: float = 0.1, exposure: float = 1.0,
    loop: bool = True,
) -> Path:
    """Write linear pictures [3, H, W] times `exposure` as moving 8-bit sRGB; return the path.

    The suffix decides: .png or .apng keeps every colour (animated PNG, which browsers play), .gif is for viewers that
    know no other and has 255 dithered colours a frame. `pictures` may be a generator: each is written as it comes and
    none is kept. A frame stands for 0.02 to 600 seconds, in hundredths; `loop` False plays once. The file appears when
    the last frame is written, and one that was there before stays until then. Raises ShapeError for pictures of
    different sizes, RangeError for none or a wrong option, DataError for an unknown suffix or a folder that cannot be
    written to.
    """
    path = Path(path)
    check_positive(str(path), "exposure", exposure)
    write_frames(path, _shown(str(path), pictures, exposure), seconds_per_frame, loop)
    return path


def _shown(where: str, pictures: Iterable[Tensor], exposure: float) -> Iterator[np.ndarray]:
    """Yield pictures as 8-bit sRGB frames [H, W, 3]."""
    shape = None
    for number, picture in enumerate(pictures):
        shape = picture.shape if shape is None else shape
        _check_picture(where, number, picture, shape)
        check_finite(where, f"picture {number}", picture, "Look for a direction or a map that is NaN.")
        codes = (colour.display(picture.detach() * exposure) * 255).round()
        yield codes.permute(1, 2, 0).numpy().astype(np.uint8)


def _check_turn(where: str, count: int, **angles: float) -> None:
    if count < 1:
        raise RangeError(message(where, "count", "be at least 1", f"it is {count}"))
    for name, angle in angles.items():
        if not abs(angle) <= 2 * math.pi:
            step = "Angles are radians; math.radians turns degrees into them."
            raise RangeError(message(where, name, "lie in [-2 pi, 2 pi]", f"it is {angle}", step))


def directions_on_circle(
    count: int, polar: float, start: float = 0.0, turn: float = 2 * math.pi, dtype: torch.dtype = torch.float32
) -> Tensor:
    """Return unit directions [count, 3] in equal steps around +z, which looks at the viewer: a light that goes round.

    All stand `polar` from +z; the first at azimuth `start` from +x toward +y, the others in steps of `turn` / count,
    so that a whole turn closes without a frame shown twice. Radians. Raises RangeError for a count below 1 or angles
    beyond a turn.
    """
    _check_turn("directions_on_circle", count, polar=polar, start=start, turn=turn)
    azimuth = start + turn * torch.arange(count, dtype=torch.float64) / count
    return from_polar(torch.full_like(azimuth, polar), azimuth).to(dtype)


def directions_on_arc(
    count: int, azimuth: float = 0.0, reach: float = math.radians(85), dtype: torch.dtype = torch.float32
) -> Tensor:
    """Return unit directions [count, 3] from horizon to horizon through +z: a light that passes over.

    The first stands `reach` from +z on the side away from `azimuth`, the last as far on the side of it, both included;
    a single one is +z. Radians. Raises RangeError for a count below 1 or angles beyond a turn.
    """
    _check_turn("directions_on_arc", count, azimuth=azimuth, reach=reach)
    polar = torch.linspace(-reach, reach, count, dtype=torch.float64) if count > 1 else torch.zeros(1).double()
    return from_polar(polar, torch.full_like(polar, azimuth)).to(dtype)


def turntable_directions(
    count: int, elevation: float = 0.0, start: float = 0.0, dtype: torch.dtype = torch.float32
) -> Tensor:
    """Return unit directions [count, 3] from an object to a camera that goes once round it, y up.

    The camera stands `elevation` above the plane y = 0, first over +z (so that it looks along -z, as cameras do) when
    `start` is 0, then toward +x, in equal steps that do not repeat the first. Radians. Raises RangeError for a count
    below 1 or an elevation beyond the poles.
    """
    where = "turntable_directions"
    _check_turn(where, count, elevation=elevation, start=start)
    if not abs(elevation) <= math.pi / 2:
        raise RangeError(message(where, "elevation", "lie in [-pi/2, pi/2]", f"it is {elevation}"))
    azimuth = start + 2 * math.pi * torch.arange(count, dtype=torch.float64) / count
    across, up = math.cos(elevation), math.sin(elevation)
    around = (across * torch.sin(azimuth), torch.full_like(azimuth, up), across * torch.cos(azimuth))
    return torch.stack(around, dim=1).to(dtype)
