"""What every page is made of: one file, light or dark as the reader has it, legible on a telephone, nothing fetched."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from torchmat.report.inline import file_uri
from torchmat.report.tables import number

_STYLE = """
:root{color-scheme:light dark;--ink:#24292f;--soft:#5b6470;--line:#d8dde3;--paper:#fff;--tint:#f4f6f8;--mark:#0a6b4f;--warn:#8a4b00}
@media(prefers-color-scheme:dark){:root{
--ink:#dde2e7;--soft:#9aa4af;--line:#39424c;--paper:#14181c;--tint:#1e242a;--mark:#6fd3ae;--warn:#f0b35a}}
*{box-sizing:border-box}
body{font:16px/1.5 system-ui,sans-serif;margin:0 auto;max-width:66em;padding:1.5em 1em 4em;color:var(--ink);background:var(--paper)}
body.wide{max-width:1264px}
h1{font-size:1.6em;line-height:1.25;margin:.2em 0 .6em}h2{font-size:1.2em;margin:2.2em 0 .5em;border-top:1px solid var(--line);padding-top:.9em}
h1,p,li,td,dd,figcaption{overflow-wrap:anywhere}
code{font-size:.9em;background:var(--tint);border-radius:3px;padding:.05em .3em;overflow-wrap:anywhere}
p{max-width:46em}
.verdict{font-size:1.2em;line-height:1.4;background:var(--tint);border-left:4px solid var(--mark);padding:.7em 1em;max-width:none}
.verdict.coarse,.verdict.poor,.verdict.unusable,.verdict.unknown{border-color:var(--warn)}.cautions{color:var(--warn);padding-left:1.3em}
.soft,figcaption,.unit{color:var(--soft);font-size:.88em}
.scroll{overflow-x:auto}table{border-collapse:collapse;margin:.6em 0}
td,th{padding:.35em .7em;border-bottom:1px solid var(--line);text-align:right;vertical-align:top}
th{font-weight:600;vertical-align:bottom}td:first-child,th:first-child,td.text,th.text{text-align:left}td:first-child{font-weight:500}
.row>p{max-width:none}table.facts td{text-align:left}table.facts td:first-child{white-space:nowrap;overflow-wrap:normal;color:var(--soft)}
figure{margin:1em 0}img{max-width:100%;height:auto;vertical-align:top;background:#fff}img.texels{image-rendering:pixelated;background:none}
.plots{display:flex;flex-wrap:wrap;gap:1em 1.5em;align-items:flex-start}.plots figure{margin:0;max-width:100%}.plots figcaption{max-width:40em}
.row{margin:1.2em 0}.row>p{margin:0 0 .4em}.three{display:flex;flex-wrap:wrap;gap:.8em}.three figure{margin:0}
.bar{display:flex;flex-wrap:wrap;align-items:center;gap:.3em .6em;margin:1em 0}.bar img{width:200px;height:14px}
.cards{display:grid;grid-template-columns:repeat(auto-fill,minmax(190px,1fr));gap:1.2em;padding:0;list-style:none}
.cards li{display:block;min-width:0}.cards b{display:block;font-weight:600}.cards img{display:block;margin:.3em 0}a{color:inherit}
dt{font-weight:600}dd{margin:0 0 .5em 1em}details{margin:1em 0}summary{cursor:pointer}
@media(max-width:700px){body{font-size:15px}td,th{padding:.3em .45em}table.facts td{display:block;border:0;padding:.1em 0}
table.facts td:first-child{padding-top:.5em;white-space:normal}}
"""


class Markup(str):
    """Text that is HTML already; all other text is escaped where it is put into a page."""


def text(value: Any) -> str:
    """Return a value as HTML: markup as it is, numbers for reading, everything else escaped."""
    return value if isinstance(value, Markup) else html.escape(number(value))


def code(value: Any) -> Markup:
    """Return what a person types or a program reads: keys, commands, digests."""
    return Markup(f"<code>{html.escape(str(value))}</code>")


def paragraph(value: Any, name: str = "") -> Markup:
    """Return a paragraph, of a class if there is a `name`."""
    return Markup(f"<p{_class(name)}>{text(value)}</p>")


def section(title: str, *parts: str) -> Markup:
    """Return a heading and what stands below it; nothing where nothing does."""
    body = "".join(parts)
    return Markup(f"<h2>{text(title)}</h2>{body}" if body else "")


def listed(items: Iterable[Any], name: str = "") -> Markup:
    """Return a list; nothing without items."""
    rows = "".join(f"<li>{text(item)}</li>" for item in items)
    return Markup(f"<ul{_class(name)}>{rows}</ul>" if rows else "")


def table(header: Sequence[Any], rows: Iterable[Sequence[Any]], name: str = "", words: Iterable[int] = ()) -> Markup:
    """Return a table that scrolls in its own box; columns `words` are text, which starts at the left. No header, no row of it."""
    left = set(words)

    def line(cells: Sequence[Any], tag: str) -> str:
        what = ' scope="col"' if tag == "th" else ""
        return "<tr>" + "".join(
            f"<{tag}{what}{_class('text' if place in left else '')}>{text(cell)}</{tag}>" for place, cell in enumerate(cells)
        ) + "</tr>"

    head = f"<thead>{line(header, 'th')}</thead>" if header else ""
    return Markup(f'<div class="scroll"><table{_class(name)}>{head}<tbody>{"".join(line(row, "td") for row in rows)}</tbody></table></div>')


class Picture(NamedTuple):
    """A picture as data URI, in which height and width it is shown, and whether its pixels are texels, to be seen as such."""

    uri: str
    size: tuple[int, int] | None = None
    texels: bool = False

    def tag(self, said: str) -> Markup:
        """Return the image; `said` is what those hear who do not see it."""
        size = f' width="{self.size[1]}" height="{self.size[0]}"' if self.size else ""
        return Markup(f'<img alt="{html.escape(said)}"{size}{_class("texels" if self.texels else "")} src="{self.uri}">')


def figure(picture: Picture, caption: Any, said: str = "") -> Markup:
    """Return a picture with its caption; `said` where a reader that sees nothing needs other words."""
    return Markup(f"<figure>{picture.tag(said or str(caption))}<figcaption>{text(caption)}</figcaption></figure>")


def plot(path: Path, caption: str) -> Markup:
    """Return a PNG file of a plot with its caption."""
    return figure(Picture(file_uri(path)), caption)


def details(summary: str, *parts: str) -> Markup:
    """Return what is folded away until it is asked for."""
    return Markup(f"<details><summary>{text(summary)}</summary>{''.join(parts)}</details>")


def page(title: str, parts: Iterable[str], heading: Any = None, wide: bool = False, script: str = "") -> str:
    """Return a whole page; `heading` is its title where that has markup."""
    head = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head>"
    )
    begin = f"{head}<body{_class('wide' if wide else '')}><main><h1>{text(title if heading is None else heading)}</h1>"
    ending = f"</main><script>{script}</script></body></html>" if script else "</main></body></html>"
    return "".join((begin, *parts, ending))  # in one go: parts hold whole materials, of which each copy takes tens of megabytes


def _class(name: str) -> str:
    return f' class="{name}"' if name else ""
