"""torchmat capture."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.known import ENCODINGS, LAMPS, PAPERS, POSITIVE


@dataclass
class Capture:
    """Make a BTF of photographs of a flat sample on the board that `board` draws: rectified, calibrated, with a page that shows each step
    (needs torchmat[capture])."""

    reads: ClassVar = ("path", "flat", "chart")
    words: ClassVar = {"size": PAPERS, "spheres": (0, 1, 2), "encoding": ENCODINGS}
    bounds: ClassVar = {
        "diameter": POSITIVE, "series": ("lie in [0, 15]", 0, 15), "measured": POSITIVE, "texel": POSITIVE, "distance": POSITIVE,
        "white": ("lie in (0, 1]", 5e-324, 1), "grey": ("lie in (0, 1]", 5e-324, 1), "brackets": ("lie in [1, 15]", 1, 15),
    }

    path: Annotated[str, tyro.conf.Positional]
    """Folder of photographs, raw files too: of one camera, zoomed and focused alike."""
    out: Path = Path("captured")
    """Folder to write: manifest.csv, pictures, capture.json and capture.html."""
    force: bool = False
    """Replace an earlier capture even where something in it was changed, and keep it as NAME.backup-1."""
    size: str = "A4"
    """Paper of the board: A3, A4, A5, letter, legal or tabloid."""
    spheres: int = 2
    """How many mirror spheres stand on it: 0, 1 or 2."""
    diameter: float = 25.0
    """Of the spheres, in millimetres."""
    series: int = 0
    """Of the board, 0 to 15."""
    measured: float | None = None
    """Length of the printed scale bar in millimetres (default: as printed at 100 %, which is said)."""
    lights: str = "auto"
    """spheres, flash (beside the lens), shading (of the paper: an estimate), or a table or dome file; auto takes the spheres, and the
    shading where there are none."""
    flash_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of the flash from the lens in millimetres: right, down, forward, as the camera is held level."""
    positions: bool = False
    """The numbers of a table of lights are positions in millimetres from the window's middle."""
    distance: float | None = None
    """Of all lights of a table from the window's middle, in millimetres (default: they are far)."""
    white: float | None = None
    """Reflectance of the white patch, as a share."""
    grey: float | None = None
    """Reflectance of the grey patch where it is known (default: measured)."""
    flat: Path | None = None
    """Photograph of evenly lit white (default: vignetting is found on the board's paper)."""
    even: bool = False
    """A lamp is not stronger to one side than its distance explains."""
    chart: Path | None = None
    """Photograph of a ColorChecker Classic of 24 patches, under the same light."""
    chart_corners: tuple[float, float, float, float, float, float, float, float] | None = None
    """The middles of its dark skin, bluish green, black and white patches in pixels: column and row of each (default: they are searched)."""
    brackets: int | None = None
    """Exposures of each bracket, in the order of the photographs (default: as their files say; 1 merges none)."""
    texel: float | None = None
    """Side of a texel in millimetres (default: as the photographs resolve it)."""
    height: float | None = None
    """Of the sample's surface above the board, in millimetres (default: found from its own pattern, else 0)."""
    no_register: bool = False
    """Do not register photographs on the sample itself."""
    encoding: str = "auto"
    """auto, srgb or linear."""

    def check_names(self) -> None:
        from torchmat.cli.early import check_there
        from torchmat.errors import RangeError, check_option, message

        if self.chart_corners is not None and self.chart is None:
            step = "Give the chart's photograph: --chart FILE."
            raise RangeError(message("capture", "--chart-corners", "come with a chart", "--chart is not given", step))
        if Path(self.lights).suffix:
            check_there(self.lights)
        else:
            check_option("capture", "--lights", self.lights, LAMPS)

    def run(self) -> None:
        from torchmat.capturing.board import Board
        from torchmat.capturing.capture import capture
        from torchmat.capturing.page import steps_table

        board = Board(self.size, self.spheres, self.diameter, self.series)
        captured = capture(
            self.path, self.out, board, self.light(), measured=self.measured, texel=self.texel, height=self.height,
            refine=not self.no_register, brackets=self.brackets, encoding=self.encoding, force=self.force,
        )
        print(steps_table(captured.steps))
        for step in captured.steps:
            for note in step.notes:
                print(f"note       {step.name}: {note}")
        print(f"BTF        {captured.folder}")
        print(f"page       {captured.folder / 'capture.html'}")

    def light(self):
        """Return where light and colour come from, as the arguments say."""
        from torchmat.capturing.photometry import PhotometryOptions

        corners = None if self.chart_corners is None else [self.chart_corners[at : at + 2] for at in range(0, 8, 2)]
        options = PhotometryOptions(
            self.lights, self.flash_offset, self.positions, self.distance, grey=self.grey, flat=self.flat, even=self.even, chart=self.chart,
            chart_corners=corners, encoding=self.encoding,
        )
        return options if self.white is None else dataclasses.replace(options, white=self.white)
