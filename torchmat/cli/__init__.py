"""The command line: fit, fit-many, models, refit, blend, render, compare, info, geometry, create, edit, export, pack."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import tyro

import torchmat
from torchmat import atomic
from torchmat.cli.blend import Blend
from torchmat.cli.compare import Compare
from torchmat.cli.create import Create
from torchmat.cli.early import check_early
from torchmat.cli.edit import Edit
from torchmat.cli.export import Export
from torchmat.cli.fit import Fit
from torchmat.cli.fit_many import FitMany
from torchmat.cli.geometry import Geometry
from torchmat.cli.info import Info
from torchmat.cli.models import Models
from torchmat.cli.pack import Pack
from torchmat.cli.refit import Refit
from torchmat.cli.render import Render
from torchmat.cli.threads import let_threads_sleep
from torchmat.errors import Notice, TorchmatError

_INTERRUPTED = 130  # what shells say of a program that Ctrl-C stopped
_STYLE = (tyro.conf.FlagCreatePairsOff,)
COMMANDS: dict[str, Callable[..., Any]] = {
    "fit": Fit, "fit-many": FitMany, "models": Models, "refit": Refit, "blend": Blend, "render": Render, "compare": Compare,
    "info": Info, "geometry": Geometry, "create": Create, "edit": Edit, "export": Export, "pack": Pack,
}


def main(arguments: list[str] | None = None, command: str | None = None) -> int:
    """Run the command line; `command` fixes the subcommand, as the scripts of the same names do.

    Returns the exit code: 0, 1 when a part failed, 2 for an error, 130 when it was stopped by Ctrl-C.
    """
    let_threads_sleep()
    if command is None:
        if (sys.argv[1:] if arguments is None else arguments) == ["--version"]:
            print(f"torchmat {torchmat.__version__}")
            return 0
        chosen = tyro.extras.subcommand_cli_from_dict(
            COMMANDS, args=arguments, prog="torchmat", description=__doc__, config=_STYLE
        )
    else:
        chosen = tyro.cli(COMMANDS[command], args=arguments, prog=command, config=_STYLE)
    if isinstance(chosen, Fit):
        given = sys.argv[1:] if arguments is None else arguments
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
