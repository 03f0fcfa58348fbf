"""torchmat plan."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.arguments import DataArguments
from torchmat.cli.known import CRITERIA, FROM_1, PLAN_VIEWS


@dataclass
class Plan:
    """Say which photographs to take next: the lights and views that reduce the expected error of a fit most."""

    reads: ClassVar = ("path", "material")
    words: ClassVar = {"criterion": CRITERIA, "views": PLAN_VIEWS}
    bounds: ClassVar = {"count": FROM_1, "polar": ("lie in (0, 90)", 5e-324, 90 - 1e-9)}

    path: Annotated[str, tyro.conf.Positional]
    """The photographs that were taken: folder, zip, or file of images."""
    model: str = "hsh"
    """Name of the model that they are to be fitted with, or a config."""
    material: Path | None = None
    """Instead: a material folder that was fitted to them."""
    set: Annotated[list[str], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Set an option of the model, for example --set terms=16; may be repeated."""
    count: int = 8
    """How many photographs to propose."""
    views: str | None = None
    """fixed keeps to the views that were taken, free proposes views too (default: fixed for one view, else free)."""
    criterion: str = "mean"
    """mean: the least expected error over the hemisphere; D: the least volume that is left to the maps."""
    polar: float | None = None
    """Largest polar angle of proposed lights, in degrees (default: that of the lights taken, 60 to 80)."""
    out: Path | None = None
    """Folder to write: the plan as .lp or manifest.csv, a picture, and plan.json (default: the table alone is printed)."""
    force: bool = False
    """Replace an earlier plan even where something in it was changed, and keep it as NAME.backup-1."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def check_names(self) -> None:
        from torchmat.cli.early import check_model

        if self.material is None:
            check_model(self.model, self.set)

    def run(self) -> None:
        from torchmat.fitting import load_config
        from torchmat.fitting.certainty.plan import plan
        from torchmat.material_io import load_material
        from torchmat.report.planning import check_target, plan_table, write_plan

        if self.out is not None:
            check_target(self.out, self.force)  # before the work, not after it
        config = load_config(self.model, self.set)
        model = config if self.material is None else load_material(self.material)
        btf = self.read.load(self.path, config.data)
        found = plan(btf, model, count=self.count, views=self.views, criterion=self.criterion, polar_deg=self.polar)
        print(plan_table(found))
        if self.out is not None:
            folder = write_plan(found, self.out, self.force)
            for path in sorted(folder.iterdir()):
                print(f"plan       {path}")
