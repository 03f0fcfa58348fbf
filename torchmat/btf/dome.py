"""Domes of lights as RelightLab describes them, `.dome` files in JSON: directions or positions, and the width of what is pictured."""

from __future__ import annotations

import math
from pathlib import PurePosixPath
from typing import Any

import torch
from torch import Tensor

from torchmat.btf.light_table import LightTable, with_intensity
from torchmat.errors import DataError, message
from torchmat.text_file import parse_json

_POSITIONS = {"spherical": ("positionsSphere", "positions"), "lights3d": ("positions3d", "positions")}
_STEP = "Export the dome again."


def is_dome(name: str) -> bool:
    """Tell whether a file describes a dome, by its suffix."""
    return PurePosixPath(name).suffix.lower() in (".dome", ".json")


def parse_dome(where: str, text: str) -> LightTable:
    """Return the lights of a dome's `text`, in the photographs' order; raises DataError, which names the entry, where it cannot be read.

    ``lightConfiguration`` "directional" uses ``directions``: lights are far. "spherical" and "lights3d" use ``positionsSphere`` or
    ``positions3d`` (``positions`` of earlier releases), or ``directions`` on a sphere of ``domeDiameter`` that is raised by
    ``verticalOffset``: lights are near. A file of before ``lightConfiguration`` is directional unless it has positions alone. All
    lengths are in one unit, from the middle of the picture, which is ``imageWidth`` wide where that is known (not 0).
    ``ledAdjust`` multiplies values, so that a light's intensity is its inverse.
    """
    dome = parse_json(where, text, "the dome", "be a JSON table, as relight writes it")
    key, vectors, near = _vectors_of(where, dome)
    width = _length(where, dome, "imageWidth")
    lines = tuple(f"{where}: {key}[{number}]" for number in range(len(vectors)))
    table = LightTable(where, None, lines, vectors, near=near, width=width or None if near else None)
    adjust = _rows(where, "ledAdjust", dome.get("ledAdjust") or [], "rgb")
    if not len(adjust):
        return table
    if not bool((adjust > 0).all()):
        raise DataError(message(where, "ledAdjust", "be positive", f"the least number is {float(adjust.min()):g}", _STEP))
    return with_intensity(table, 1 / adjust, where)


def _vectors_of(where: str, dome: dict[str, Any]) -> tuple[str, Tensor, bool]:
    """Return the entry that a dome's lights are in, x y z of them [n, 3], and whether they are positions."""
    kind = dome.get("lightConfiguration")
    if kind is None:
        kind = "lights3d" if dome.get("positions") and not dome.get("directions") else "directional"
    if kind != "directional" and kind not in _POSITIONS:
        fact = f"it is {kind!r}"
        raise DataError(message(where, "lightConfiguration", "be directional, spherical or lights3d", fact, _STEP))
    for key in _POSITIONS.get(kind, ()):
        if dome.get(key):
            return key, _lights(where, key, dome[key]), True
    if not dome.get("directions"):
        fact = f"it is {kind} and has {', '.join(sorted(key for key, value in dome.items() if value)) or 'nothing'}"
        raise DataError(message(where, "the dome", "hold directions or positions", fact, "Export it again, with its lights."))
    vectors = _lights(where, "directions", dome["directions"])
    diameter = _length(where, dome, "domeDiameter") or _length(where, dome, "diameter")
    if kind == "directional" or diameter <= 0:
        return "directions", vectors, False
    raised = torch.tensor([0.0, 0.0, _length(where, dome, "verticalOffset")], dtype=torch.float64)
    return "directions", vectors * (diameter / 2) + raised, True


def _length(where: str, dome: dict[str, Any], key: str) -> float:
    """Return a length of a dome, 0 where it has none."""
    value = dome.get(key) or 0.0
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise DataError(message(where, key, "be a length", f"it is {value!r}", _STEP))
    return float(value)


def _lights(where: str, key: str, entries: Any) -> Tensor:
    found = _rows(where, key, entries, "xyz")
    if not bool((found.norm(dim=1) > 0).all()):
        first = int((found.norm(dim=1) == 0).nonzero()[0, 0])
        raise DataError(message(where, key, "be vectors with a direction", f"{key}[{first}] is 0, 0, 0", _STEP))
    return found


def _rows(where: str, key: str, entries: Any, names: str) -> Tensor:
    """Return entries, tables of three named numbers or lists of them, as [n, 3], float64."""
    try:
        rows = [[float(one[name]) for name in names] if isinstance(one, dict) else [float(number) for number in one] for one in entries]
        found = torch.tensor(rows, dtype=torch.float64).reshape(len(rows), 3)
    except (TypeError, KeyError, ValueError, RuntimeError) as error:
        wanted = f"be a list of {', '.join(names)}"
        raise DataError(message(where, key, wanted, f"{type(error).__name__}: {str(error).splitlines()[0]}", _STEP)) from error
    if not bool(torch.isfinite(found).all()):
        raise DataError(message(where, key, "be finite numbers", f"{int((~torch.isfinite(found)).sum())} are not", _STEP))
    return found
