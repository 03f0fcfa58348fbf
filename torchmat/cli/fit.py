"""torchmat fit."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.again import Run, read_run, run_of
from torchmat.cli.arguments import SAMPLE, DataArguments, data_of, still_free
from torchmat.cli.known import MEASURES


@dataclass
class Fit:
    """Fit a material to a BTF and write it with its report and pictures."""

    reads: ClassVar = ("given", "data", "test")
    words: ClassVar = {"measure": MEASURES}

    model: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL|CONFIG")] = None
    """Name of a model with its defaults (`torchmat models` lists them; `auto` chooses), or with .toml a config: its path,
    or its name alone for one that ships, such as phong_srf_half_light.toml."""
    given: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")] = None
    """Folder or zip of images, or a BRDF file (default: `sample`, which ships with the package)."""
    data: str | None = None
    """The same, where it does not stand behind the model."""
    out: Path | None = None
    """Folder to write (default: out); an earlier material there is replaced, unless something in it was painted or
    edited."""
    force: bool = False
    """Replace it even so, and keep it as NAME.backup-1."""
    again: Path | None = None
    """Instead of a model: a folder that `fit` wrote, or its report.json. The same fit is run again, to the same folder
    unless --out names another; refused when the data is not the same. --set changes something of it."""
    set: Annotated[list[str], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Set an option of the model or a key of a config, for example --set residual=half_light or --set tiles=false; may be
    repeated."""
    geometry: str | None = None
    """flat, recover, or the path of a height map (default: the config's, or the model's own)."""
    seed: int | None = None
    """Seed of the split into training and held-out samples, and of the solvers."""
    test: str | None = None
    """Other images of the same texels, measured and never fitted: directions beside those of the data. `sample`: the random
    ones that ship with it."""
    psnr: float | None = None
    """Of auto: dB wanted on held-out samples."""
    error: float | None = None
    """Of auto: relative error wanted on held-out samples."""
    bytes: float | None = None
    """Of auto: most bytes a texel."""
    highlights: float | None = None
    """Of auto: relative error on highlights that is kept beside --psnr (default: 0.1); 1 lets them go."""
    seconds: float | None = None
    """Stop fitting then, with the best so far."""
    work: Path | None = None
    """Fit tile by tile and keep finished tiles in this folder: a run that was stopped goes on there."""
    scene: list[Path] = field(default_factory=list)
    """Scene files, or names of those that ship (teapot.toml): fit only what these pictures use."""
    measure: str = "auto"
    """full: errors on all held-out samples; auto: the same, of images above a million texels on an even choice of those;
    quick: on some samples, about 2 million texels; none."""
    uncertainty: bool = False
    """Write standard errors beside the maps (uncertainty/NAME.exr) and show them in the report."""
    no_pictures: bool = False
    """Write the material and report.json only."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)
    command: tyro.conf.Suppress[tuple[str, ...]] = ()
    """The command line itself, for the report."""

    def _flags(self) -> list[str]:
        """Return the flags that were given as keys of a config; they win over --set."""
        keys = ("geometry", "seed", "test", "target.psnr", "target.error", "target.bytes", "target.highlights", "target.seconds")
        given = {key: getattr(self, key.removeprefix("target.")) for key in keys} | {"uncertainty": self.uncertainty or None}
        return [f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in given.items() if value is not None]

    def check_names(self) -> None:
        from torchmat.cli.early import check_model

        if self.model is not None:
            check_model(self.model, self.set)
        data_of("fit", self.given, self.data)

    def _run(self) -> Run | None:
        """Return the run to repeat, None for a new one."""
        from torchmat.errors import RangeError, message

        if (self.model is None) == (self.again is None):
            fact = "neither is given" if self.model is None else "both are"
            step = "torchmat models lists the models; --again takes a folder that fit wrote."
            raise RangeError(message("fit", "a model or --again", "be given", fact, step))
        if self.again is None:
            return None
        run = read_run(self.again)
        if not self.scene:
            run.check_files()
        return run

    def run(self) -> None:
        from torchmat.fitting import fit, load_config
        from torchmat.fitting.choice.choose import NOT_MET
        from torchmat.geometry.tiling import Tiling
        from torchmat.material_io import check_target
        from torchmat.progress import phase
        from torchmat.rendering.as_mesh import as_mesh
        from torchmat.rendering.scene_file import load_scene
        from torchmat.report import write_fit
        from torchmat.report.describe_mesh import mesh_line
        from torchmat.report.decisions_page import decided_text, outcome_text
        from torchmat.report.tables import fit_tables, stopped_text
        from torchmat.studio.known import remember

        run = self._run()
        out = self.out or (Path("out") if run is None else run.folder)
        check_target(out, self.force)  # before the work, not after it
        asked = run.config if run is not None else self.model or ""
        config = load_config(asked, [*self.set, *self._flags()]).read_as(self.read.keywords())
        names = self.scene or ([] if run is None else [Path(name) for name in run.scenes])
        scenes = [load_scene(path) for path in names]
        for mesh in (as_mesh(scene.mesh) for scene in scenes):
            if mesh.mapping != "shape":
                print(f"mesh       {mesh_line(mesh)}")
        data = data_of("fit", self.given, self.data) or (SAMPLE if run is None else run.data)
        btf = self.read.load(data, config.data)
        if run is not None:
            run.check_data(btf)
        result = fit(btf, config, work=self.work, scene=scenes or None, measure=self.measure)
        with phase("telling these images from others"):
            result = replace(result, report={**result.report, "run": run_of(config, data, names, btf, self.command)})
        out = still_free(out, self.force)
        folder = write_fit(btf, result, out, pictures=not self.no_pictures, force=self.force)
        if not self.read.no_cache:
            remember(folder)
        choice = result.report["figures"].get("auto")
        if choice:
            print(outcome_text(choice).upper() if result.stop_reason == NOT_MET else outcome_text(choice))
            print(decided_text(choice))
            print()
        print(fit_tables(result.report))
        if result.report["tiling"]:
            print(f"\ntiles      {Tiling(**result.report['tiling']).sentence()}; --set tiles=true or false says otherwise")
        print()
        for text in (*filter(None, [stopped_text(result.report)]), *(result.report["lambert_residual"] or {}).get("warnings", ())):
            print(f"warning    {text}")
        print(f"material   {folder}")
        if choice:
            print(f"decisions  {folder / 'decisions.txt'}")
        for path in sorted(folder.glob("report.*")) + sorted((folder / "pictures").glob("*.png")):
            print(f"{'report' if path.stem == 'report' else 'picture':10s} {path}")
