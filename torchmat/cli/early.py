"""What can be said of arguments before torch is loaded: that a path is not there, that no model has such a name."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from torchmat.cli.arguments import SAMPLE
from torchmat.cli.known import CONFIG_KEYS, known_options
from torchmat.errors import DataError, check_known_keys, check_option, message
from torchmat.shipped import find_file, shipped_names
from torchmat.text_file import read_toml


def check_early(command: Any) -> None:
    """Raise DataError or RangeError for arguments that no data is needed to refuse.

    A command names in `reads` those of its arguments that are paths to read, as those of its `read` do (how images are
    read), and may have a method `check_names`. The rest is checked where it is used, with the same words.
    """
    for part in (command, getattr(command, "read", None)):
        for name in getattr(part, "reads", ()):
            value = getattr(part, name)
            for path in value if isinstance(value, list | tuple) else [value]:
                check_there(path)
    if hasattr(command, "check_names"):
        command.check_names()


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
        check_known_keys(str(path), table, CONFIG_KEYS)
        name = str(table.get("model", "phong_srf"))
        check_option(str(path), "model", name, models)
    else:
        check_option("fit", "model", name, (*models, *shipped_names()))
    options = table.get("options", {})
    if isinstance(options, dict):
        check_known_keys(f"fit {name}", options, models[name])
    for text in settings:
        key = text.partition("=")[0].strip()
        if key == "model":
            name = text.partition("=")[2].strip().strip("\"'")
            check_option("fit", "model", name, models)
        elif key.startswith("options."):
            check_known_keys(f"fit {name}", [key.removeprefix("options.")], models[name])
        elif "." not in key:
            check_known_keys("--set", [key], (*CONFIG_KEYS, *models[name]))


def _nearest(path: Path) -> str:
    """Return a hint at what the folder has that is called much like it."""
    try:
        names = [other.name for other in path.parent.iterdir()]
    except OSError:
        return f"There is no folder {path.parent} either." if not path.parent.exists() else ""
    near = difflib.get_close_matches(path.name, names, n=1, cutoff=0.6)
    return f"Did you mean {str(path.parent / near[0])!r}?" if near else ""
