"""Tables of lights: ``.lp`` files, CSV, or plain columns of numbers, with names of photographs, running numbers and
intensities or without."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from torchmat.btf.listing import is_image
from torchmat.errors import DataError, message
from torchmat.text_file import read_text

_WAYS = "Write `name x y z`, `x y z name` or `x y z` a line; the light's intensity, one number or three, may follow."
_COMMENTS = ("#", "%")
# Three numbers with decimal commas or more of them, white space or semicolons between them, behind a name or before it.
_COMMA_NUMBER = r"[-+]?(?:\d+(?:,\d+)?|,\d+)(?:[eE][-+]?\d+)?"
_COMMA_NUMBERS = rf"(?P<numbers>{_COMMA_NUMBER}(?:[\s;]+{_COMMA_NUMBER}){{2,5}})"
_DECIMAL_COMMAS = (
    re.compile(rf"(?P<name>|.*?[\s;,]){_COMMA_NUMBERS}$"), re.compile(rf"{_COMMA_NUMBERS}[\s;,]+(?P<name>[^\s;,].*)$"),
)
_LONGEST_LINE = 1000  # letters that are looked at for commas
_AXES = tuple(re.compile(rf"(?:light|dir|direction|l|n|d)?[ _.-]?{axis}") for axis in "xyz")
_INTENSITIES = (("intensity",), ("i",), ("r", "g", "b"), ("red", "green", "blue"))


@dataclass(frozen=True)
class Row:
    """One light: where the line stands, what it calls the photograph (None: nothing), x y z and 0, 1 or 3 intensities."""

    where: str
    name: str | None
    numbers: tuple[float, ...]


@dataclass(frozen=True)
class LightTable:
    """The lights of a table, in its order: `names` [n] (None: the photographs' own order), the `where` [n] of each line,
    `light` [n, 3] float64 as it is written, `intensity` [n, 3] or None, and `notes` on what was taken for what.

    `near` says that the lights are positions, and `width` how wide the picture is in their unit, where a file tells it: a dome does."""

    path: str
    names: tuple[str, ...] | None
    where: tuple[str, ...]
    light: Tensor
    intensity: Tensor | None = None
    notes: tuple[str, ...] = ()
    near: bool = False
    width: float | None = None


def _number(token: str) -> float:
    try:
        return float(token)
    except ValueError:
        return math.nan


def _finite(numbers: Sequence[float]) -> bool:
    return all(map(math.isfinite, numbers))


def _readings(line: str) -> list[tuple[str, tuple[float, ...]]]:
    """Return every way to read a line as (text that names the file, x y z and intensities), the usual one first."""
    tokens = list(re.finditer(r"[^\s,;]+", line))
    numbers = [_number(token[0]) for token in tokens]
    count = len(tokens)
    # A leading running number is not part of the name, unless a file is really called so.
    numbered = count > 4 and re.fullmatch(r"\d+", tokens[0][0])
    ways = []
    for given in (3, 4, 6):  # x y z, alone or with intensities
        spans = [(0, count - given, count - given)] + [(1, count - given, count - given)] * bool(numbered)
        spans += [(given, count, 0)] + [(given + 1, count, 1)] * bool(numbered)
        for start, end, first in spans:
            if 0 <= start < end <= count and _finite(numbers[first : first + given]):
                text = line[tokens[start].start() : tokens[end - 1].end()].strip("\"'")
                ways.append((text, tuple(numbers[first : first + given])))
    return ways


def _best(ways: list[tuple[str, tuple[float, ...]]], known: Callable[[str], bool]) -> tuple[str, tuple[float, ...]] | None:
    for wanted in (known, is_image):
        for way in ways:
            if wanted(way[0]):
                return way
    return ways[0] if ways else None


def _with_points(where: str, lines: list[tuple[int, str]]) -> tuple[list[tuple[int, str]], bool]:
    """Return the lines with decimal points where all have decimal commas, and whether they had."""
    for pattern in _DECIMAL_COMMAS if any("," in line for _, line in lines) else ():
        matches = [pattern.match(line) if len(line) < _LONGEST_LINE else None for _, line in lines]
        if all(matches) and any("," in match["numbers"] for match in matches if match):
            changed = [f"{match['name'].rstrip(' ;,')}\t{match['numbers'].replace(',', '.')}".strip() for match in matches if match]
            return [(number, line) for (number, _), line in zip(lines, changed, strict=True)], True
    for number, line in lines:
        found = re.search(r"[\s,;](-?\d),(\d+),(-?\d),(\d+),(-?\d),(\d+)$", f" {line[:_LONGEST_LINE]}")
        if found:
            pairs = [float(f"{found[k]}.{found[k + 1]}") for k in (1, 3, 5)]
            plain = [float(found[k]) for k in (1, 2, 3)]
            if abs(math.hypot(*pairs) - 1) < 0.02 < abs(math.hypot(*plain) - 1):
                fact = f"it is {line!r}, with commas in the numbers and between them"
                step = "Write decimals with a point, or put tabs or semicolons between the columns."
                raise DataError(message(f"{where}: line {number}", "the line", "be readable in one way", fact, step))
    return lines, False


def _columns(where: str, line: str) -> list[int] | None:
    """Return the places of name, x, y, z and intensities in a header line (name -1: it has none); None if it is no header."""
    cells = [cell.strip(" \"'").lower() for cell in (re.split(r"[;,\t]", line) if re.search(r"[;,\t]", line) else line.split())]
    axes = [[place for place, cell in enumerate(cells) if axis.fullmatch(cell)] for axis in _AXES]
    if not all(len(places) == 1 for places in axes):
        return None
    places = [places[0] for places in axes]
    for names in _INTENSITIES:
        if all(cells.count(name) == 1 for name in names):
            places += [cells.index(name) for name in names]
            break
    left = [place for place in range(len(cells)) if place not in places and cells[place] not in ("", "#", "no", "number", "index")]
    if len(left) > 1:
        fact = f"it has {', '.join(cells)}"
        step = "Keep the file's name, x, y, z, and intensity or r, g, b."
        raise DataError(message(where, "the header", "name no other columns", fact, step))
    return [left[0] if left else -1, *places]


def _row_by_header(where: str, line: str, columns: list[int]) -> Row:
    cells = [cell.strip(" \"'") for cell in (re.split(r"[;,\t]", line) if re.search(r"[;,\t]", line) else line.split())]
    numbers = tuple(_number(cells[place]) if place < len(cells) else math.nan for place in columns[1:])
    if not _finite(numbers) or columns[0] >= len(cells):
        fact = f"it is {line!r}"
        raise DataError(message(where, "the line", "hold a finite number in each column", fact, "Complete or remove it."))
    return Row(where, cells[columns[0]] if columns[0] >= 0 else None, numbers)


def _numeric(rows: list[Row], images: int | None, where: str) -> list[Row]:
    """Return rows of numbers alone as rows of x y z and intensities: turned, and without running numbers, where need be."""
    widths = {len(row.numbers) for row in rows}
    width = widths.pop()
    if widths:
        fact = f"some have {width} numbers and some {widths.pop()}"
        raise DataError(message(where, "the lines", "have one number of columns", fact, _WAYS))
    if len(rows) == 3 and width == images != 3:
        turned = zip(*(row.numbers for row in rows), strict=True)
        return [Row(f"{where}: column {number}", None, numbers) for number, numbers in enumerate(turned, 1)]
    first = [row.numbers[0] for row in rows]
    running = first in ([*map(float, range(len(rows)))], [*map(float, range(1, len(rows) + 1))])
    if width in (4, 5, 7) and running:
        rows, width = [replace(row, numbers=row.numbers[1:]) for row in rows], width - 1
    if width not in (3, 4, 6):
        fact = f"there are {len(rows)} lines of {width} numbers" + (f" for {images} photographs" if images else "")
        raise DataError(message(where, "the table", "hold x y z for each photograph", fact, _WAYS))
    return rows


def _announced(lines: list[tuple[int, str]]) -> int | None:
    """Take a leading count line away; return what it says, None where there is none."""
    if lines and re.fullmatch(r"[0-9]{1,9}", lines[0][1]):
        return int(lines.pop(0)[1])
    return None


def parse_lights(
    where: str, text: str, known: Callable[[str], bool] = is_image, images: int | None = None
) -> LightTable:
    """Return the lights of a table's `text`; raises DataError, which names the line, where it cannot be read.

    A line is ``name x y z``, ``x y z name`` or ``x y z``, with a running number before it or without, separated by white
    space, commas or semicolons; an intensity, or three of red, green and blue, may follow x y z. A count line, a header
    line, lines that start with # or %, and decimal commas are understood. Numbers alone may stand turned: three lines of
    `images` columns. `known` tells whether a text names a photograph, which settles what of a line is its name.
    """
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line and not line.startswith(_COMMENTS)]
    count = _announced(lines)
    columns = _columns(f"{where}: line {lines[0][0]}", lines[0][1]) if lines else None
    lines = lines[1:] if columns else lines
    lines, had_commas = _with_points(where, lines)
    notes = ["decimal commas were read as decimal points"] if had_commas else []
    if count is not None and count != len(lines):
        fact = f"it says {count} and {len(lines)} follow"
        raise DataError(message(where, "the count line", "match the lines below it", fact, "Complete the file."))
    if not lines:
        raise DataError(message(where, "the file", "list at least one image", "it lists none", _WAYS))
    rows = _rows(where, lines, columns, known, images)
    if len({len(row.numbers) for row in rows}) > 1:
        step = "Give each light its intensity, or none."
        raise DataError(message(where, "the lines", "all have as many numbers", "some have intensities", step))
    names = None if rows[0].name is None else tuple(str(row.name) for row in rows)
    numbers = torch.tensor([row.numbers for row in rows], dtype=torch.float64)
    table = LightTable(where, names, tuple(row.where for row in rows), numbers[:, :3], None, tuple(notes))
    if numbers.shape[1] == 3:
        return table
    return with_intensity(table, numbers[:, 3:], where)


def _rows(
    where: str, lines: list[tuple[int, str]], columns: list[int] | None, known: Callable[[str], bool], images: int | None
) -> list[Row]:
    if columns:
        return [_row_by_header(f"{where}: line {number}", line, columns) for number, line in lines]
    numbers = [[_number(token) for token in re.findall(r"[^\s,;]+", line)] for _, line in lines]
    named = any(known(way[0]) for way in _readings(lines[0][1]))
    if not named and all(_finite(row) and len(row) > 2 for row in numbers):
        return _numeric([Row(f"{where}: line {n}", None, tuple(row)) for (n, _), row in zip(lines, numbers, strict=True)], images, where)
    rows = []
    for number, line in lines:
        best = _best(_readings(line), known)
        if best is None:
            raise DataError(message(f"{where}: line {number}", "the line", "hold a name and x y z", f"it is {line!r}", _WAYS))
        rows.append(Row(f"{where}: line {number}", *best))
    return rows


def with_intensity(table: LightTable, intensity: Tensor, where: str) -> LightTable:
    """Return a table whose lights have `intensity` [n, 1] or [n, 3]; raises DataError, which names the file, for others."""
    bad = ~(torch.isfinite(intensity) & (intensity > 0)).all(dim=1)
    if len(intensity) != len(table.light) or bool(bad.any()):
        fact = f"there are {len(intensity)} for {len(table.light)} lights"
        if bool(bad.any()):
            fact = f"{int(bad.sum())} are not, first is number {int(bad.nonzero()[0, 0]) + 1}"
        step = "Give one, or red, green and blue, of each light, in the order of the photographs."
        raise DataError(message(where, "intensities", "be positive numbers, as many as lights", fact, step))
    return replace(table, intensity=intensity.expand(-1, 3).contiguous())


def read_intensities(path: str | Path, lights: int) -> Tensor:
    """Return intensities [n, 1 or 3], float64, of a file with one number, or red, green and blue, for each of n `lights`.

    Raises DataError, which names the file, when it holds anything else.
    """
    return parse_intensities(str(path), read_text(path, "the intensities"), lights)


def parse_intensities(where: str, text: str, lights: int) -> Tensor:
    """Return intensities [n, 1 or 3], float64, of a text; see `read_intensities`."""
    lines = [line for line in map(str.strip, text.splitlines()) if line and not line.startswith(_COMMENTS)]
    rows = [[_number(token) for token in re.findall(r"[^\s,;]+", line)] for line in lines]
    widths = {len(row) for row in rows}
    if len(widths) != 1 or not all(map(_finite, rows)):
        fact = f"there are {len(rows)} lines of {', '.join(map(str, sorted(widths))) or 'no'} columns, or not all are numbers"
        step = "One light a line, in the order of the photographs."
        raise DataError(message(where, "the intensities", "be a table of numbers", fact, step))
    values = torch.tensor(rows, dtype=torch.float64)
    if values.shape != (lights, 1) and values.shape != (lights, 3) and values.shape[1] == lights:
        values = values.T
    if values.shape not in ((lights, 1), (lights, 3)) or not bool((values > 0).all()):
        fact = f"it is {len(rows)} x {widths.pop()} for {lights} photographs, the least number is {float(values.min()):g}"
        step = "One positive number, or red, green and blue, for each light."
        raise DataError(message(where, "the table", "hold the intensity of each light", fact, step))
    return values


def read_light_table(
    path: str | Path, known: Callable[[str], bool] = is_image, images: int | None = None
) -> LightTable:
    """Read a table of lights; see `parse_lights`. Raises DataError, which names the file and the line."""
    return parse_lights(str(path), read_text(path, "the lights"), known, images)


def read_lights(path: str | Path, images: int) -> Tensor:
    """Return unit directions [n, 3], float32, of the lights of so many `images`, from a table in any form.

    Raises DataError, which names the file, when it cannot be read, holds another number of lights, or one of length 0.
    """
    table = read_light_table(path, images=images)
    largest = table.light.abs().amax(dim=1, keepdim=True)
    if len(table.light) != images or not bool((largest > 0).all()):
        fact = f"there are {len(table.light)} for {images} photographs, {int((largest == 0).sum())} of length 0"
        raise DataError(message(str(path), "the table", "hold x y z for each photograph", fact, _WAYS))
    scaled = table.light / largest  # or squares of positions far away would leave the range of numbers
    return (scaled / scaled.norm(dim=1, keepdim=True)).float()


def lp_text(files: Sequence[str], light: Tensor) -> str:
    """Return the text of an ``.lp`` file: the number of photographs, then the name and the light [n, 3] of each."""
    lines = [f"{name} {x:.7f} {y:.7f} {z:.7f}" for name, (x, y, z) in zip(files, light.double().tolist(), strict=True)]
    return "\n".join([str(len(lines)), *lines, ""])
