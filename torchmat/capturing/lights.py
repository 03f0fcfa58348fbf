"""Where lights come from that nobody need measure: beside the lens, in a table, in a dome's file, as given positions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchmat.btf.dome import is_dome, parse_dome
from torchmat.btf.light_table import read_light_table
from torchmat.capturing.light import Light
from torchmat.capturing.view import Pose
from torchmat.errors import DataError, RangeError, check_positive, message
from torchmat.text_file import read_text

_GIVEN = 1.0  # degrees, of a table whose maker says nothing of its errors
_FLASH = 5.0  # mm, of an offset that was read off a phone


def flash(pose: Pose, offset: Sequence[float] = (0.0, 0.0, 0.0)) -> Light:
    """Return the flash beside the lens: at an `offset` (x, y, z) in mm from the camera's centre, in the camera's frame.

    x is right and y down in the frame of the sensor, z forward. Raises RangeError when it is no three numbers.
    """
    if len(offset) != 3 or not np.isfinite(offset).all():
        step = "Give x (right), y (down) and z (forward) from lens to flash, in mm."
        raise RangeError(message("capture", "the flash's offset", "be three numbers", f"it is {tuple(offset)!r}", step))
    position = pose.position + pose.rotation.T @ np.asarray(offset, float)
    return _at(position, _FLASH**2 * np.eye(3), "the flash beside the lens")


def _at(position: np.ndarray, covariance: np.ndarray, how: str) -> Light:
    distance = float(np.linalg.norm(position))
    along = position / distance
    across = np.eye(3) - np.outer(along, along)
    sigma = float(np.degrees(np.sqrt(np.trace(across @ covariance @ across) / 2) / distance))
    return Light(along, sigma, position, covariance, None, how)


def lights_of_table(path: str | Path, names: Sequence[str], *, positions: bool = False, distance: float | None = None) -> list[Light]:
    """Return the lights of photographs, by their `names`, from a table (`.lp`, CSV, columns) or a dome (`.dome`, JSON).

    Args:
        path: the file. A table without names counts in the photographs' order, as a dome does.
        names: the photographs' file names.
        positions: whether the table's x, y, z are positions in mm from the window's middle.
        distance: of all lights from the window's middle in mm: a dome's radius, for tables of directions.

    Raises DataError, which names the file and the line, when it cannot be read, when a photograph has no line, or when a light
    is not above the sample's plane.
    """
    where = str(path)
    if distance is not None:
        check_positive(where, "distance", distance, "It is that of the lamps from the window's middle, in mm.")
    table = parse_dome(where, read_text(path, "the lights")) if is_dome(str(path)) else read_light_table(path, images=len(names))
    vectors, near, lines = table.light.numpy(), positions or table.near, table.where
    order = _in_order(where, len(vectors), names) if table.names is None else _by_name(where, table.names, names)
    found = []
    for number in order:
        vector = vectors[number]
        length = float(np.linalg.norm(vector))
        if not vector[2] > 0:
            fact = f"it is ({', '.join(f'{one:g}' for one in vector)})"
            raise DataError(message(lines[number], "the light", "be above the sample's plane", fact, "Its z must be positive: check the axes."))
        direction = vector / length
        if near or distance is not None:
            position = vector if near else direction * float(distance or 0)
            sigma = np.radians(_GIVEN) * float(np.linalg.norm(position))
            found.append(_at(position, sigma**2 * np.eye(3), f"positions of {Path(path).name}" if near else f"{Path(path).name} at {distance:g} mm"))
        else:
            found.append(Light(direction, _GIVEN, how=Path(path).name))
    return found


def _in_order(where: str, count: int, names: Sequence[str]) -> list[int]:
    if count != len(names):
        fact = f"there are {count} lights for {len(names)} photographs"
        raise DataError(message(where, "the lights", "be as many as the photographs", fact, "Name each photograph in the table."))
    return list(range(count))


def _by_name(where: str, listed: Sequence[str], names: Sequence[str]) -> list[int]:
    def key(name: str) -> str:
        return Path(name.replace("\\", "/")).stem.casefold()

    places: dict[str, int] = {}
    for number, name in enumerate(listed):
        if key(name) in places:
            fact = f"{name!r} stands twice" if listed[places[key(name)]] == name else f"{listed[places[key(name)]]!r} and {name!r} are one name"
            raise DataError(message(where, "the table", "name each photograph once", fact, "Remove one of the lines."))
        places[key(name)] = number
    missing = [name for name in names if key(name) not in places]
    if missing:
        fact = f"{len(missing)} of {len(names)} have none, the first is {missing[0]!r}"
        raise DataError(message(where, "the table", "have a light for each photograph", fact, "Add the lines, or take the photographs out."))
    return [places[key(name)] for name in names]
