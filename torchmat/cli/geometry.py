"""torchmat geometry."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.arguments import DataArguments
from torchmat.cli.known import INTEGRATIONS, RELIEF_DEPTHS
from torchmat.progress import phase


@dataclass
class Geometry:
    """Recover height and normals: from a BTF, from photographs of one view under known lights, or from one picture."""

    reads: ClassVar = ("path",)
    words: ClassVar = {"depth": RELIEF_DEPTHS, "integration": INTEGRATIONS}

    path: Annotated[str, tyro.conf.Positional]
    """BTF or RTI capture, a folder of photographs with --lights or --ball, or one picture."""
    out: Path = Path("relief")
    """Folder to write; an earlier relief there is replaced, unless something in it was painted."""
    force: bool = False
    """Replace it even so, and keep it as NAME.backup-1."""
    tiles: bool | None = None
    """Whether the surface repeats: its left border continues its right one (default: as the images say)."""
    depth: str = "16"
    """16 (PNG) or float (EXR)."""
    integration: str = "poisson"
    """One view only: poisson (weighted by confidence) or fourier (Frankot-Chellappa)."""
    height_scale: float = 0.05
    """One picture only: height of white, in texture widths."""
    normal_strength: float = 1.0
    """One picture only: 1 to 8."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def run(self) -> None:
        from torchmat.material_io.relief_folder import check_target, save_relief
        from torchmat.report.lights import ball_picture
        from torchmat.report.pictures import mask_picture, relief_picture

        check_target(self.out, self.force)  # before the work, not after it
        relief, described, btf = self._recover()

        def draw(building: Path) -> None:
            with phase("drawing pictures"):
                relief_picture(relief, building / "relief.png")
                if btf is not None:
                    mask_picture(btf, building / "object_mask.png")
            if self.read.ball is not None and self.read.circle is not None:
                ball_picture(self.read.ball, self.read.circle, building / "ball.png")

        folder = save_relief(relief, self.out, self.depth, {"source": self.path, **described}, draw, self.force)
        for path in sorted(folder.iterdir()):
            print(f"relief     {path}")

    def _recover(self):
        """Return the relief, what is to be said of where it comes from, and the BTF that it is of, None for a picture."""
        from torchmat import colour
        from torchmat.btf.listing import is_image
        from torchmat.btf.photographs import read_linear
        from torchmat.btf.tiling import btf_tiling
        from torchmat.geometry import relief_from_picture
        from torchmat.geometry.tiling import tiling_of

        if Path(self.path).is_file() and is_image(self.path):
            with phase(f"reading {Path(self.path).name}"):
                picture = colour.display(read_linear(self.path, self.read.encoding or "auto"))
            tiles, described = self._tiles(tiling_of(picture[None]))
            return relief_from_picture(picture, self.height_scale, self.normal_strength, tiles), described, None
        btf = self.read.load(self.path)
        self._check_integration(btf)
        if len(btf.views) > 1:
            from torchmat.fitting import recover_geometry

            with phase("recovering the relief"):
                tiles, described = self._tiles(btf_tiling(btf))
                found = recover_geometry(btf, tiles=tiles)
            print("; ".join(f"{key}: {value}" for key, value in found.figures().items()))
            return found.relief, {**described, **btf.object_figures()}, btf
        return *self._of_one_view(btf), btf

    def _check_integration(self, btf) -> None:
        """Raise RangeError for a mask that the integration has no use for, before the work."""
        from torchmat.geometry.from_photographs import check_integration

        check_integration("geometry", self.integration, btf.mask if len(btf.views) == 1 else None)

    def _tiles(self, found):
        """Return whether the surface is taken to repeat, and what is to be said of it."""
        if self.tiles is not None:
            return self.tiles, {"tiles": self.tiles}
        print(f"tiles      {found.sentence()}")
        return found.repeats, {"tiles": found.repeats, "tiling": found.report()}

    def _of_one_view(self, btf):
        import torch

        from torchmat.btf.lambert import lambert_of, relief_of_one_view, with_estimated_intensities
        from torchmat.btf.lit import paired_lights
        from torchmat.btf.tiling import btf_tiling
        from torchmat.geometry import relief_from_photographs
        from torchmat.report.lights import lambert_text

        rows = (btf.light[:, 2] > 0).nonzero()[:, 0]
        lit = btf if len(rows) == len(btf) else btf.picked(rows)
        figures = lambert_of(lit)
        if figures and lit.intensity is None and self.read.intensities is None:
            with phase("estimating the intensities of the lights"):
                estimated = with_estimated_intensities(lit, only_if_better=True)
            print(f"note       {estimated.source.notes[-1]}")
            after = None if estimated.intensity is None else lambert_of(estimated)
            if after:
                figures, lit = figures.with_intensities(after), estimated
        for line in lambert_text(figures):
            print(line)
        with phase("looking at the images"):
            near = lit.light_position is not None
            images, light, weight = lit.images(range(0 if near else len(lit))), lit.light, lit.weights(range(0 if near else len(lit)))
        tiles, tiling = self._tiles(btf_tiling(lit))
        described = {
            **tiling, "notes": list(lit.source.notes), "lights": paired_lights(lit), "lambert": figures and figures.report(),
            **btf.object_figures(),
        }
        with phase("recovering the relief"):
            if near:
                found = relief_of_one_view(lit, torch.arange(len(lit)), lit.light.dtype, tiles, self.integration)
                return found, {**described, **lit.near.figures()}
            return relief_from_photographs(images, light, weight, tiles, self.integration, lit.mask), described
