"""The automatic choice as a text, a table and a picture: what was tried, what it brought, and where it ended."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchmat.report.pictures import plotting, save_figure
from torchmat.report.tables import number, text_table

_COLUMNS = {
    "candidate": "candidate", "bytes": "bytes/texel", "psnr_db": "dB", "psnr_log_db": "log dB",
    "relative_error": "rel. error", "highlight_error": "on highlights", "gain_db": "gain (dB)", "gain_db_per_byte": "dB a byte", "seconds": "seconds", "gain_db_per_second": "dB a second",
    "decision": "decision", "why": "why",
}


_ERRORS = ("psnr_db", "relative_error", "highlight_error")


def decision_rows(choice: Mapping[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Return header and rows of what was tried, in order; gains are against the truest candidate before."""
    return list(_COLUMNS.values()), [[row.get(key) for key in _COLUMNS] for row in choice["candidates"]]


def wanted_text(choice: Mapping[str, Any]) -> str:
    """Return what was wanted, in words."""
    units = {
        "psnr": "at least {} dB", "error": "a relative error of at most {}", "bytes": "at most {} bytes a texel",
        "seconds": "{} seconds", "highlights": "a relative error of at most {} on highlights",
    }
    target = dict(choice["target"])
    if target.get("psnr") is not None and choice["highlights"]["from"] is not None:
        target["highlights"] = choice["highlights"]["at_most"]
    if (target.get("highlights") or 0) >= 1:
        units["highlights"] = "highlights may go"
    return ", ".join(text.format(number(target[name])) for name, text in units.items() if target.get(name) is not None)


def outcome_text(choice: Mapping[str, Any]) -> str:
    """Return what came of it, in one line."""
    chosen = choice["chosen"]
    short = f", by {number(choice['short_by_db'])} dB" if choice["short_by_db"] else ""
    shine = "" if chosen["highlight_error"] is None else f", {number(chosen['highlight_error'])} on highlights"
    return (
        f"{choice['outcome']}{short}: {chosen['candidate']}, {number(chosen['bytes'])} bytes a texel "
        f"({number(chosen['bytes_per_texel'])} and {chosen['shared_bytes']} that all share), "
        f"{number(chosen['psnr_db'])} dB, relative error {number(chosen['relative_error'])}{shine}"
    )


def decided_text(choice: Mapping[str, Any]) -> str:
    """Return which figure decided, and whether highlights are lost, in one or two sentences."""
    chosen, shine, wish = choice["chosen"], choice["highlights"], choice["target"]
    words = {"psnr_db": "the dB", "highlight_error": "the relative error on highlights", "relative_error": "the relative error"}
    decided = f"What decided was {words[choice['decided_by']]}."
    if shine["from"] is None:
        return f"{decided} The images show no highlights."
    if not shine["lost"]:
        return decided
    there = f"where a channel reaches {number(shine['from'])} the relative error is {number(chosen['highlight_error'])}"
    if choice["short_by_db"] == 0:
        return f"{decided} The dB are as wanted, but highlights are lost: {there}. No candidate within the budget keeps them."
    allowed = " They were let go on request." if shine["at_most"] >= 1 else ""
    step = "" if allowed or wish.get("bytes") is None else " More bytes may keep them."
    return f"{decided} Highlights are lost: {there}.{allowed}{step}"


def map_rows(choice: Mapping[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Return header and rows of how each texture is stored."""
    rows = []
    for entry in choice["chosen"]["maps"]:
        if "numbers" in entry:
            values = ", ".join(number(value) for value in entry["numbers"])
            rows.append([entry["map"], "numbers", values])
        else:
            height, width = entry["size"]
            rows.append([entry["texture"], f"{height} x {width} x {entry['channels']}", entry["storage"]])
    return ["texture", "size", "storage or values"], rows


def shrinking_rows(choice: Mapping[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Return header and rows of each map stored smaller by itself: bytes of the material, and its error."""
    keys = ("map", "stored", "bytes", *(key for key in _ERRORS if key in (error_key(choice), "highlight_error")))
    return [_COLUMNS.get(key, key) for key in keys], [[step[key] for key in keys] for step in choice["shrinking"]]


def error_key(choice: Mapping[str, Any]) -> str:
    """Return the name of the error that is wanted, or of PSNR."""
    return "psnr_db" if choice["target"].get("error") is None else "relative_error"


def decisions_text(choice: Mapping[str, Any]) -> str:
    """Return the log of a choice, for people."""
    parts = [
        f"Wanted: {wanted_text(choice)}.", f"Outcome: {outcome_text(choice)}.", decided_text(choice),
        f"Measured on {choice['validation_samples']} training samples that no candidate was fitted to, as exported; "
        f"an error counts as met when it is {100 * choice['margin']:.0f} % below what is wanted.",
        "What was tried, in order. Gains are of the error that is wanted, highlights included, against the truest before.",
        text_table(*decision_rows(choice)),
        "How the textures are stored.", text_table(*map_rows(choice)),
    ]
    if choice["shrinking"]:
        alone = "Each map stored smaller by itself: bytes of the whole material, and its error."
        parts += [alone, text_table(*shrinking_rows(choice))]
    return "\n\n".join(parts) + "\n"


def decisions_picture(choice: Mapping[str, Any], path: Path) -> Path:
    """Draw error against bytes: what was kept, in order, what was left, the material chosen, and the target."""
    key = error_key(choice)
    psnr = key == "psnr_db"
    figure, axis = plotting().subplots(figsize=(7.5, 4.6))
    tried = [row for row in choice["candidates"] if row.get("bytes") is not None]
    kept = [row for row in tried if row["decision"] == "kept"]
    left = [row for row in tried if row["decision"] != "kept"]
    for rows, style, colour, said in ((kept, "-o", "C0", "kept, in the order of trying"), (left, "x", "C3", "left")):
        axis.plot([row["bytes"] for row in rows], [row[key] for row in rows], style, color=colour, label=said)
    for row in tried:
        axis.annotate(row["candidate"], (row["bytes"], row[key]), fontsize=6, xytext=(4, 3), textcoords="offset points")
    chosen = choice["chosen"]
    axis.plot(chosen["bytes"], chosen[key], "*", color="C1", markersize=14, label="chosen, stored as small as may be")
    wanted = choice["target"].get("psnr" if psnr else "error")
    if wanted is not None:
        axis.axhline(wanted, color="C2", linewidth=1, label="wanted")
    if choice["target"].get("bytes") is not None:
        axis.axvline(choice["target"]["bytes"], color="C2", linestyle=":", linewidth=1, label="bytes at most")
    axis.set_xscale("symlog", linthresh=0.5)
    if not psnr:
        axis.set_yscale("log")
    axis.set_xlabel("bytes a texel, shared ones included")
    axis.set_ylabel(f"{'PSNR, dB' if psnr else 'relative error'}, samples kept back, as exported")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=7)
    return save_figure(figure, path)
