"""torchmat fit."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from torchmat.cli.arguments import SAMPLE, DataArguments


@dataclass
class Fit:
    """Fit a material to a BTF and write it with its report and pictures."""

    config: Annotated[Path, tyro.conf.Positional]
    """TOML config, for example configs/phong_srf.toml."""
    data: str = SAMPLE
    """Folder or zip of images; `sample` is the one that ships with the package."""
    out: Path = Path("out")
    """Folder to write; an earlier material there is replaced."""
    set: Annotated[list[str], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Override a key of the config, for example --set options.residual=half_light; may be repeated."""
    work: Path | None = None
    """Fit tile by tile and keep finished tiles in this folder: a run that was stopped goes on there."""
    scene: list[Path] = field(default_factory=list)
    """Scene files (configs/scenes/teapot.toml): fit only what these pictures use."""
    no_pictures: bool = False
    """Write the material and report.json only."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def run(self) -> None:
        from torchmat.fitting import fit, load_config
        from torchmat.fitting.choice.choose import NOT_MET
        from torchmat.material_io import check_target
        from torchmat.rendering.scene_file import load_scene
        from torchmat.report import write_fit
        from torchmat.report.decisions_page import outcome_text
        from torchmat.report.tables import fit_tables

        check_target(self.out)  # before the work, not after it
        config = load_config(self.config, self.set).read_as(self.read.keywords())
        scenes = [load_scene(path) for path in self.scene]
        btf = self.read.load(self.data, config.data)
        result = fit(btf, config, work=self.work, scene=scenes or None)
        folder = write_fit(btf, result, self.out, pictures=not self.no_pictures)
        choice = result.report["figures"].get("auto")
        if choice:
            print(outcome_text(choice).upper() if result.stop_reason == NOT_MET else outcome_text(choice))
            print()
        print(fit_tables(result.report))
        print()
        print(f"material   {folder}")
        if choice:
            print(f"decisions  {folder / 'decisions.txt'}")
        for path in sorted(folder.glob("report.*")) + sorted((folder / "pictures").glob("*.png")):
            print(f"{'report' if path.stem == 'report' else 'picture':10s} {path}")
