"""What a fit is worth, in one sentence that is decided from its report alone, and what to beware of."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from torchmat.report.tables import number, stopped_text
from torchmat.report.words import STOPPED
from torchmat.solvers.stop_reasons import BUDGET, DIVERGED, NOT_FINITE, OPEN, STEP_LIMIT


class Band(NamedTuple):
    """A grade, from which PSNR and up to which relative error it is given, and how it is said."""

    grade: str
    psnr_db: float
    relative_error: float
    said: str


# As displayed: 38 dB is off by 3 of 255 levels, 32 dB by 6, 26 dB by 13, 20 dB by 26. The relative error keeps dark
# materials honest, whose every picture is close to black. The worse of the two decides.
BANDS = (
    Band("excellent", 38.0, 0.02, "the eye cannot tell it from the photographs"),
    Band("good", 32.0, 0.05, "hard to tell from the photographs"),
    Band("fair", 26.0, 0.15, "a close likeness, whose differences show side by side"),
    Band("coarse", 20.0, 0.4, "a likeness, whose differences show at a glance"),
    Band("poor", -math.inf, math.inf, "a rough likeness only"),
)
UNUSABLE, UNKNOWN = "unusable", "unknown"
_FEW = 10  # unseen photographs: of fewer, chance decides whether they hold a highlight
_GRAZING_DEG = 60
_LOST_DB, _LEARNT_DB = 1.0, 3.0  # what export, and what unseen photographs, may cost before it is said
_CLIPPED_SHARE = 0.01


class Verdict(NamedTuple):
    """One of the grades of BANDS, "unusable" or "unknown"; one sentence; and what to beware of, a sentence each."""

    grade: str
    sentence: str
    cautions: tuple[str, ...]


def verdict(report: Mapping[str, Any]) -> Verdict:
    """Return what a fit is worth.

    Judged is what the textures hold on unseen photographs; where that was not measured the photographs that the fit saw,
    and it says so. `report` is that of `fit`, or what `report.json` holds.
    """
    where, figures = _judged(report)
    size = f"{number(report['bytes_per_texel'])} bytes a texel"
    cautions = tuple(_cautions(report, where))
    if where is None:
        return Verdict(UNKNOWN, f"How true it is was not measured; {size}.", cautions)
    db, error = figures.get("psnr_db"), figures.get("relative_error")
    if report.get("stop_reason") in (NOT_FINITE, DIVERGED):
        return Verdict(UNUSABLE, f"Do not use this: {STOPPED[report['stop_reason']]}{_measured(db, error)}; {size}.", cautions)
    if db is None or not math.isfinite(db) or (error is not None and not math.isfinite(error)):
        return Verdict(UNUSABLE, f"Do not use this: its errors are not finite numbers; {size}.", cautions)
    band = _band(db, error)
    what = {"train": "the photographs it was fitted to"}.get(where, "unseen photographs" if _by(report) else "unseen pairs of light and view")
    shares = "" if error is None else f" (relative error {number(error)})"
    return Verdict(band.grade, f"Reproduces {what} at {db:.1f} dB{shares}: {band.said}{_except(figures, band)}; {size}.", cautions)


def _by(report: Mapping[str, Any]) -> bool:
    return report.get("holdout_by", "pair") != "pair"


def _judged(report: Mapping[str, Any]) -> tuple[str | None, Mapping[str, Any]]:
    """Return which part of the report is judged, None where nothing was measured, and its figures."""
    for where in ("held_out_after_export", "held_out", "train"):
        if report.get(where):
            return where, report[where]
    return None, {}


def _measured(db: float | None, error: float | None) -> str:
    both = ((f"{number(db)} dB", db), (f"relative error {number(error)}", error))
    known = [text for text, value in both if value is not None and math.isfinite(value)]
    return f" ({', '.join(known)})" if known else ""


def _band(db: float, error: float | None) -> Band:
    return next(band for band in BANDS if db >= band.psnr_db and (error is None or error <= band.relative_error))


def _except(figures: Mapping[str, Any], band: Band) -> str:
    """Return where it is worse than on the whole by a grade at least: under grazing light, from grazing views, or both."""
    found = []
    for angle, said in (("light", "under grazing light"), ("view", "from grazing views")):
        rows = [
            row for row in figures.get("by_angle", ())
            if row["angle"] == angle and row["from_deg"] >= _GRAZING_DEG and row["psnr_db"] is not None and math.isfinite(row["psnr_db"])
        ]
        worst = min(rows, key=lambda row: row["psnr_db"], default=None)
        if worst is not None and BANDS.index(_band(worst["psnr_db"], None)) > BANDS.index(band):
            found.append(f"{said} ({worst['psnr_db']:.1f} dB from {worst['from_deg']}°)")
    return f", and worse {' and '.join(found)}" if found else ""


def _cautions(report: Mapping[str, Any], where: str | None) -> list[str]:
    return [text for text in (*_of_the_measuring(report, where), *_of_the_fit(report), *_of_the_data(report)) if text]


def _of_the_measuring(report: Mapping[str, Any], where: str | None) -> list[str]:
    held_out, after, train = (report.get(name) or {} for name in ("held_out", "held_out_after_export", "train"))
    said = []
    if where == "train":
        said.append("No photographs were held out: on unseen ones it can be far worse. Give holdout=0.2 to know.")
    if held_out and held_out["samples"] < _FEW:
        count = held_out["samples"]
        said.append(f"Only {count} unseen photograph{'s' * (count != 1)}: chance has a large part in these figures.")
    lost = _less(held_out, after)
    if lost > _LOST_DB:
        said.append(f"Storing it as textures costs {lost:.1f} dB: a storage of more bits keeps them.")
    learnt = _less(train, held_out)
    if learnt > _LEARNT_DB:
        said.append(f"It is {learnt:.1f} dB better on photographs that it saw: too free for so few of them.")
    return said


def _less(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """Return by how many dB the second is worse than the first, 0 where that is not known."""
    better, worse = one.get("psnr_db"), other.get("psnr_db")
    if better is None or worse is None or not (math.isfinite(better) and math.isfinite(worse)):
        return 0.0
    return better - worse


def _of_the_fit(report: Mapping[str, Any]) -> list[str]:
    said, coverage, choice = [], report.get("coverage") or {}, (report.get("figures") or {}).get("auto") or {}
    if report.get("stop_reason") in (STEP_LIMIT, BUDGET):
        said.append(f"The fit was not at its end: {STOPPED[report['stop_reason']]}. More time may make it truer.")
    if report.get("stop_reason") == OPEN:
        said.append(f"Not everything is determined: {STOPPED[OPEN]}.")
    if stopped_text(report):
        said.append(f"{_capital(stopped_text(report))}.")
    if choice.get("short_by_db"):
        said.append(f"It falls short of what was wanted by {number(choice['short_by_db'])} dB.")
    if (choice.get("highlights") or {}).get("lost"):
        said.append(f"Highlights are lost: the relative error on them is {number(choice['chosen']['highlight_error'])}.")
    if coverage.get("texels_not_fully_determined"):
        said.append(f"{coverage['texels_not_fully_determined']} of {report['texels']} texels are not fully determined by the data.")
    return said


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def _of_the_data(report: Mapping[str, Any]) -> list[str]:
    source = report.get("source") or {}
    said = []
    if source.get("clipped_share", 0) > _CLIPPED_SHARE:
        said.append(
            f"{100 * source['clipped_share']:.3g} % of the data is clipped: how bright highlights truly are is not known, "
            "and errors there are not counted."
        )
    if source.get("invalid_share", 0) > 0:
        said.append(f"{100 * source['invalid_share']:.3g} % of the data is invalid and counts nowhere.")
    return said
