"""The [data] of a config: which keywords of `load_btf` it may set, and to what."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from torchmat.btf.decode import ENCODINGS
from torchmat.btf.load import DUPLICATE_WAYS, INVALID_WAYS
from torchmat.btf.reader import READERS
from torchmat.errors import RangeError, check_known_keys, check_option, message


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -math.inf < value < math.inf


def _are_whole(value: object) -> bool:
    return isinstance(value, list | tuple) and all(_is_whole(one) and one >= 0 for one in value)


def _are_numbers(value: Any) -> bool:
    return isinstance(value, list | tuple) and all(map(_is_number, value))


# What a number or a list must be, and how that is checked; what is chosen from a few names stands below.
_RULES: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "exposure": ("be a positive number", lambda value: _is_number(value) and value > 0),
    "crop": ("be four whole numbers: top, left, height, width", lambda value: _are_whole(value) and len(value) == 4),
    "downscale": ("be a whole number of at least 1", lambda value: _is_whole(value) and value >= 1),
    "lights": ("be a list of whole numbers from 0", lambda value: _are_whole(value) and len(value) > 0),
    "views": ("be a list of whole numbers from 0", lambda value: _are_whole(value) and len(value) > 0),
    "normalise": ("be true or false", lambda value: isinstance(value, bool)),
    "light_table": ("be the path of a table of lights", lambda value: isinstance(value, str)),
    "ball": ("be the path of a folder of photographs of a chrome ball", lambda value: isinstance(value, str)),
    "circle": ("be three numbers: column, row, radius", lambda value: _are_numbers(value) and len(value) == 3),
    "intensities": ("be the path of a file of intensities, or estimate", lambda value: isinstance(value, str)),
    "mask": ("be the path of a picture, alpha, background or none", lambda value: isinstance(value, str)),
    "skip_bad_lights": ("be true or false", lambda value: isinstance(value, bool)),
    "near": ("be a positive number", lambda value: _is_number(value) and value > 0),
    "distance": ("be a positive number", lambda value: _is_number(value) and value > 0),
    "falloff": ("be true or false", lambda value: isinstance(value, bool)),
    "clipped_weight": ("be a number from 0 to 1", lambda value: _is_number(value) and 0 <= value <= 1),
}
_CHOICES = {
    "kind": READERS, "encoding": ENCODINGS, "invalid": INVALID_WAYS, "duplicates": DUPLICATE_WAYS,
}
DATA_KEYS = (*_CHOICES, *_RULES)


def check_data_settings(settings: Mapping[str, Any]) -> None:
    """Raise RangeError, which names the key, for keywords that `load_btf` does not have or values it cannot take."""
    where = "config [data]"
    check_known_keys(where, settings, DATA_KEYS)
    for name, value in settings.items():
        if name in _CHOICES:
            check_option(where, name, value, _CHOICES[name])
        elif not _RULES[name][1](value):
            raise RangeError(message(where, name, _RULES[name][0], f"it is {value!r}"))
