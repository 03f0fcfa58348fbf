"""The page of one fit: what it is worth, pictures, figures, maps, and how it was made. Nothing is fetched from anywhere."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from torchmat import colour
from torchmat.report.decisions_page import decided_text, decision_rows, map_rows, outcome_text, shrinking_rows, wanted_text
from torchmat.report.error_cards import certain_parts
from torchmat.report.inline import data_uri, shown_size
from torchmat.report.map_cards import MOST, MapCard
from torchmat.report.page import Markup, Picture, code, details, figure, listed, page, paragraph, plot, section, table, text
from torchmat.report.pictures import DIFFERENCE_COLOURS, LARGEST, colour_strip, thinned
from torchmat.report.samples import Shown, difference_range
from torchmat.report.tables import INTERVAL, interval_text, measured_rows, near_text, number, object_text, scene_rows, test_text
from torchmat.report.verdict import verdict
from torchmat.report.words import FIGURES, GEOMETRIES, PARTS, SPLITS, spaced, stopped

_CAPTIONS = {
    "decisions": "What was tried: error against bytes, on samples kept back.",
    "error_by_angle": "Error against the polar angle of light and view: 0° is straight above, 90° the horizon.",
    "sphere": "On a sphere under two lights. Towards its rim the view, and towards the shadow the light, is flatter than any that "
    "was measured: what a model makes of that is a guess. Polynomials, harmonics and principal images fade there before the light "
    "sets, so that no hard arc ends it.",
    "hemisphere": "The flat patch, each picture standing where one stands. What would be the same picture is left out.",
    "coverage": "Which share of its unknowns each texel's samples determine.",
    "object_mask": "What counts as the object, outlined; the rest is red and counts nowhere.",
    "directions": "Where lights and views were measured, seen from above.",
    "error_by_seconds": "The error of the solver, in its own terms, as the fit went on.",
    "relief": "The relief: shaded, its height in texture widths, its normals.",
    "oblique": "The flattest views: measured, on the relief, and without parallax and shadow.",
}
_ELSEWHERE = ("comparison", "maps")  # shown on the page by pictures of their own


def fit_page(
    report: Mapping[str, Any], pictures: Sequence[Path], rows: Sequence[Shown] = (), cards: Sequence[MapCard] = (),
    parameters: Sequence[Sequence[str]] = (), viewer: str = "", errors: Sequence[MapCard] = (),
) -> str:
    """Return the page of one fit.

    Args:
        report: what `report.json` holds.
        pictures: PNG files of plots, by whose names their captions go.
        rows: photographs beside their fit.
        cards: the textures that stand beside the page.
        parameters: name, value and unit of numbers that all texels share.
        viewer: markup that shows the material, moving (`viewer.viewer_of`); "" shows none.
        errors: standard errors of the maps (`error_cards`).
    """
    plots = {path.stem: plot(path, _CAPTIONS.get(path.stem, path.stem.replace("_", " "))) for path in pictures if path.stem not in _ELSEWHERE}
    found = verdict(report)
    name = Path(report["source"]["path"]).name
    choice = report["figures"].get("auto")
    body = [
        paragraph(found.sentence, f"verdict {found.grade}"), listed(found.cautions, "cautions"),
        viewer, section("What was wanted", *_wanted(choice, plots)) if choice else "",
        section("Target, fit and difference", *_compared(rows)),
        section("How true it is", _figures(report), _plots(plots, "error_by_angle", "error_by_seconds"), _bands(report)),
        section("On objects, and from other directions", _plots(plots, "sphere", "hemisphere", "relief", "oblique")),
        section("The maps", *_maps(cards, parameters)),
        section("How certain the maps are", *certain_parts(errors, report, _maps(errors, ()))),
        section("The scene", table((), scene_rows(dict(report)), "facts")) if "scene" in report else "",
        section("The data", table((), _data(report), "facts"), _plots(plots, "directions", "coverage", "object_mask")),
        *_decisions(choice), section("How it was made", table((), _made(report), "facts")), *plots.values(),
    ]
    return page(f"{report['model'].replace('_', ' ')} fitted to {name}", body, Markup(f"{code(report['model'])} fitted to {text(name)}"))


def _plots(plots: dict[str, Markup], *names: str) -> Markup:
    there = "".join(plots.pop(name) for name in names if name in plots)
    return Markup(f'<div class="plots">{there}</div>' if there else "")


def _compared(rows: Sequence[Shown]) -> list[Markup]:
    if not rows:
        return []
    most = difference_range(rows)
    strip = Picture(data_uri(colour_strip(), DIFFERENCE_COLOURS, -1.0, 1.0)).tag(f"colour bar from {-most:g} to {most:g}")
    bar = Markup(
        f'<div class="bar"><span>too dark by {most:g}</span>{strip}<span>too bright by {most:g}</span></div>'
        + paragraph("Differences are of the pictures as shown, where white is 1. Directions are polar angle / azimuth.", "soft")
    )
    return [*(_row(row, most) for row in rows), bar]


def _row(row: Shown, most: float) -> Markup:
    beyond = " Beyond the directions that the fit saw." if row.beyond else ""
    figures = f"{row.directions}. {row.figures[:1].upper()}{row.figures[1:]}; {row.brightness}.{beyond}"
    said = Markup(f"<b>{text(row.why.capitalize())}</b>: {text(figures)}")
    pictures = (
        ("Target", data_uri(colour.display(thinned(row.target)))), ("Fit", data_uri(colour.display(thinned(row.fit)))),
        ("Difference", data_uri(thinned(row.difference[None]), DIFFERENCE_COLOURS, -most, most)),
    )
    _, height, width = thinned(row.difference[None]).shape
    size = shown_size(height, width, LARGEST)
    three = "".join(figure(Picture(uri, size, True), name, f"{name} at {row.directions}") for name, uri in pictures)
    return Markup(f'<div class="row">{paragraph(said)}<div class="three">{three}</div></div>')


def _figures(report: Mapping[str, Any]) -> Markup:
    parts = [name for name in PARTS if report.get(name)]
    if not parts:
        return paragraph("Errors were not measured.")
    rows = [
        [Markup(f'{text(figure.name)}<br><span class="unit">{figure.better}</span>'), *(_cell(key, report[part].get(key)) for part in parts), figure.meaning]
        for key, figure in FIGURES.items()
    ]
    return table(["", *(PARTS[part] for part in parts), "what it says"], rows, words=(len(parts) + 1,))


def _cell(key: str, value: Any) -> Any:
    return interval_text(value) if key == INTERVAL else value


def _bands(report: Mapping[str, Any]) -> Markup:
    part = report.get("held_out") or report.get("train") or {}
    rows = [
        [f"{row['angle']}, {row['from_deg']}° to {row['to_deg']}°", row["samples"], row["relative_error"], row["psnr_db"]]
        for row in part.get("by_angle", ())
    ]
    header = ["polar angle", "photographs", "relative error (lower is better)", "PSNR, dB (higher is better)"]
    return details("The same by polar angle, as numbers", table(header, rows)) if rows else Markup("")


def _maps(cards: Sequence[MapCard], parameters: Sequence[Sequence[str]]) -> list[Markup]:
    shown = [
        Markup(f"<b>{text(card.name)}</b>{_linked(card)}<span class=\"soft\">{text(card.meaning)}<br>{text(card.extent)}</span>"
               f"<br>{', '.join(_link(name) for name in card.files)}")
        for card in cards
    ]
    rest = [paragraph(f"The first {MOST} textures; the folder holds them all.", "soft")] if len(cards) == MOST else []
    numbers = [table(["what all texels share", "value", "unit"], parameters, words=(2,))] if parameters else []
    return [*([listed(shown, "cards")] if cards else []), *rest, *numbers]


def _linked(card: MapCard) -> Markup:
    image = Picture(card.picture, shown_size(*card.size, 160), True).tag(f"{card.name}: {card.meaning}")
    return Markup(f'<a href="{quote(card.files[0])}">{image}</a>') if card.files else image


def _link(name: str) -> Markup:
    return Markup(f'<a href="{quote(name)}">{code(name)}</a>')


def _wanted(choice: Mapping[str, Any], plots: dict[str, Markup]) -> list[Markup]:
    said = paragraph(f"Wanted: {wanted_text(choice)}."), paragraph(spaced(outcome_text(choice))), paragraph(decided_text(choice))
    return [*said, _plots(plots, "decisions")]


def _decisions(choice: Mapping[str, Any] | None) -> list[Markup]:
    if not choice:
        return []
    header, tried = decision_rows(choice)
    (maps, stored), (columns, steps) = map_rows(choice), shrinking_rows(choice)
    tables = [table(maps, map(_in_words, stored), words=(1, 2)), *([table(columns, map(_in_words, steps), words=(1,))] if steps else [])]
    return [section("What was tried", table(header, [[code(row[0]), *_in_words(row[1:])] for row in tried], words=(10, 11))),
            section("How the textures are stored", *tables)]


def _in_words(cells: Sequence[Any]) -> list[Any]:
    return [spaced(cell) if isinstance(cell, str) else cell for cell in cells]


def _data(report: Mapping[str, Any]) -> list[list[Any]]:
    source, coverage = report["source"], report.get("coverage")
    rows = [
        ["photographs", f"{report['samples']}: {source['lights']} lights, {source['views']} views"],
        ["size", f"{source['height']} x {source['width']} texels"], ["from", code(source["path"])], ["read as", source["kind"]],
        ["clipped, of all values", f"{100 * source['clipped_share']:.3g} %"],
        ["invalid, of all values", f"{100 * source['invalid_share']:.3g} %"],
        ["held out", f"{100 * report['holdout']:.3g} % of the photographs, by {SPLITS.get(report['holdout_by'], report['holdout_by'])}"],
        *([["tested on", test_text(report["test_source"])]] if "test_source" in report else []),
        *([["near", near_text(source["near"]["meaning"], report["figures"].get("near"))]] if "near" in source else []),
        *([["object", object_text(source["object"]["mask"], source["object"]["share"])]] if "object" in source else []),
        *([row[0], row[1]] for row in measured_rows(dict(report))),
    ]
    if coverage:
        rows.append(["coverage", coverage_text(coverage)])
    figures = report.get("lambert_residual")
    if figures:
        rows += [["Lambert residual", figures["meaning"]], *(["warning", said] for said in figures["warnings"])]
    return [*rows, *(["note", note] for note in source.get("notes", ()))]


def coverage_text(coverage: Mapping[str, Any]) -> str:
    """Return in a sentence which share of their unknowns the samples of texels determine."""
    least, mean = coverage["least"], coverage["mean"]
    if abs(mean - least) < 1e-6:
        return f"every texel's samples determine {'all' if least > 1 - 1e-6 else f'{100 * least:.3g} %'} of its unknowns"
    left = coverage["texels_not_fully_determined"]
    return f"texels' samples determine {100 * least:.3g} % of their unknowns at least, {100 * mean:.3g} % on average; {left} texels not all"


def _made(report: Mapping[str, Any]) -> list[list[Any]]:
    run = report.get("run") or {}
    geometry = (report.get("figures") or {}).get("geometry", {}).get("chosen", report.get("geometry", "flat"))
    rows: list[list[Any]] = [["model", code(report["model"])]]
    if run.get("command"):
        rows.append(["command", code(shlex.join(map(str, run["command"])))])
    options = [code(f"{name}={value}") for name, value in report["options"].items()]
    rows += [
        ["options", Markup(" ".join(options) or "none")],
        ["geometry", GEOMETRIES.get(geometry, geometry)], ["seed", report["seed"]],
        ["stopped because", stopped(report["stop_reason"])],
        ["time", f"{number(report['load_seconds'])} s to load, {number(report['fit_seconds'])} s to fit"],
        ["size", f"{number(report['bytes_per_texel'])} bytes a texel, and {report['shared_bytes']} bytes that all share (less is better)"],
        ["shading", f"{number(report['shade_mtexels_per_s'])} million texels a second (more is better)"],
        ["most memory", f"{number(report.get('peak_rss_mb'))} MB"],
    ]
    if run.get("digest"):
        rows.append(["digest of the data", code(run["digest"])])
    versions = ", ".join(f"{name} {version}" for name, version in report["versions"].items())
    return [*rows, ["versions", versions]]
