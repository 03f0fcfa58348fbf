"""The command line: torchmat fit, fit-many, models, refit, blend, render, compare, info, geometry, create, export, pack."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import tyro

import torchmat
from torchmat.cli.blend import Blend
from torchmat.cli.compare import Compare
from torchmat.cli.create import Create
from torchmat.cli.early import check_early
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
from torchmat.errors import TorchmatError

_STYLE = (tyro.conf.FlagCreatePairsOff,)
COMMANDS: dict[str, Callable[..., Any]] = {
    "fit": Fit, "fit-many": FitMany, "models": Models, "refit": Refit, "blend": Blend, "render": Render, "compare": Compare,
    "info": Info, "geometry": Geometry, "create": Create, "export": Export, "pack": Pack,
}


def main(arguments: list[str] | None = None, command: str | None = None) -> int:
    """Run the command line; `command` fixes the subcommand, as the scripts of the same names do."""
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
    try:
        check_early(chosen)
        chosen.run()
    except TorchmatError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0
