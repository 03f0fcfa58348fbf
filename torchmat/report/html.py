"""One self-contained page: tables and pictures of a fit, nothing fetched from anywhere."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchmat.report.decisions_page import decision_rows, map_rows, outcome_text, shrinking_rows, wanted_text
from torchmat.report.tables import error_rows, measured_rows, number, object_text, scene_rows

_STYLE = """
body{font-family:system-ui,sans-serif;margin:2em auto;max-width:62em;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}td,th{padding:.3em .8em;border-bottom:1px solid #ddd;text-align:right}
td:first-child,th:first-child{text-align:left}img{max-width:100%}figure{margin:2em 0}figcaption{color:#555}
.wide{overflow-x:auto;font-size:80%}dt{font-weight:bold}dd{margin:0 0 .4em 1em}
"""
_CAPTIONS = {
    "decisions": "What was tried: error against bytes, on samples kept back.",
    "comparison": "Target, fit and difference at the held-out samples of median and largest error, and the most grazing.",
    "error_by_angle": "Error against the polar angle of light and view.",
    "sphere": "The material on a sphere.",
    "coverage": "Which share of its unknowns each texel's samples determine.",
    "object_mask": "What counts as the object, outlined; the rest is red and counts nowhere.",
    "directions": "Lights and views on the projected hemisphere.",
    "error_against_bytes": "Held-out error against bytes per texel.",
    "error_against_seconds": "Held-out error against fit seconds.",
    "error_against_shading": "Held-out error against shading throughput: what lies to the right is faster.",
}


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    def line(cells: Sequence[Any], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(number(cell))}</{tag}>" for cell in cells) + "</tr>"

    return f"<table>{line(header, 'th')}{''.join(line(row, 'td') for row in rows)}</table>"


def _figure(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    caption = html.escape(_CAPTIONS.get(path.stem, path.stem.replace("_", " ")))
    return f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'


def _page(title: str, body: list[str]) -> str:
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>'
    return f"{head}<style>{_STYLE}</style><h1>{html.escape(title)}</h1>{''.join(body)}</html>"


def _bands(report: dict[str, Any]) -> str:
    part = report["held_out"] or report["train"]
    rows = [
        [f"{row['angle']} {row['from_deg']}-{row['to_deg']}°", row["samples"], row["relative_error"], row["psnr_db"]]
        for row in part.get("by_angle", [])  # none where nothing was measured
    ]
    return _table(["polar angle", "samples", "relative error", "PSNR (dB)"], rows)


def fit_page(report: dict[str, Any], pictures: Sequence[Path]) -> str:
    """Return the page of one fit."""
    source = report["source"]
    facts = [
        ["source", f"{source['kind']}, {source['lights']} lights x {source['views']} views"],
        ["size", f"{source['height']} x {source['width']} texels, {report['samples']} images"],
        ["clipped / invalid share", f"{number(source['clipped_share'])} / {number(source['invalid_share'])}"],
        *([["object", object_text(source["object"]["mask"], source["object"]["share"])]] if "object" in source else []),
        ["options", ", ".join(f"{k}={v}" for k, v in report["options"].items())],
        ["held out", f"{number(report['holdout'])} of the samples, by {report['holdout_by']}, seed {report['seed']}"],
        ["bytes per texel", f"{number(report['bytes_per_texel'])}, and {report['shared_bytes']} shared by all texels"],
        ["load / fit", f"{number(report['load_seconds'])} s / {number(report['fit_seconds'])} s"],
        ["shading", f"{number(report['shade_mtexels_per_s'])} million texels a second"],
        ["stopped because", report["stop_reason"]],
    ]
    if report.get("lambert_residual"):
        figures = report["lambert_residual"]
        facts += [["Lambert residual", figures["meaning"]], *(["warning", text] for text in figures["warnings"])]
    facts += measured_rows(report)
    facts += [["note", note] for note in source.get("notes", ())]
    body = [
        _table(*error_rows(report)),
        _table(["", ""], facts), *map(_figure, pictures), "<h2>By polar angle</h2>", _bands(report),
    ]
    if "scene" in report:
        body.insert(1, "<h2>The scene</h2>" + _table(["", ""], scene_rows(report)))
    choice = report["figures"].get("auto")
    if choice:
        heading = [f"<h2>{html.escape(outcome_text(choice))}</h2>", f"<p>Wanted: {html.escape(wanted_text(choice))}.</p>"]
        body = [*heading, *body, "<h2>What was tried</h2>", _table(*decision_rows(choice))]
        body += ["<h2>How the textures are stored</h2>", _table(*map_rows(choice)), _table(*shrinking_rows(choice))]
    return _page(f"{report['model']} fitted to {Path(source['path']).name}", body)


def comparison_page(
    title: str, header: Sequence[str], rows: Sequence[Sequence[Any]], pictures: Sequence[Path],
    meanings: Mapping[str, str] | None = None,
) -> str:
    """Return the page of a comparison of models; `meanings` explains its columns."""
    pairs = (meanings or {}).items()
    words = "".join(f"<dt>{html.escape(name)}</dt><dd>{html.escape(text)}</dd>" for name, text in pairs)
    explained = [f"<h2>What the columns mean</h2><dl>{words}</dl>"] if words else []
    table = f'<div class="wide">{_table([name.replace("_", " ") for name in header], rows)}</div>'
    return _page(title, [table, *map(_figure, pictures), *explained])
