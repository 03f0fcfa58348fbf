"""The board on paper: PDF and SVG in exact millimetres, and PNG, drawn from the same places that photographs are measured by."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torchmat import atomic
from torchmat.capturing.board import BLACK, COLUMNS, GREY, MARKER, MODULES, RING, ROWS, WHITE, Board
from torchmat.errors import check_option, check_positive

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.path import Path as Outline

SUFFIXES = (".pdf", ".svg", ".png")
_INCH = 25.4
_TEXT = 5.0  # points
# The same board gives the same bytes.
_NO_DATE: dict[str, dict] = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}, ".png": {"Software": None}}


def write_board(board: Board, path: str | Path, dpi: float = 600.0) -> Path:
    """Write the board to a .pdf, .svg or .png of the paper's size; return the path.

    `dpi` is the resolution of a PNG. Raises RangeError for another suffix, DataError where the file cannot be written.
    """
    path = Path(path)
    check_option("board", "the suffix", path.suffix.lower(), SUFFIXES)
    check_positive("board", "dpi", dpi, "It is that of a PNG; 600 is usual.")
    import matplotlib
    from matplotlib.figure import Figure

    width, height = board.page
    with matplotlib.rc_context({"svg.hashsalt": "board", "pdf.fonttype": 42}), atomic.building_file(path) as built:
        figure = Figure(figsize=(width / _INCH, height / _INCH))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_xlim(-width / 2, width / 2)
        axes.set_ylim(-height / 2, height / 2)
        axes.axis("off")
        _draw(axes, board)
        figure.savefig(built, dpi=dpi, metadata=_NO_DATE[path.suffix.lower()])
    return path


def _draw(axes: Axes, board: Board) -> None:
    from matplotlib.patches import Circle, PathPatch

    for level in (BLACK, GREY):
        # One outline for all: where boxes touch, no fine line of paper shines through.
        axes.add_patch(PathPatch(_outline(np.array(list(_boxes(board, level)))), facecolor=_ink(level), linewidth=0))
    for x, y, _ in board.sphere_centres:
        points_per_mm = 72 / _INCH
        axes.add_patch(Circle((x, y), board.diameter / 2, fill=False, edgecolor=_ink(GREY), linewidth=RING * points_per_mm))
    size = f"A sphere of {board.diameter:g} mm stands in each circle. " if board.spheres else ""
    said = f"{board.paper}, series {board.series}. Print at 100 %: this bar is {board.bar_length:g} mm long; if not, measure it. {size}"
    axes.text(0, board.bar[1] - 0.4, said.strip(), fontsize=_TEXT, ha="center", va="top", color=_ink(GREY))
    axes.text(0, ROWS * board.square / 2 + 1, "top", fontsize=_TEXT, ha="center", va="bottom", color=_ink(GREY))


def _boxes(board: Board, level: float) -> Iterator[np.ndarray]:
    """Yield (left, bottom, right, top) of what has this reflectance, in millimetres."""
    steps = np.concatenate(([0], (1 - MARKER) / 2 + np.arange(MODULES + 1) * MARKER / MODULES, [1]))
    for row in range(ROWS):
        for column in range(COLUMNS):
            levels = board.levels[row, column] == np.float32(level)
            if levels.all():
                yield _box(board, row, row + 1, column, column + 1)
                continue
            for r, c in np.argwhere(levels):
                yield _box(board, row + steps[r], row + steps[r + 1], column + steps[c], column + steps[c + 1])
    if level == BLACK:
        yield board.bar


def _box(board: Board, top: float, bottom: float, left: float, right: float) -> np.ndarray:
    return board.square * np.array([left - COLUMNS / 2, ROWS / 2 - bottom, right - COLUMNS / 2, ROWS / 2 - top])


def _outline(boxes: np.ndarray) -> Outline:
    from matplotlib.path import Path as Outline

    corners = boxes[:, [[0, 1], [2, 1], [2, 3], [0, 3], [0, 1]]]
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
    return Outline(corners.reshape(-1, 2), codes * len(boxes))


def _ink(reflectance: float) -> str:
    """Return the grey, by matplotlib's name, that looks as much darker than paper as it is meant to."""
    share = (reflectance - BLACK) / (WHITE - BLACK)
    encoded = 12.92 * share if share <= 0.0031308 else 1.055 * share ** (1 / 2.4) - 0.055
    return f"{encoded:.4f}"
