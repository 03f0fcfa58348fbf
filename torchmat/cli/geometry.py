"""torchmat geometry."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.arguments import DataArguments


@dataclass
class Geometry:
    """Recover height and normals: from a BTF, from photographs of one view under known lights, or from one picture."""

    reads: ClassVar = ("path", "lights", "ball")

    path: Annotated[str, tyro.conf.Positional]
    """BTF or RTI capture, a folder of photographs with --lights or --ball, or one picture."""
    out: Path = Path("relief")
    """Folder to write; an earlier relief there is replaced, unless something in it was painted."""
    force: bool = False
    """Replace it even so, and keep it as NAME.backup-1."""
    lights: Path | None = None
    """Text file with x y z of one light a line (or a column), in the order of the photographs' names."""
    ball: Path | None = None
    """Folder of photographs of a chrome ball under the same lights, in the same order."""
    circle: tuple[float, float, float] | None = None
    """The ball's centre (column, row) and radius in pixels."""
    tiles: bool = False
    """The surface repeats: its left border continues its right one."""
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
        from torchmat.report.pictures import relief_picture

        check_target(self.out, self.force)  # before the work, not after it
        relief = self._recover()

        def draw(building: Path) -> None:
            relief_picture(relief, building / "relief.png")

        folder = save_relief(relief, self.out, self.depth, {"source": self.path}, draw, self.force)
        for path in sorted(folder.iterdir()):
            print(f"relief     {path}")

    def _recover(self):
        from torchmat import colour
        from torchmat.btf.listing import is_image
        from torchmat.btf.photographs import read_linear, read_photographs
        from torchmat.geometry import relief_from_photographs, relief_from_picture

        encoding = self.read.encoding or "auto"
        if Path(self.path).is_file() and is_image(self.path):
            picture = colour.display(read_linear(self.path, encoding))
            return relief_from_picture(picture, self.height_scale, self.normal_strength, self.tiles)
        if self.lights is not None or self.ball is not None:
            images, weight = read_photographs(self.path, encoding), None
            light = self._given_lights(len(images))
        else:
            btf = self.read.load(self.path)
            if len(btf.views) > 1:
                from torchmat.fitting import recover_geometry

                found = recover_geometry(btf, tiles=self.tiles)
                print("; ".join(f"{key}: {value}" for key, value in found.figures().items()))
                return found.relief
            rows = ((btf.view_index == 0) & (btf.light[:, 2] > 0)).nonzero()[:, 0]  # views run from the pole outward
            images, light, weight = btf.images(rows), btf.light[rows], btf.weights(rows)
        return relief_from_photographs(images, light, weight, self.tiles, self.integration)

    def _given_lights(self, count: int):
        import torch

        from torchmat.btf.photographs import read_lights, read_photographs
        from torchmat.errors import RangeError, message
        from torchmat.geometry import find_highlight, lights_from_ball

        if self.lights is not None:
            return read_lights(self.lights, count)
        assert self.ball is not None
        balls = read_photographs(self.ball)
        if self.circle is None or len(balls) != count:
            fact = "--circle is missing" if self.circle is None else f"there are {len(balls)} for {count} photographs"
            step = "Give --circle COLUMN ROW RADIUS and one photograph of the ball for each light."
            raise RangeError(message(str(self.ball), "the ball", "be calibrated", fact, step))
        centre, radius = self.circle[:2], self.circle[2]
        highlights = torch.stack([find_highlight(ball, centre, radius) for ball in balls])
        return lights_from_ball(highlights, centre, radius).float()
