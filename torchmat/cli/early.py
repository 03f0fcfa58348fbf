"""What can be said of arguments before torch is loaded: that a path is not there, that no model has such a name."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from torchmat.cli.arguments import SAMPLE
from torchmat.cli.known import CHOICES, CONFIG_KEYS, HOLDOUT_WAYS, SHARE, STORAGES, TABLES, Bound, known_kinds, known_options
from torchmat.errors import DataError, RangeError, check_known_keys, check_option, message
from torchmat.places import right_place
from torchmat.shipped import find_file, shipped_names
from torchmat.text_file import parse_value, read_toml


_NAMES = re.compile("(?<=[a-z])(?=[A-Z])")  # FitMany is fit-many


def check_early(command: Any) -> None:
    """Raise DataError or RangeError for arguments that no data is needed to refuse.

    Of a command `words` says which words some of its arguments can be, and `bounds` which numbers. It names in `reads` those of its arguments that are paths to read, as those of its `read` do (how images are
    read), and may have a method `check_names`. The rest is checked where it is used, with the same words.
    """
    for part in (command, getattr(command, "read", None)):
        for name in getattr(part, "reads", ()):
            value = getattr(part, name)
            for path in value if isinstance(value, list | tuple) else [value]:
                check_there(path)
    for part in (command, getattr(command, "read", None)):
        kind = getattr(part, "kind", None)
        if kind is not None:
            check_option("load_btf", "kind", kind, known_kinds())
        _check_arguments(_NAMES.sub("-", type(command).__name__).lower(), part)
        for name in ("out", "write_lights", "plot"):
            check_place(getattr(part, name, None))
    if hasattr(command, "check_names"):
        command.check_names()


def _check_arguments(where: str, part: Any) -> None:
    """Raise RangeError for a word or a number that an argument cannot be: see `words` and `bounds` of commands."""
    for name, words in getattr(part, "words", {}).items():
        if getattr(part, name) is not None:
            check_option(where, _flag(name), getattr(part, name), words)
    for name, bound in getattr(part, "bounds", {}).items():
        if getattr(part, name) is not None:
            _check_bound(where, _flag(name), getattr(part, name), bound)


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _check_bound(where: str, name: str, value: float, bound: Bound) -> None:
    requirement, least, largest = bound
    if not least <= value <= largest:
        raise RangeError(message(where, name, requirement, f"it is {value}"))


def check_there(path: str | Path | None) -> None:
    """Raise DataError, with the nearest name beside it, for a path where there is nothing."""
    if path is None or path == SAMPLE:
        return
    try:
        found = Path(path).exists()
    except (OSError, ValueError):  # a name that no file can have is reported where it is read
        return
    if not found:
        near = _nearest(Path(path))
        raise DataError(message(str(path), "the path", "exist", "there is nothing", near or "Check the spelling."))


def check_model(name: str, settings: Iterable[str] = ()) -> None:
    """Raise RangeError or DataError for a model, a config, or settings such as ``residual=half`` that there are not."""
    table: dict[str, Any] = {"model": name}
    models = known_options()
    if Path(name).suffix or len(Path(name).parts) > 1:
        path = find_file(name)
        table = read_toml(path, "the config")
        name = str(table.get("model", "phong_srf"))
        check_known_keys(str(path), table, CONFIG_KEYS, _places(name))
        check_option(str(path), "model", name, models)
    else:
        check_option("fit", "model", name, (*models, *shipped_names()))
    options = table.get("options", {})
    if isinstance(options, dict):
        check_known_keys(f"fit {name}", options, models[name], _places(name))
        for key, value in options.items():
            _check_value(name, key, value)
    for text in settings:
        name = _check_setting(name, text, models)


def _check_setting(model: str, text: str, models: Mapping[str, Sequence[str]]) -> str:
    """Raise RangeError for a setting that cannot be; return the model that is meant after it."""
    key, _, value = (part.strip() for part in text.partition("="))
    table, _, inner = key.partition(".")
    if key == "model":
        model = str(parse_value(value))
        check_option("fit", "model", model, models)
    elif table == "options" and inner:
        check_known_keys(f"fit {model}", [inner], models[model], _places(model))
        _check_value(model, inner, parse_value(value))
    elif table in TABLES and inner:
        check_known_keys("--set", [inner], TABLES[table], _places(model))
    elif not inner:
        check_known_keys("--set", [key], (*CONFIG_KEYS, *models[model]), _places(model))
        found = parse_value(value)
        if key not in CONFIG_KEYS:
            _check_value(model, key, found)
        elif key == "holdout_by":
            check_option("config", key, found, HOLDOUT_WAYS)
        elif key == "holdout" and isinstance(found, int | float):
            _check_bound("config", key, found, SHARE)
    return model


def _places(model: str) -> Callable[[str], str]:
    return lambda key: right_place(key, model, known_options(), CONFIG_KEYS, TABLES)


def _check_value(model: str, option: str, value: object) -> None:
    choices = STORAGES if option == "storage" else CHOICES.get(model, {}).get(option)
    if choices is not None:
        check_option(f"fit {model}", option, value, choices)


def check_place(out: str | Path | None) -> None:
    """Raise DataError for a file or folder to write whose place cannot be."""
    if out is None:
        return
    place = Path(os.path.abspath(out)).parent
    while not os.path.lexists(place) and place != place.parent:
        place = place.parent
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        fact = f"{place} is a file" if not place.is_dir() else f"{place} is not"
        raise DataError(message(str(out), "its place", "be a folder that can be written to", fact, "Name another one."))


def _nearest(path: Path) -> str:
    """Return a hint at what the folder has that is called much like it."""
    try:
        names = [other.name for other in path.parent.iterdir()]
    except OSError:
        return f"There is no folder {path.parent} either." if not path.parent.exists() else ""
    near = difflib.get_close_matches(path.name, names, n=1, cutoff=0.6)
    return f"Did you mean {str(path.parent / near[0])!r}?" if near else ""
