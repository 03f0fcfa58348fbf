"""What all commands have in common: reading their arguments, early checks, notes, errors, and Ctrl-C."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import tyro

from torchmat import atomic, cli
from torchmat.cli.early import check_early
from torchmat.errors import Notice, TorchmatError

_INTERRUPTED = 130  # what shells say of a program that Ctrl-C stopped
_STYLE = (tyro.conf.FlagCreatePairsOff,)
_CLASSES = {
    "fit": "Fit", "fit-many": "FitMany", "models": "Models", "refit": "Refit", "blend": "Blend", "render": "Render",
    "compare": "Compare", "info": "Info", "geometry": "Geometry", "create": "Create", "edit": "Edit", "export": "Export",
    "pack": "Pack", "studio": "Studio", "board": "Board", "capture": "Capture", "plan": "Plan",
}


def command_of(name: str) -> Callable[..., Any]:
    """Return the class of a command; only its own module is loaded."""
    return getattr(importlib.import_module(f"torchmat.cli.{name.replace('-', '_')}"), _CLASSES[name])


def read_arguments(given: Sequence[str], command: str | None) -> Any:
    """Return the command that arguments ask for; ends the program where they are wrong, or ask for help."""
    if command is None and given and given[0] in _CLASSES:  # one command is read in half the time of all
        return tyro.cli(command_of(given[0]), args=given[1:], prog=f"torchmat {given[0]}", config=_STYLE)
    if command is not None:
        return tyro.cli(command_of(command), args=given, prog=command, config=_STYLE)
    every = {name: command_of(name) for name in _CLASSES}
    description = (cli.__doc__ or "").partition("\n")[0]
    return tyro.extras.subcommand_cli_from_dict(every, args=given, prog="torchmat", description=description, config=_STYLE)


def run(given: Sequence[str], command: str | None) -> int:
    """Run a command with its arguments and return the exit code, as `main` does."""
    chosen = read_arguments(given, command)
    if hasattr(chosen, "command"):
        chosen.command = ("torchmat", *([] if command is None else [command]), *given)
    start = len(atomic.INSTALLED)
    try:
        with _notices():
            check_early(chosen)
            return chosen.run() or 0
    except TorchmatError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"stopped; {_left_behind(chosen, atomic.INSTALLED[start:])}", file=sys.stderr)
        return _INTERRUPTED


@contextmanager
def _notices() -> Iterator[None]:
    """Print what the package takes otherwise than it stands there as notes, one a line, in place of Python's warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", Notice)
        usual = warnings.showwarning

        def show(message, category, filename, lineno, file=None, line=None) -> None:
            if issubclass(category, Notice):
                print(f"note: {message}", file=sys.stderr)
            else:
                usual(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        yield


def _left_behind(command: object, written: list[Path]) -> str:
    """Return what a command that was stopped has left: files in their places, and work that it goes on from."""
    work = getattr(command, "work", None)
    if work is not None and work.is_dir() and any(work.iterdir()):
        return f"finished tiles are kept in {work}, and the same command goes on there"
    places = list(dict.fromkeys(written))
    if not places:
        return "nothing written"
    more = f" and {len(places) - 1} more" if len(places) > 1 else ""
    return f"kept, whole: {places[-1]}{more}"
