"""The shader of a material: GLSL ES 3.0 sources that stand beside the Python that they are twins of."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchmat import models
from torchmat.errors import RangeError, message
from torchmat.models.base import Material

_FOLDER = Path(models.__file__).parent
_INCLUDE = re.compile(r'^#include "(.+)"\n', re.MULTILINE)


def shader_of(kind: type[Material]) -> Path | None:
    """Return the file of the shader of a model; None where it has none, or one of a `value` that a subclass replaced."""
    stated = next((one for one in kind.__mro__ if vars(one).get("glsl") is not None), None)
    if stated is None or not issubclass(stated, next(one for one in kind.__mro__ if "value" in vars(one))):
        return None
    return Path(inspect.getfile(stated)).parent / str(vars(stated)["glsl"])


def source_of(material: Material) -> str:
    """Return the source that a material's pages are drawn with, whole; raises RangeError where its model has no shader."""
    shader = shader_of(type(material))
    if shader is None:
        step = "Show it by pictures, or give its class a `glsl` (torchmat/web/README.md)."
        fact = f"{material.name} has none of its `value`"
        raise RangeError(message("describe", "the material", "be of a model with a shader", fact, step))
    seen: set[Path] = set()
    place = "relief_maps.glsl" if material.has_relief else "flat.glsl"
    return "\n".join(_whole(path, seen) for path in (_FOLDER / "base.glsl", _FOLDER / place, shader))


def _whole(path: Path, seen: set[Path]) -> str:
    """Return a file with what it includes in the place of the lines that say so, each file once."""
    path = path.resolve()
    if path in seen:
        return ""
    seen.add(path)
    return _INCLUDE.sub(lambda found: _whole(path.parent / found[1], seen), path.read_text(encoding="utf-8"))


def defines_of(material: Material) -> dict[str, str]:
    """Return what the preprocessor is told of a material: its options, and what it has.

    An option `terms` of 9 is TERMS 9, `space` of "srgb" SPACE_SRGB, `parts` of ["coat"] PARTS_COAT, and `angles_deg` a list
    ANGLES_DEG with its ANGLES_DEG_COUNT; a map `normal` is HAS_NORMAL, numbers `lobe` NUMBER_LOBE, how many there are.
    """
    found = {"HAS_NORMAL": "1"} if material.derives_normal else {}
    for option, value in material.options.items():
        found |= _define(option.upper(), value)
    for spec in material.specs():
        found[f"HAS_{spec.name.upper()}"] = "1"
        if spec.constant:
            found[f"NUMBER_{spec.name.upper()}"] = str(spec.channels)
    if material.diffuse_map:
        found["DIFFUSE_MAP"] = f"map_{material.diffuse_map}"
    if material.tiles:
        found["TILES"] = "1"
    if material.has_relief and material.relief == "fine":
        found["FINE"] = "1"
    if material.cutout is not None and not material.cutout.is_whole:
        table: Mapping[str, Any] = material.cutout.as_table()
        part = [table[name] for name in ("top", "left", "height", "width", "whole_height", "whole_width")]
        found |= {"CUTOUT": _array(part), **({"CUTOUT_REPEATS": "1"} if table["repeats"] else {})}
    return found


def _define(name: str, value: object) -> dict[str, str]:
    if isinstance(value, bool):
        return {name: "1"} if value else {}
    if isinstance(value, int | float):
        return {name: str(value) if isinstance(value, int) else _float(value)}
    if isinstance(value, str):
        return {f"{name}_{value.upper()}": "1"}
    if isinstance(value, Sequence) and value and all(isinstance(one, str) for one in value):
        return {f"{name}_{one.upper()}": "1" for one in value}
    if isinstance(value, Sequence) and value and all(isinstance(one, int | float) for one in value):
        return {name: _array(value), f"{name}_COUNT": str(len(value))}
    return {}  # what only files are about


def _float(value: float) -> str:
    text = repr(float(value))
    return text if "." in text or "e" in text else f"{text}.0"


def _array(values: Sequence[float]) -> str:
    return f"float[{len(values)}]({', '.join(map(_float, values))})"
