"""Scenes as files: the TOML that a fit and a picture share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from torchmat.errors import DataError, RangeError, TorchmatError, check_known_keys, message
from torchmat.rendering.camera import Camera
from torchmat.rendering.lights import Directional, Light, Point
from torchmat.rendering.scene import Scene
from torchmat.rendering.shapes import SHAPES
from torchmat.shipped import find_file, shipped_folder
from torchmat.text_file import read_toml

_KEYS = ("mesh", "lights", "camera", "view", "size", "repeat", "shadows", "rays", "edges_only")
_CAMERA_KEYS = ("position", "target", "up", "field_of_view_deg", "width")
_LIGHT_KEYS = ("direction", "position", "intensity")


def load_scene(path: str | Path) -> Scene:
    """Read a scene: the arguments of `Scene` as TOML; `path` may be the name of one that ships, such as "teapot.toml".

    `mesh` is a shape or a file, whose path counts from the scene's; `[[lights]]` have a `direction` or a `position`,
    and an `intensity`; `[camera]` has a `position`, and `target`, `up`, `field_of_view_deg` or `width`; `view`, `size`
    (a number or rows and columns), `repeat`, `shadows`, `rays` and `edges_only` are as of `render`. Raises DataError,
    naming the file, for what is missing, unknown or of another kind.
    """
    path = find_file(path, "scenes")
    table = read_toml(path, "the scene")
    try:
        return _scene(path, table)
    except TorchmatError as error:
        raise DataError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        fact = f"{type(error).__name__}: {error}"
        step = f"See {shipped_folder() / 'scenes' / 'teapot.toml'} for an example."
        raise DataError(message(str(path), "the scene", "describe a scene", fact, step)) from error


def _scene(path: Path, table: dict[str, Any]) -> Scene:
    check_known_keys("scene", table, _KEYS)
    if not isinstance(table.get("mesh"), str):
        step = 'For example mesh = "teapot".'
        fact = f"it is {table.get('mesh')!r}"
        raise RangeError(message("scene", "mesh", "be the name of a shape or a file", fact, step))
    found: dict[str, Any] = {key: table[key] for key in ("view", "repeat", "shadows", "rays", "edges_only") if key in table}
    if "size" in table:
        found["size"] = tuple(table["size"]) if isinstance(table["size"], list) else table["size"]
    if "lights" in table:
        found["lights"] = [_light(entry) for entry in table["lights"]]
    if "camera" in table:
        found["camera"] = _camera(table["camera"])
    mesh = table["mesh"]
    return Scene(mesh if mesh in SHAPES else path.parent / mesh, **found)


def _light(entry: dict[str, Any]) -> Light:
    check_known_keys("scene [[lights]]", entry, _LIGHT_KEYS)
    if ("direction" in entry) == ("position" in entry):
        fact = "it has both" if "direction" in entry else "it has neither"
        raise RangeError(message("scene [[lights]]", "a light", "have a direction or a position", fact))
    given = {"intensity": entry["intensity"]} if "intensity" in entry else {}
    return Directional(entry["direction"], **given) if "direction" in entry else Point(entry["position"], **given)


def _camera(entry: dict[str, Any]) -> Camera:
    check_known_keys("scene [camera]", entry, _CAMERA_KEYS)
    found: dict[str, Any] = {key: entry[key] for key in ("target", "up", "width") if key in entry}
    if "field_of_view_deg" in entry:
        found["field_of_view"] = math.radians(entry["field_of_view_deg"])
    return Camera(entry["position"], **found)
