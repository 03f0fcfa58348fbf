"""The printed board: ChArUco markers around a window, patches, places of mirror spheres, a scale bar; and where each of them is."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from torchmat.capturing.extra import opencv
from torchmat.errors import RangeError, check_option, check_positive, message

PAPERS = {
    "A3": (297.0, 420.0), "A4": (210.0, 297.0), "A5": (148.0, 210.0), "letter": (215.9, 279.4), "legal": (215.9, 355.6),
    "tabloid": (279.4, 431.8),
}
SERIES = 16  # boards that are told apart by the ids of their markers
WHITE, GREY, BLACK = 0.9, 0.2, 0.04  # reflectances as they are meant; what a printer makes of them is measured, not assumed

# The page is a grid of squares, row 0 at the top; (row, column, rows, columns) of what takes the place of squares.
ROWS, COLUMNS = 17, 11
_WINDOW = (5, 2, 7, 7)
_SPHERES = ((0, 8, 3, 3), (14, 0, 3, 3))
_PATCHES = {"white": ((0, 1, 2, 2), (15, 8, 2, 2)), "grey": ((0, 4, 2, 2), (15, 5, 2, 2))}
_MARGIN = 10.0  # mm that printers may leave white, and a scale bar
_BAR_HEIGHT, _BAR_STEP = 2.0, 50.0
RING = 0.4  # mm, width of the circle around a sphere
MODULES = 7  # of a marker along a side: five bits and its border
MARKER = 0.75  # of a square's side
PER_SERIES = 1000 // SERIES
DICTIONARY = "DICT_5X5_1000"
Place = tuple[int, int, int, int]


@dataclass(frozen=True)
class Board:
    """A board, and the places of its parts in millimetres: origin at the window's centre, x right, y up, the paper at z = 0.

    Args:
        paper: A3, A4, A5, letter, legal or tabloid.
        spheres: how many mirror spheres stand on it: 0, 1 or 2.
        diameter: of the spheres, in millimetres, at most two and a half squares.
        series: 0 to 15; the markers of each have ids of their own, so that boards in one room are not taken for each other.
        scale: what the printer made of a millimetre: measured over nominal length of the scale bar.

    Raises RangeError for anything else.
    """

    paper: str = "A4"
    spheres: int = 2
    diameter: float = 25.0
    series: int = 0
    scale: float = 1.0

    def __post_init__(self) -> None:
        check_option("board", "paper", self.paper, PAPERS)
        check_option("board", "spheres", self.spheres, (0, 1, 2))
        check_option("board", "series", self.series, range(SERIES))
        check_positive("board", "scale", self.scale, "It is the measured over the nominal length of the scale bar.")
        check_positive("board", "diameter", self.diameter, "It is that of the mirror spheres, in millimetres.")
        if self.spheres and self.diameter > 2.5 * self.square:
            fact, step = f"it is {self.diameter:g} mm", "Take smaller spheres, or larger paper."
            raise RangeError(message("board", "diameter", f"be at most {2.5 * self.square:g} mm on {self.paper}", fact, step))

    def measured(self, length: float) -> Board:
        """Return the board as it was printed: its scale bar has this length in millimetres."""
        check_positive("board", "the measured length of the scale bar", length, "Measure it in millimetres.")
        return dataclasses.replace(self, scale=length / (self.bar_length / self.scale))

    @property
    def page(self) -> tuple[float, float]:
        """Width and height of the paper as it is nominally, in millimetres."""
        return PAPERS[self.paper]

    @cached_property
    def square(self) -> float:
        """The side of a square in millimetres: nominally a multiple of half of one."""
        width, height = self.page
        return float(np.floor(2 * min((width - 2 * _MARGIN) / COLUMNS, (height - 2 * _MARGIN) / ROWS)) / 2 * self.scale)

    @cached_property
    def bar_length(self) -> float:
        """The length of the scale bar in millimetres."""
        return float(_BAR_STEP * np.floor(COLUMNS * self.square / self.scale / _BAR_STEP) * self.scale)

    @cached_property
    def window(self) -> np.ndarray:
        """The window (left, bottom, right, top) in millimetres."""
        return self._box(_WINDOW)

    @cached_property
    def bar(self) -> np.ndarray:
        """The scale bar (left, bottom, right, top) in millimetres."""
        middle = -(ROWS * self.square / 2 + self.scale * 4.5)
        return np.array([-self.bar_length / 2, middle - self.scale * _BAR_HEIGHT / 2, self.bar_length / 2, middle + self.scale * _BAR_HEIGHT / 2])

    @cached_property
    def patches(self) -> dict[str, np.ndarray]:
        """The boxes [n, 4] (left, bottom, right, top) of the white and of the grey patches, in millimetres."""
        return {name: np.stack([self._box(place) for place in places]) for name, places in _PATCHES.items()}

    @cached_property
    def sphere_centres(self) -> np.ndarray:
        """The centres [spheres, 3] of mirror spheres on their places, in millimetres."""
        boxes = np.array([self._box(place) for place in _SPHERES[: self.spheres]]).reshape(-1, 4)
        middle = (boxes[:, :2] + boxes[:, 2:]) / 2
        return np.column_stack((middle, np.full(len(middle), self.diameter / 2)))

    @cached_property
    def corners(self) -> np.ndarray:
        """The corners [n, 2] where four squares meet, in millimetres, row by row from the top left one."""
        return self._places(self._corner_rows, self._corner_columns)

    @cached_property
    def marker_ids(self) -> np.ndarray:
        """The ids [m] of the markers."""
        return self.series * PER_SERIES + np.arange(len(self._marker_cells))

    @cached_property
    def marker_corners(self) -> np.ndarray:
        """The corners [m, 4, 2] of the markers in millimetres: top left, top right, bottom right, bottom left."""
        rim = (1 - MARKER) / 2
        offsets = np.array([[rim, rim], [rim, 1 - rim], [1 - rim, 1 - rim], [1 - rim, rim]])
        cells = self._marker_cells[:, None] + offsets
        return self._places(cells[..., 0], cells[..., 1])

    def reflectance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return what the board reflects at points in millimetres, float32 of their shape; words and outside are white paper."""
        column, row = x / self.square + COLUMNS / 2, ROWS / 2 - y / self.square
        inside = (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < ROWS)
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        cell_row, cell_column = row.astype(np.int32), column.astype(np.int32)
        index = ((cell_row * COLUMNS + cell_column) * (MODULES + 2) + _module(row - cell_row)) * (MODULES + 2) + _module(column - cell_column)
        found = np.where(inside, self.levels.reshape(-1)[index], np.float32(WHITE))
        for centre in self.sphere_centres:
            distance = np.hypot(x - centre[0], y - centre[1])
            found[np.abs(distance - self.diameter / 2) < RING / 2] = GREY
        left, bottom, right, top = self.bar
        found[(x > left) & (x < right) & (y > bottom) & (y < top)] = BLACK
        return found

    @cached_property
    def levels(self) -> np.ndarray:
        """Reflectances [row, column, module row, module column], the rim of a square first and last."""
        levels = np.full((ROWS, COLUMNS, MODULES + 2, MODULES + 2), WHITE, np.float32)
        rows, columns = np.indices((ROWS, COLUMNS))
        levels[self._whole & ((rows + columns) % 2 == 0)] = BLACK
        bits = marker_bits(self.marker_ids)
        levels[self._marker_cells[:, 0], self._marker_cells[:, 1], 1:-1, 1:-1] = np.where(bits, WHITE, BLACK)
        for row, column, height, width in _PATCHES["grey"]:
            levels[row : row + height, column : column + width] = GREY
        return levels

    @cached_property
    def _whole(self) -> np.ndarray:
        """Which squares [rows, columns] are there."""
        whole = np.ones((ROWS, COLUMNS), bool)
        for row, column, height, width in (_WINDOW, *_SPHERES[: self.spheres], *_PATCHES["white"], *_PATCHES["grey"]):
            whole[row : row + height, column : column + width] = False
        return whole

    @cached_property
    def _marker_cells(self) -> np.ndarray:
        rows, columns = np.indices((ROWS, COLUMNS))
        return np.argwhere(self._whole & ((rows + columns) % 2 == 1))

    @cached_property
    def _corner_cells(self) -> np.ndarray:
        whole = self._whole
        return np.argwhere(whole[1:, 1:] & whole[1:, :-1] & whole[:-1, 1:] & whole[:-1, :-1]) + 1

    @property
    def _corner_rows(self) -> np.ndarray:
        return self._corner_cells[:, 0]

    @property
    def _corner_columns(self) -> np.ndarray:
        return self._corner_cells[:, 1]

    @cached_property
    def corner_signs(self) -> np.ndarray:
        """Of each corner [n], 1 where the square above and to the left of it is black, -1 where it is white."""
        return np.where(self._corner_cells.sum(1) % 2 == 0, 1, -1)

    def _places(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        return np.stack(((columns - COLUMNS / 2) * self.square, (ROWS / 2 - rows) * self.square), axis=-1)

    def _box(self, place: Place) -> np.ndarray:
        row, column, height, width = place
        corners = self._places(np.array([row + height, row]), np.array([column, column + width]))
        return corners.reshape(-1)


def marker_bits(ids: np.ndarray) -> np.ndarray:
    """Return the modules [n, 7, 7] of markers, their border among them; True is white."""
    aruco = opencv().aruco
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, DICTIONARY))
    return np.stack([aruco.generateImageMarker(dictionary, int(one), MODULES) > 0 for one in ids])


def _module(share: np.ndarray) -> np.ndarray:
    """Return which module, 1 to 7, shares of a square's side fall into; its rim is 0 and 8."""
    return np.clip(np.floor((share - (1 - MARKER) / 2) * (MODULES / MARKER)) + 1, 0, MODULES + 1).astype(np.int32)
