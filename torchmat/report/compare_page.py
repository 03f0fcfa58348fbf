"""Pages of many rows: models side by side with the picture that each makes, and the summary of many jobs; both can be sorted."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from torchmat.report.compare_rows import PICTURE_SIDE, judged
from torchmat.report.inline import shown_size
from torchmat.report.page import Markup, Picture, code, page, paragraph, plot, section, text
from torchmat.report.tables import interval_text, number
from torchmat.report.words import COMPARED, SOLVERS, figure_of, spaced, stopped

_PLOTS = {
    "error_against_bytes": "Error against bytes a texel: lower and further left is better.",
    "error_against_seconds": "Error against seconds of the fit: lower and further left is better.",
    "error_against_shading": "Error against shading: lower and further right is better.",
}
_NUMBERS = (
    "total_bytes_per_texel", "fit_seconds", "fit_memory_mb", "shade_mtexels_per_s", "train_relative_error", "relative_error", "psnr_db",
    "relative_error_after_export", "psnr_db_after_export",
)
# Best first on the first click, then the other way round; what has no value stays last. The table is whole without it.
SORTING = """
document.querySelectorAll("table.sortable").forEach(t=>t.querySelectorAll("th button").forEach(b=>b.addEventListener("click",()=>{
const h=b.parentElement,i=h.cellIndex,was=h.getAttribute("aria-sort"),up=was?was!=="ascending":h.dataset.first!=="descending";
for(const o of t.tHead.rows[0].cells)o.removeAttribute("aria-sort");
h.setAttribute("aria-sort",up?"ascending":"descending");
const v=r=>r.cells[i].dataset.value;
[...t.tBodies[0].rows].sort((p,q)=>{const a=v(p),c=v(q);if(a===""||c==="")return(a==="")-(c==="");
const d=a-c;return(up?1:-1)*(isNaN(d)?a.localeCompare(c):d)}).forEach(r=>t.tBodies[0].append(r));
})));
"""
_STYLE = """<style>table.sortable{font-size:.82em}table.sortable th{line-height:1.25}
th button{font:inherit;color:inherit;background:none;border:0;padding:0;text-align:inherit;cursor:pointer}
th[aria-sort] button::after{content:" \\25B2";font-size:.8em}th[aria-sort=descending] button::after{content:" \\25BC"}
th .unit{display:block;font-weight:400}tr.front td:first-child{border-left:4px solid var(--mark)}tr.front .mark{color:var(--mark);font-weight:600}
table.sortable img{margin:0 2px;max-width:none}.pair{white-space:nowrap}table.sortable .text{min-width:12em;max-width:17em;overflow-wrap:anywhere}
table.sortable .text:last-child{min-width:6em}
table.sortable td,table.sortable th{padding:.4em .5em}</style>"""


class Cell(NamedTuple):
    """What a cell shows, and what it is sorted by: a number, a text, or nothing, which stays last."""

    shown: Any
    value: Any = None

    def tag(self, words: bool) -> str:
        value = "" if self.value is None or (isinstance(self.value, float) and not math.isfinite(self.value)) else str(self.value)
        name = ' class="text"' if words else ""
        return f'<td{name} data-value="{html.escape(value)}">{text(self.shown)}</td>'


def comparison_page(title: str, rows: Sequence[Mapping[str, Any]], pictures: Sequence[Path]) -> str:
    """Return the page of a comparison: rows as `compare` gives them, and PNG files of its plots."""
    pictured = any(row.get("picture") for row in rows)
    header = ([Markup("<th scope=\"col\">target and fit</th>")] if pictured else []) + [_head("model", True)]
    header += [_head(name) for name in _NUMBERS] + [_head("front", True)]
    body = "".join(_row(row, pictured) for row in rows)
    shown = next((row["picture"] for row in rows if row.get("picture")), None)
    where = f" The pictures are of one photograph: {shown['directions']} (polar angle/azimuth)." if shown else ""
    columns = Markup("".join(
        f"<dt>{text(figure.name)}{f' <span class=unit>{figure.better}</span>' if figure.better else ''}</dt>"
        f"<dd>{text(figure.meaning)} {code(name)}</dd>" for name, figure in COMPARED.items()
    ))
    parts = [
        Markup(_STYLE), paragraph(_sentence(rows), "verdict"), _sortable(header, body),
        paragraph(f"Click a heading to sort. Marked rows are best in something: no other is both truer and cheaper there.{where}", "soft"),
        section("As pictures", *(plot(path, _PLOTS.get(path.stem, spaced(path.stem))) for path in pictures)),
        section("What the columns mean", paragraph("And what they are called in the CSV and JSON beside this page.", "soft"),
                Markup(f"<dl>{columns}</dl>")),
    ]
    return page(title, parts, wide=True, script=SORTING)


def table_page(title: str, columns: Mapping[str, str], rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a page of one table that can be sorted; `columns` maps the keys of `rows` to what they mean."""
    words = ("data", "model", "out", "status", "stop_reason", "failed")
    header = [_head(name, name in words) for name in columns]
    body = "".join(
        "<tr>" + "".join(Cell(_said(name, row[name]), row[name]).tag(name in words) for name in columns) + "</tr>" for row in rows
    )
    meant = Markup("".join(f"<dt>{text(figure_of(name).name)}</dt><dd>{text(said)} {code(name)}</dd>" for name, said in columns.items()))
    parts = [Markup(_STYLE), _sortable(header, body), section("What the columns mean", Markup(f"<dl>{meant}</dl>"))]
    return page(title, parts, wide=True, script=SORTING)


def _said(name: str, value: Any) -> Any:
    return code(value) if name in ("model", "data", "out") and value else value


def _head(name: str, words: bool = False) -> Markup:
    figure = figure_of(name)
    first = ' data-first="descending"' if figure.better.startswith("higher") else ""
    unit = f'<span class="unit">{figure.better}</span>' if figure.better else ""
    kind = ' class="text"' if words else ""
    return Markup(f'<th scope="col"{kind}{first} title="{html.escape(figure.meaning)}"><button type="button">{text(figure.name)}</button>{unit}</th>')


def _sortable(header: Sequence[Markup], body: str) -> Markup:
    return Markup(f'<div class="scroll"><table class="sortable"><thead><tr>{"".join(header)}</tr></thead><tbody>{body}</tbody></table></div>')


def _row(row: Mapping[str, Any], pictured: bool) -> str:
    front = row.get("front")
    cells = [_pair(row)] if pictured else []
    cells.append(Cell(_model(row), row["model"]).tag(True))
    for name in _NUMBERS:
        beside = _beside(row, name)
        shown = number(row[name]) if beside is None else Markup(f'{number(row[name])} <span class="unit">{beside}</span>')
        cells.append(Cell(shown, row[name]).tag(False))
    cells.append(Cell(Markup(f'<span class="mark">{text(front)}</span>') if front else "", front or None).tag(True))
    return f"<tr{' class=front' if front else ''}>{''.join(cells)}</tr>"


def _beside(row: Mapping[str, Any], name: str) -> str | None:
    """Return what stands in small beside a number: the spread of seconds, the interval of the error."""
    if name == "fit_seconds" and row.get("fit_seconds_spread") is not None:
        return f"± {number(row['fit_seconds_spread'] / 2)}"
    if name == "relative_error" and row.get("relative_error_low") is not None:
        return interval_text((row["relative_error_low"], row["relative_error_high"]))
    return None


def _model(row: Mapping[str, Any]) -> Markup:
    solver, geometry = row.get("solver"), row.get("geometry")
    notes = [text_of for text_of in (solver and SOLVERS.get(solver, spaced(solver)), geometry and spaced(geometry)) if text_of]
    if row.get("stop_reason") not in (None, "converged"):
        notes.append(stopped(row["stop_reason"]))
    if row.get("same_bits") is False:
        notes.append("repeats differ")
    if row.get("failed"):
        notes.append(f"failed: {row['failed']}")
    return Markup(f'{code(row["model"])}<br><span class="unit">{text("; ".join(notes))}</span>')


def _pair(row: Mapping[str, Any]) -> str:
    picture = row.get("picture")
    if not picture:
        return "<td></td>"
    size = shown_size(picture["size"][0], picture["size"][1], PICTURE_SIDE)
    tags = (Picture(picture[which], size, True).tag(f"{which}, {row['model']}") for which in ("target", "fit"))
    return f'<td class="pair">{"".join(tags)}</td>'


def _sentence(rows: Sequence[Mapping[str, Any]]) -> Markup:
    """Return which row is truest, and what the smallest and the quickest to fit cost in truth."""
    known = [(error, row) for row in rows if (error := judged(dict(row))) is not None and math.isfinite(error)]
    if not known:
        return Markup("No row has an error that it could be judged by.")
    truest = min(known, key=lambda item: item[0])
    smallest, quickest = (
        min((item for item in known if item[1][cost] is not None), key=lambda item: (item[1][cost], item[0]), default=truest)
        for cost in ("total_bytes_per_texel", "fit_seconds")
    )
    texts = []
    for said, (error, row), unit in (
        ("Truest", truest, ""), ("smallest", smallest, f" at {number(smallest[1]['total_bytes_per_texel'])} bytes a texel"),
        ("quickest to fit", quickest, f" in {number(quickest[1]['fit_seconds'])} s"),
    ):
        texts.append(f"{said}: {code(row['model'])}{unit} (relative error {number(error)})")
    return Markup("; ".join(texts) + ".")
