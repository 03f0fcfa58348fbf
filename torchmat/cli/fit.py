"""torchmat fit."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.arguments import SAMPLE, DataArguments


@dataclass
class Fit:
    """Fit a material to a BTF and write it with its report and pictures."""

    reads: ClassVar = ("data",)

    model: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL|CONFIG")]
    """Name of a model with its defaults (`torchmat models` lists them; `auto` chooses), or with .toml a config: its path,
    or its name alone for one that ships, such as phong_srf_half_light.toml."""
    data: str = SAMPLE
    """Folder or zip of images, or a BRDF file; `sample` is the one that ships with the package."""
    out: Path = Path("out")
    """Folder to write; an earlier material there is replaced."""
    set: Annotated[list[str], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Set an option of the model or a key of a config, for example --set residual=half_light or --set tiles=false; may be
    repeated."""
    geometry: str | None = None
    """flat, recover, or the path of a height map (default: the config's, or the model's own)."""
    seed: int | None = None
    """Seed of the split into training and held-out samples, and of the solvers."""
    psnr: float | None = None
    """Of auto: dB wanted on held-out samples."""
    error: float | None = None
    """Of auto: relative error wanted on held-out samples."""
    bytes: float | None = None
    """Of auto: most bytes a texel."""
    seconds: float | None = None
    """Stop fitting then, with the best so far."""
    work: Path | None = None
    """Fit tile by tile and keep finished tiles in this folder: a run that was stopped goes on there."""
    scene: list[Path] = field(default_factory=list)
    """Scene files, or names of those that ship (teapot.toml): fit only what these pictures use."""
    measure: str = "full"
    """full: errors on all held-out samples; quick: on some, about 2 million texels; none."""
    no_pictures: bool = False
    """Write the material and report.json only."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def _flags(self) -> list[str]:
        """Return the flags that were given as keys of a config; they win over --set."""
        keys = ("geometry", "seed", "target.psnr", "target.error", "target.bytes", "target.seconds")
        given = {key: getattr(self, key.removeprefix("target.")) for key in keys}
        return [f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in given.items() if value is not None]

    def check_names(self) -> None:
        from torchmat.cli.early import check_model

        check_model(self.model, self.set)

    def run(self) -> None:
        from torchmat.fitting import fit, load_config
        from torchmat.fitting.choice.choose import NOT_MET
        from torchmat.material_io import check_target
        from torchmat.rendering.as_mesh import as_mesh
        from torchmat.rendering.scene_file import load_scene
        from torchmat.report import write_fit
        from torchmat.report.describe_mesh import mesh_line
        from torchmat.report.decisions_page import outcome_text
        from torchmat.report.tables import fit_tables

        check_target(self.out)  # before the work, not after it
        config = load_config(self.model, [*self.set, *self._flags()]).read_as(self.read.keywords())
        scenes = [load_scene(path) for path in self.scene]
        for mesh in (as_mesh(scene.mesh) for scene in scenes):
            if mesh.mapping != "shape":
                print(f"mesh       {mesh_line(mesh)}")
        btf = self.read.load(self.data, config.data)
        result = fit(btf, config, work=self.work, scene=scenes or None, measure=self.measure)
        folder = write_fit(btf, result, self.out, pictures=not self.no_pictures)
        choice = result.report["figures"].get("auto")
        if choice:
            print(outcome_text(choice).upper() if result.stop_reason == NOT_MET else outcome_text(choice))
            print()
        print(fit_tables(result.report))
        print()
        for text in (result.report["lambert_residual"] or {}).get("warnings", ()):
            print(f"warning    {text}")
        print(f"material   {folder}")
        if choice:
            print(f"decisions  {folder / 'decisions.txt'}")
        for path in sorted(folder.glob("report.*")) + sorted((folder / "pictures").glob("*.png")):
            print(f"{'report' if path.stem == 'report' else 'picture':10s} {path}")
