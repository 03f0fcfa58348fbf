"""torchmat models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass
class Models:
    """List the models, or say what each option of one means."""

    name: Annotated[str | None, tyro.conf.Positional] = None
    """One model; left out, all are listed."""

    def check_names(self) -> None:
        from torchmat.cli.known import known_options
        from torchmat.errors import check_option

        if self.name is not None:
            check_option("models", "name", self.name, [name for name in known_options() if name != "auto"])

    def run(self) -> None:
        from torchmat.fitting.describe import describe_model, describe_models
        from torchmat.report.tables import text_table

        if self.name is None:
            rows = [[one.name, one.bytes_per_texel, ", ".join(one.solvers), one.summary] for one in describe_models()]
            print(text_table(["model", "bytes/texel", "solvers", "what it is"], rows))
            print("\nOptions of one: torchmat models NAME. `auto` chooses among the models: torchmat fit auto --psnr 25.")
            return
        print(describe_model(self.name))
        print("\nOn the command line: --set OPTION=VALUE; in Python keywords of tm.fit.")
