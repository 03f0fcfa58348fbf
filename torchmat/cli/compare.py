"""torchmat compare."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.arguments import SAMPLE, DataArguments
from torchmat.cli.known import FROM_1, HOLDOUT_WAYS, MEASURES, POSITIVE, SHARE
from torchmat.progress import phase


@dataclass
class Compare:
    """Fit several models to one BTF and print and plot speed against error."""

    reads: ClassVar = ("data",)
    words: ClassVar = {"measure": MEASURES[1:3], "holdout_by": HOLDOUT_WAYS}
    bounds: ClassVar = {"holdout": SHARE, "budget": POSITIVE, "repeats": FROM_1}

    data: Annotated[str, tyro.conf.Positional] = SAMPLE
    """Folder or zip of images, or a BRDF file; `sample` is the one that ships with the package."""
    models: list[str] = field(default_factory=list)
    """Names, with options after a colon: ptm hsh:terms=16 phong_srf:residual=half_light lambert:geometry=recover
    (default: all families, and all solvers of each)."""
    budget: float | None = 120.0
    """Seconds that one fit may take: iterative solvers stop there with the best they have, and their rows say so."""
    repeats: int = 1
    """How often each model is fitted: seconds are the median, with their spread."""
    geometry: str | None = None
    """flat, recover or the path of a height map, for models that say nothing of it (default: each model's own way)."""
    curves: bool = True
    """Measure the error of iterative solvers as they go on."""
    measure: str = "full"
    """full: errors on all held-out samples; quick: on some, about 2 million texels."""
    out: Path | None = Path("comparison")
    """Folder for JSON, CSV, HTML and plots; None only prints. Rows are written as soon as they are known."""
    holdout: float = 0.2
    """Share of samples held out."""
    holdout_by: str = "pair"
    """pair, light, view, both or arc."""
    seed: int = 0
    """Seed of the split and of the solvers."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def check_names(self) -> None:
        from torchmat.cli.early import check_model

        for text in self.models:
            name, _, settings = text.partition(":")
            check_model(name, [one for one in settings.split(",") if one])

    def run(self) -> None:
        from torchmat.report.comparison import default_models, check_target, compare, write_comparison
        from torchmat.btf.lambert import lambert_of
        from torchmat.report.lights import lambert_text
        from torchmat.report.tables import comparison_table

        out = self.out
        if out is not None:
            check_target(out)
        btf = self.read.load(self.data)
        for line in lambert_text(lambert_of(btf)):
            print(line)
        title = f"Models on {Path(self.data).name}"
        keep = None if out is None else lambda rows: write_comparison(rows, out, title, plots=False)
        rows = compare(
            btf, self.models or default_models(), budget=self.budget, repeats=self.repeats, geometry=self.geometry,
            curves=self.curves, holdout=self.holdout, holdout_by=self.holdout_by, seed=self.seed, measure=self.measure, each=keep,
        )
        print(comparison_table(rows))
        for row in rows:
            if row["failed"]:
                print(f"{row['model']}: {row['failed']}")
            if row["same_bits"] is False:
                print(f"{row['model']}: repeats differ, relative errors {row['relative_errors']}")
        if out is not None:
            with phase("writing the report"):
                written = write_comparison(rows, out, title)
            print(f"comparison {written}")
