"""Print the results as the tables of the README beside it: ``python scripts/bench/tables.py``."""

from __future__ import annotations

import json
from itertools import groupby

import protocol
from measure import RESULTS

from torchmat.report.tables import comparison_table, number, text_table


def _rows(name: str) -> list[dict]:
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8"))["rows"] if path.is_file() else []


def _timing(value: dict) -> str:
    return f"{number(value['seconds'])} ± {number(value['spread'] / 2)}"


def _cell(value: object) -> object:
    """Return a timing, another table of figures, a list, or a plain value for reading."""
    if isinstance(value, dict) and "spread" in value:
        return _timing(value)
    if isinstance(value, dict):
        return ", ".join(f"{key}={number(_cell(one))}" for key, one in value.items())
    return ", ".join(str(number(_cell(one))) for one in value) if isinstance(value, list) else value


def accuracy() -> None:
    """Print one table a data set: error beside bytes and seconds."""
    rows = _rows("accuracy")
    for data in dict.fromkeys(row["data"] for row in rows):
        mine = [row for row in rows if row["data"] == data]
        cells = [
            [row["model"], row["bytes_per_texel"], row["shared_bytes"], _timing(row["fit"]), row["train_relative_error"],
             row["held_out_relative_error"], f"{row['held_out_psnr_db']:.1f}", row["held_out_after_export_relative_error"]]
            for row in mine
        ]
        head = ("model", "bytes/texel", "+ shared", "fit (s)", "seen", "unseen", "unseen (dB)", "after export")
        print(f"\n### {data} ({mine[0]['samples']} images of {mine[0]['texels']} texels, {mine[0]['seeds']} splits)\n")
        print(text_table(head, cells))


def comparisons() -> None:
    """Print one table a data set: what a network buys beside all else."""
    rows = _rows("compare")
    for data in dict.fromkeys(row["data"] for row in rows):
        print(f"\n### {data}: speed against error\n")
        print(comparison_table([row for row in rows if row["data"] == data]))


def protocols() -> None:
    """Print the protocol of accuracy: what no fit saw, by pair, light, view, both, and off the grid."""
    rows = _rows(protocol.NAME)
    if rows:
        print(f"\n### {protocol.NAME}\n")
        print(text_table(protocol.HEAD, protocol.summary(rows)))


def others() -> None:
    """Print every other suite as it is."""
    for name in ("pipeline", "loading", "shading", "large", "start_up", "geometry", "relief", "distribution", "shading_maps",
                 "sphere_images", "sphere_sizes", "sphere_shading", "objects", "solvers", "compiled", "auto", "scale", "scene", "busy"):
        # Rows of one suite that measure different things stand in tables of their own.
        for _, alike in groupby(_rows(name), key=tuple):
            rows = list(alike)
            head = [key for key in rows[0] if key != "runs"]
            cells = [[_cell(row[key]) for key in head] for row in rows]
            print(f"\n### {name}\n")
            print(text_table(head, cells))


if __name__ == "__main__":
    accuracy()
    comparisons()
    protocols()
    others()
