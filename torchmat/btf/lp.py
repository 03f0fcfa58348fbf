"""RTI captures: an ``.lp`` file lists photographs with the directions of their lights."""

from __future__ import annotations

import math
import re

import torch

from torchmat.btf.listing import FileNames, Listing, read_text, the_one
from torchmat.btf.pixels import images_of_files
from torchmat.btf.reader import Reader
from torchmat.btf.source import Folder, Zip
from torchmat.errors import DataError, message


def _number(token: str) -> float:
    try:
        return float(token)
    except ValueError:
        return math.nan


def _readings(line: str) -> list[tuple[str, list[float]]]:
    """Return every way to read a line as (text that names the file, x y z), the usual one first."""
    tokens = list(re.finditer(r"[^\s,;]+", line))
    numbers = [_number(token[0]) for token in tokens]
    count = len(tokens)
    # A leading running number is not part of the name, unless a file is really called so.
    numbered = count > 4 and re.fullmatch(r"\d+", tokens[0][0])
    spans = [(0, count - 3, count - 3)] + [(1, count - 3, count - 3)] * bool(numbered)
    spans += [(3, count, 0)] + [(4, count, 1)] * bool(numbered)
    ways = []
    for start, end, first in spans:
        triple = numbers[first : first + 3]
        if start < end and all(map(math.isfinite, triple)):
            ways.append((line[tokens[start].start() : tokens[end - 1].end()].strip("\"'"), triple))
    return ways


def _read_line(where: str, line: str, known: FileNames) -> tuple[str, list[float]]:
    ways = _readings(line)
    if not ways:
        step = "Write `name x y z` or `x y z name`."
        raise DataError(message(where, "the line", "hold a name and x y z", f"it is {line!r}", step))
    text, light = next((way for way in ways if known.lookup(way[0])), ways[0])
    return known.find(where, text), light


def _is_lp(name: str) -> bool:
    return name.lower().endswith(".lp")


def read_lp(source: Folder | Zip) -> Listing:
    """Parse an RTI ``.lp`` file: ``name x y z`` or ``x y z name`` a line, with or without a leading count line.

    The camera looks along the normal. A running number before either is allowed, and lines that start with ``#``.
    """
    name = the_one(source, _is_lp, "an .lp file")
    where = f"{source.path}: {name}"
    lines = [line.strip() for line in read_text(source, name).splitlines()]
    numbered = [(number, line) for number, line in enumerate(lines, 1) if line and not line.startswith("#")]
    announced = None
    if numbered and re.fullmatch(r"[0-9]{1,9}", numbered[0][1]):
        announced = int(numbered.pop(0)[1])
    known = FileNames(source, name)
    found = [_read_line(f"{where}: line {number}", line, known) for number, line in numbered]
    if announced is not None and announced != len(found):
        fact = f"it says {announced} and {len(found)} follow"
        raise DataError(message(where, "the count line", "match the lines below it", fact, "Complete the file."))
    if not found:
        step = "Write `name x y z` a line."
        raise DataError(message(where, "the file", "list at least one image", "it lists none", step))
    view = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).repeat(len(found), 1)
    light = torch.tensor([light for _, light in found], dtype=torch.float64)
    return Listing("rti", tuple(file for file, _ in found), light, view)


RTI = Reader(
    "rti", "RTI: an `.lp` file with a light for each photograph", lambda source: any(map(_is_lp, source.names)), read_lp,
    images_of_files, version=0,
)
