"""torchmat board."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from torchmat.cli.known import PAPERS, POSITIVE


@dataclass
class Board:
    """Draw the board on which samples are photographed for `capture`: PDF or SVG to print, or PNG (needs torchmat[capture])."""

    words: ClassVar = {"size": PAPERS, "spheres": (0, 1, 2)}
    bounds: ClassVar = {"diameter": POSITIVE, "dpi": POSITIVE, "series": ("lie in [0, 15]", 0, 15)}

    size: str = "A4"
    """Paper: A3, A4, A5, letter, legal or tabloid."""
    out: Path = Path("board.pdf")
    """File to write: .pdf or .svg in exact millimetres, or .png."""
    spheres: int = 2
    """How many mirror spheres will stand on it: 0, 1 or 2."""
    diameter: float = 25.0
    """Of the spheres, in millimetres."""
    series: int = 0
    """0 to 15: boards of other series are told apart."""
    dpi: float = 600.0
    """Resolution of a PNG."""

    def run(self) -> None:
        from torchmat.capturing.board import Board as Printed
        from torchmat.capturing.draw_board import write_board

        board = Printed(self.size, self.spheres, self.diameter, self.series)
        left, bottom, right, top = board.window
        print(f"board      {write_board(board, self.out, self.dpi)}")
        print(f"window     {right - left:g} x {top - bottom:g} mm")
        print(f"scale bar  {board.bar_length:g} mm: measure it on the print; capture takes --measured MM where it differs")
