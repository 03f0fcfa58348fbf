"""Deep Zoom images: a picture as tiles in levels, each half as large as the next, of which a viewer loads what it shows.

``NAME.dzi`` says size, tile size and overlap; ``NAME_files/LEVEL/COLUMN_ROW.jpg`` are the tiles. The last level is the picture
itself, level 0 what first fits into one tile, as relight writes it and OpenLIME's layout "deepzoom" asks for it (libvips:
``--depth onetile``); Microsoft's description (Deep Zoom file format, 2008) goes on to one pixel and calls that level 0, which is
read too. A tile holds its neighbours' nearest pixels as well, `OVERLAP` of them on each side that has a neighbour, so that
filtering shows no seam.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as tree
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from torchmat.errors import DataError, message
from torchmat.images import read_image, write_image

TILE, OVERLAP = 254, 1  # what libvips and relight take: tiles of 256 pixels at most
SUFFIX = ".dzi"
_SPACE = "http://schemas.microsoft.com/deepzoom/2008"
_WHOLE = re.compile("[0-9]{1,6}")


def level_count(height: int, width: int, smallest: int = TILE) -> int:
    """Return how many levels a picture has: halves, rounded up, until one has at most `smallest` pixels along both sides."""
    return (-(-max(height, width) // smallest) - 1).bit_length() + 1


def levels(pixels: np.ndarray) -> Iterator[np.ndarray]:
    """Yield a picture [H, W, C] of 8 bits and its halves, means of 2 x 2 pixels, down to one tile."""
    for _ in range(level_count(*pixels.shape[:2])):
        yield pixels
        pixels = halved(pixels)


def halved(pixels: np.ndarray) -> np.ndarray:
    """Return the means of 2 x 2 pixels of codes [H, W, C]; of an odd size the last row or column is there twice."""
    bottom, right = (size % 2 for size in pixels.shape[:2])
    if bottom or right:
        pixels = np.pad(pixels, ((0, bottom), (0, right), (0, 0)), mode="edge")
    total = np.full((pixels.shape[0] // 2, pixels.shape[1] // 2, pixels.shape[2]), 2, np.uint16)  # half of 4, so that it rounds
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        total += pixels[row::2, column::2]
    return (total // 4).astype(pixels.dtype)


def _span(number: int, size: int, tile: int, overlap: int) -> slice:
    """Return which pixels of a line tile `number` holds, with those of its neighbours."""
    return slice(max(0, number * tile - overlap), min(size, (number + 1) * tile + overlap))


def write_deep_zoom(path: Path, pixels: np.ndarray, image: str = "jpg", quality: int | None = None) -> list[Path]:
    """Write a picture [H, W, 3] of 8 bits as `path`, which ends in .dzi, and the tiles beside it; return the files.

    `image` is the tiles' format, "jpg" at `quality` or "png". Raises DataError, which names the file, when that fails.
    """
    height, width = pixels.shape[:2]
    files = []
    for level, picture in zip(reversed(range(level_count(height, width))), levels(pixels), strict=True):
        folder = path.with_name(f"{path.stem}_files") / str(level)
        folder.mkdir(parents=True)
        rows, columns = (-(-size // TILE) for size in picture.shape[:2])
        for row in range(rows):
            band = picture[_span(row, picture.shape[0], TILE, OVERLAP)]
            for column in range(columns):
                files.append(folder / f"{column}_{row}.{image}")
                write_image(files[-1], band[:, _span(column, picture.shape[1], TILE, OVERLAP)], quality=quality)
    root = tree.Element("Image", {"xmlns": _SPACE, "Format": image, "Overlap": str(OVERLAP), "TileSize": str(TILE)})
    tree.SubElement(root, "Size", {"Width": str(width), "Height": str(height)})
    path.write_bytes(tree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
    return [path, *files]


def read_deep_zoom(path: Path) -> np.ndarray:
    """Return the finest level of a Deep Zoom image as [H, W, C]; raises DataError, which names the file, for what is no such image."""
    (height, width), tile, overlap, image = _description(path)
    found = path.with_name(f"{path.stem}_files")
    # Of levels down to one pixel the finest has a higher number; the other then stands for a coarse one.
    folder, other = (found / str(level_count(height, width, smallest) - 1) for smallest in (tile, 1))
    folder = other if other.is_dir() else folder
    whole: np.ndarray | None = None
    for row in range(-(-height // tile)):
        for column in range(-(-width // tile)):
            file = folder / f"{column}_{row}.{image}"
            if not file.is_file():
                raise DataError(message(str(file), "the tile", "exist", "it is not there", "Restore it, or build all tiles again."))
            pixels = read_image(file)
            rows, columns = _span(row, height, tile, overlap), _span(column, width, tile, overlap)
            wanted = (rows.stop - rows.start, columns.stop - columns.start)
            if pixels.shape[:2] != wanted or (whole is not None and pixels.shape[2:] != whole.shape[2:]):
                fact = f"it is {pixels.shape}"
                raise DataError(message(str(file), "the tile", f"be {wanted}, as {path.name} says", fact, "Build all tiles again."))
            whole = np.empty((height, width, pixels.shape[2]), pixels.dtype) if whole is None else whole
            whole[rows, columns] = pixels
    assert whole is not None  # a picture has a tile
    return whole


def _description(path: Path) -> tuple[tuple[int, int], int, int, str]:
    """Return height and width, tile size, overlap and the tiles' format that a .dzi states."""
    try:
        text = path.read_bytes()[:65536]
        root = tree.fromstring(text) if b"<!" not in text else None  # without entities, which may grow without end
        size = None if root is None else root.find(f"{{{_SPACE}}}Size")
        stated = None if root is None or size is None else [size.get("Height"), size.get("Width"), root.get("TileSize"), root.get("Overlap")]
    except (OSError, tree.ParseError) as error:
        raise DataError(message(str(path), "the file", "be a Deep Zoom description", str(error), "Restore it.")) from error
    image = "" if root is None else str(root.get("Format"))
    numbers = [int(value) for value in stated or () if value is not None and _WHOLE.fullmatch(value)]
    if len(numbers) != 4 or min(numbers[:3]) < 1 or numbers[3] >= numbers[2] or image not in ("jpg", "jpeg", "png"):
        fact = f"it states {stated} and tiles of {image!r}"
        raise DataError(message(str(path), "the file", "state size, tiles and their format", fact, "Restore it."))
    return (numbers[0], numbers[1]), numbers[2], numbers[3], image
