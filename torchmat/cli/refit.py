"""torchmat refit."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from torchmat.cli.arguments import SAMPLE, DataArguments, check_out, data_of, names_of, provenance_of, still_free
from torchmat.cli.known import FROM_1, HOLDOUT_WAYS, POSITIVE, SHARE


@dataclass
class Refit:
    """Fit some maps of an edited material anew and keep the others, to the bit, as they were painted."""

    reads: ClassVar = ("material", "given", "data")
    words: ClassVar = {"holdout_by": HOLDOUT_WAYS}
    bounds: ClassVar = {"holdout": SHARE, "effort": POSITIVE, "steps": FROM_1}

    material: Annotated[str, tyro.conf.Positional]
    """Material folder, painted over or not."""
    given: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")] = None
    """Folder, zip or file of images, read in the size of the material (default: `sample`, which ships with the package)."""
    data: str | None = None
    """The same, where it does not stand behind the material."""
    keep: list[str] = field(default_factory=list)
    """Maps that stay, with commas or spaces between: --keep diffuse,height (default: none)."""
    out: Path = Path("out")
    """Folder to write, another one than the material's; an earlier material there is replaced."""
    solver: str | None = None
    """minibatch, adam or lbfgs (default: minibatch)."""
    steps: int | None = None
    """How many steps the solver takes (default: as many as it usually does)."""
    effort: float = 1.0
    """Factor on the usual number of steps."""
    objective: str | None = None
    """linear, or display: errors as they are seen (default: that of the model's own fit)."""
    holdout: float | None = None
    """Share of samples held out (default: as the material's first fit had it, else 0.2)."""
    holdout_by: str | None = None
    """pair, light, view, both or arc (default: as the material's first fit had it, else pair)."""
    seed: int | None = None
    """Seed of the split and of the steps (default: that of the material's first fit, else 0)."""
    force: bool = False
    """Replace it even if it was painted or edited since, and keep it as NAME.backup-1."""
    no_pictures: bool = False
    """Write the material and report.json only."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def check_names(self) -> None:
        data_of("refit", self.given, self.data)

    def run(self) -> None:
        from torchmat import load_material, refit
        from torchmat.report.tables import refit_table
        from torchmat.report.write import write_edited

        check_out("refit", self.out, self.material, force=self.force)  # before the work, not after it
        material, provenance = load_material(self.material), provenance_of(self.material)
        split: dict[str, Any] = {"holdout": 0.2, "holdout_by": "pair", "seed": 0}
        split |= {name: provenance[name] for name in split if name in provenance}
        split |= {name: getattr(self, name) for name in split if getattr(self, name) is not None}
        btf = self.read.load(data_of("refit", self.given, self.data) or SAMPLE)
        found = refit(
            btf, material, names_of(self.keep), solver=self.solver, steps=self.steps, effort=self.effort,
            objective=self.objective, **split,
        )
        step = {"from": Path(self.material).resolve().name, "data": btf.source.path, "kept": found.report["kept"]}
        provenance |= {**split, "refit": {**step, "effort": self.effort, **split}}
        folder = write_edited(
            found.material, still_free(self.out, self.force), provenance, found.report, not self.no_pictures, self.force
        )
        print(refit_table(found.report))
        print()
        print(f"kept       {', '.join(found.report['kept']) or 'nothing'}")
        if not found.report["improved"]:
            print("unchanged  the new maps were no better on the training samples")
        print(f"material   {folder}")
