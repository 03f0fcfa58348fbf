"""The command line: fit, fit-many, models, refit, blend, render, compare, info, geometry, create, edit, export, pack, studio, board, capture, plan.

This module loads next to nothing, so that `torchmat --help` is there at once; a command loads its own arguments.
"""

from __future__ import annotations

import os
import shutil
import sys
from typing import NoReturn

from torchmat.cli.libraries import Ending, prepare
from torchmat.cli.threads import let_threads_sleep
from torchmat.progress import announced

HELP = os.path.join(os.path.dirname(__file__), "help.txt")  # a test holds it to what the commands say of themselves
WIDTH = 80  # of the lines there


def main(arguments: list[str] | None = None, command: str | None = None) -> int:
    """Run the command line; `command` fixes the subcommand, as the scripts of the same names do.

    Returns the exit code: 0, 1 when a part failed, 2 for an error, 130 when it was stopped by Ctrl-C.
    """
    let_threads_sleep()
    prepare()
    given = sys.argv[1:] if arguments is None else arguments
    if command is None and given == ["--version"]:
        import torchmat

        print(f"torchmat {torchmat.__version__}")
        return 0
    if command is None and given in (["--help"], ["-h"]) and _shows_help():
        with open(HELP, encoding="utf-8") as file:
            print(file.read(), end="")
        sys.exit(0)  # as the help of a command ends the program
    if os.environ.get("NO_COLOR"):  # which tyro does not look at
        os.environ.setdefault("PYTHON_TYRO_ANSI_CODES", "False")
    name = command or (given or [""])[0]
    with announced(f"{name}: starting", name):
        from torchmat.cli.run import run

        return run(given, command)


def program(command: str | None = None) -> NoReturn:
    """Run the command line as a process of its own, which ends with it; arguments as of `main`."""
    ending = Ending()
    ending.code = main(command=command)
    sys.exit(ending.code)


def _shows_help() -> bool:
    """Return whether the terminal, or the file, takes the help as it is kept."""
    wide = shutil.get_terminal_size().columns >= WIDTH
    return wide and (getattr(sys.stdout, "encoding", None) or "").lower().startswith("utf")
