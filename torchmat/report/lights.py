"""Which photograph has which light, and how well those lights explain the photographs: as text, `.lp` file, and picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from torchmat import atomic, colour
from torchmat.btf import Btf
from torchmat.btf.ball import ball_lights
from torchmat.btf.lambert import Lambert
from torchmat.btf.light_table import lp_text
from torchmat.btf.lit import paired_lights
from torchmat.btf.photographs import read_linear
from torchmat.errors import DataError, RangeError, message
from torchmat.report.pictures import plotting, save_figure

_SHOWN = 3  # pairs at either end
_BALLS = 48  # on a picture, evenly chosen


def lights_text(btf: Btf, whole: bool = False) -> list[str]:
    """Return lines on what was noted of a capture, and of one view which photograph has which light.

    The first and the last alone, with the count, unless `whole`.
    """
    lines = [_noted(note) for note in btf.source.notes]
    pairs = [f"{file}  {x:.4f} {y:.4f} {z:.4f}" for file, (x, y, z) in paired_lights(btf).items()]
    if not whole and len(pairs) > 2 * _SHOWN + 1:
        pairs = [*pairs[:_SHOWN], f"... {len(pairs)} photographs in all, --verbose lists them ...", *pairs[-_SHOWN:]]
    return lines + [f"light of   {pair}" for pair in pairs]


def _noted(note: str) -> str:
    warning = "warning: "
    return f"warning    {note.removeprefix(warning)}" if note.startswith(warning) else f"note       {note}"


def lambert_text(figures: Lambert | None) -> list[str]:
    """Return lines with the Lambert residual of a capture and what it warns of; none where it says nothing."""
    if figures is None:
        return []
    return [f"Lambert    residual {figures.sentence()}", *(f"warning    {text}" for text in figures.warnings())]


def write_lights(btf: Btf, path: str | Path) -> Path:
    """Write the lights of photographs of one view as an ``.lp`` file, which is never one that is there already; return it.

    Raises RangeError for several views, DataError where a file is there or none can be written.
    """
    path, pairs = Path(path), paired_lights(btf)
    if not pairs:
        fact = f"there are {len(btf.views)} views"
        raise RangeError(message(str(path), "lights that are written", "be those of one view", fact, "Write a manifest.csv."))
    if path.exists():
        raise DataError(message(str(path), "the file", "be a new one", "it is there already", "Give another name."))
    try:
        with atomic.building_file(str(path)) as built:
            light = btf.light if btf.light_position is None else btf.light_position  # to be read with --near 1
            Path(built).write_text(lp_text(list(pairs), light), encoding="utf-8")
    except OSError as error:
        raise DataError(message(str(path), "the file", "be writable", str(error), "Check its folder.")) from error
    return path


def ball_picture(ball: str | Path, circle: Sequence[float], path: str | Path) -> Path:
    """Draw the photographs of a chrome ball, with its circle and the highlight that each light was taken from."""
    column, row, radius = circle
    found = ball_lights(ball, (column, row), radius)
    count = min(_BALLS, len(found.files))
    chosen = [round(k * (len(found.files) - 1) / max(count - 1, 1)) for k in range(count)]
    across = math.ceil(math.sqrt(count))
    pyplot = plotting()
    figure, axes = pyplot.subplots(math.ceil(count / across), across, figsize=(2 * across, 2.2 * math.ceil(count / across)), squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, number in zip(axes.flat, chosen, strict=False):
        image = colour.display(read_linear(Path(ball) / found.files[number])).permute(1, 2, 0).numpy()
        axis.imshow(image, interpolation="nearest")
        axis.add_patch(pyplot.Circle((column, row), radius, fill=False, color="tab:cyan", linewidth=0.8))
        axis.plot(*found.highlight[number].tolist(), "+", color="tab:green" if bool(found.good[number]) else "tab:red", markersize=9)
        axis.set_xlim(column - 1.15 * radius, column + 1.15 * radius)
        axis.set_ylim(row + 1.15 * radius, row - 1.15 * radius)
        axis.set_title(Path(found.files[number]).name[-24:], fontsize=7)
    return save_figure(figure, Path(path))
