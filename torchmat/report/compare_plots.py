"""The plots of a comparison: error against bytes, against fit seconds, against shading throughput."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torchmat.report.compare_rows import front, judged
from torchmat.report.pictures import plotting, save_figure
from torchmat.report.place_labels import label_points

_LEAST = 1e-9  # errors below are drawn there
_LEAST_COST = 1e-6
PLOTS = {
    "error_against_bytes": ("total_bytes_per_texel", "bytes per texel, shared tables included"),
    "error_against_seconds": ("fit_seconds", "fit seconds"),
    "error_against_shading": ("shade_mtexels_per_s", "million texels shaded a second"),
}
_LEGIBLE = 0.03  # a change of the error by export that can be seen at all


def write_plots(rows: list[dict[str, Any]], folder: Path) -> list[Path]:
    """Write the three plots of rows of which one at least has an error; return their paths."""
    colours = _colours(rows)
    return [_plot(rows, column, label, colours, folder / f"{name}.png") for name, (column, label) in PLOTS.items()]


def _family(row: dict[str, Any]) -> str:
    return row["model"].partition(":")[0]


def _colours(rows: list[dict[str, Any]]) -> dict[str, Any]:
    shades = plotting().get_cmap("tab20").colors
    # The strong half of the colours first.
    order = [*shades[::2], *shades[1::2]]
    families = list(dict.fromkeys(map(_family, rows)))
    return {family: order[number % len(order)] for number, family in enumerate(families)}


def _drawn(row: dict[str, Any], column: str) -> tuple[float, float]:
    # A perfect fit stands at the foot of the logarithmic axis; black data has no relative error.
    return max(row[column], _LEAST_COST), max(judged(row) or 0.0, _LEAST)


def _plot(rows: list[dict[str, Any]], column: str, label: str, colours: dict[str, Any], path: Path) -> Path:
    figure, axis = plotting().subplots(figsize=(9, 6), layout="constrained")
    known = [n for n, row in enumerate(rows) if judged(row) is not None and row[column] is not None]
    best = front(rows, column)
    points = [_drawn(rows[n], column) for n in known]
    for number, (cost, error) in zip(known, points, strict=True):
        row, colour = rows[number], colours[_family(rows[number])]
        before = error if row["relative_error"] is None else max(row["relative_error"], _LEAST)
        if abs(before / error - 1) > _LEGIBLE:
            axis.plot([cost, cost], [before, error], color=colour, linewidth=0.8)
            axis.plot(cost, before, "o", color=colour, markersize=6, fillstyle="none")
        if column == "fit_seconds" and len(row.get("curve") or []) > 1:
            seconds, errors = zip(*row["curve"], strict=True)
            axis.plot(seconds, [max(e, _LEAST) for e in errors], color=colour, linewidth=1, alpha=0.8)
        axis.plot(cost, error, "o", color=colour, markersize=7 if number in best else 5)
    line = sorted(_drawn(rows[n], column) for n in best)
    # Between two costs the cheaper row is the best there is; of a throughput that is the faster.
    way = "pre" if column == "shade_mtexels_per_s" else "post"
    axis.step(*zip(*line, strict=True), where=way, color="0.4", linestyle="--", linewidth=1, zorder=0)
    _scale(axis, rows, known, column)
    axis.set_xlabel(label)
    axis.set_ylabel("relative error on held-out samples")
    notes = "bold and dashed: on the Pareto front; filled: after export; ring: before, where it can be told apart"
    if column == "fit_seconds":
        notes += "\nlines: an iterative fit as it went on, on 64 held-out samples"
    axis.set_title(notes, fontsize=8)
    axis.grid(alpha=0.25, which="major")
    texts = [rows[n]["model"].replace("residual=", "").replace("components=", "").replace("terms=", "") for n in known]
    label_points(axis, points, texts, ["0.15"] * len(known), [n in best for n in known])
    return save_figure(figure, path)


def _scale(axis: Any, rows: list[dict[str, Any]], known: list[int], column: str) -> None:
    """Set logarithmic axes around all points, with room for labels beside the outermost."""
    from matplotlib.ticker import LogLocator

    axis.set_xscale("log")
    axis.set_yscale("log")
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(LogLocator(subs=(1, 2, 5)))
        side.set_major_formatter("{x:g}")
        side.set_minor_formatter("")
    points = [_drawn(rows[n], column) for n in known]
    for limits, share, which in ((axis.set_xlim, 0.12, 0), (axis.set_ylim, 0.08, 1)):
        low, high = (ends(point[which] for point in points) for ends in (min, max))
        room = max(high / low, 10.0) ** share
        limits(low / room, high * room)
