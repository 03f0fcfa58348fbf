"""What the long form writes: all rows as JSON, and for people the table of cases with a line for each engine."""

from __future__ import annotations

import json
from pathlib import Path

from tests.hard_cases.components import KINDS
from tests.hard_cases.table import TABLE, TITLES, summary

NAME = "hard_cases"


def read(out: Path) -> dict[str, dict]:
    """Return the parts that an earlier run left in `out`, by name."""
    path = out / f"{NAME}.json"
    return json.loads(path.read_text("utf-8"))["parts"] if path.exists() else {}


def write(out: Path, parts: dict[str, dict], machine: dict) -> None:
    """Write hard_cases.json, a row a line, and hard_cases.md."""
    lines = []
    for name, part in parts.items():
        rows = ",\n".join("   " + json.dumps(row, ensure_ascii=False) for row in part["rows"])
        head = ", ".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in part.items() if key != "rows")
        lines.append(f'  {json.dumps(name)}: {{{head}, "rows": [\n{rows}\n  ]}}')
    text = f'{{"machine": {json.dumps(machine)},\n "parts": {{\n' + ",\n".join(lines) + "\n }}\n"
    (out / f"{NAME}.json").write_text(text, encoding="utf-8")
    (out / f"{NAME}.md").write_text(markdown(parts), encoding="utf-8")


def markdown(parts: dict[str, dict]) -> str:
    """Return the table case x kind of component, what its marks mean, and a line for each part."""
    return "\n".join([*(_cases(parts["table"]["rows"]) if "table" in parts else []), *_engines(parts)]) + "\n"


def _cases(rows: list[dict]) -> list[str]:
    found, reasons = {(row["case"], row["kind"]): row for row in summary(rows)}, []
    lines = ["| case | " + " | ".join(f"{kind}s" for kind in KINDS) + " |", "|---" * (1 + len(KINDS)) + "|"]
    for case, title in TITLES.items():
        cells = []
        for kind in TABLE[case]:
            row = found[case, kind]
            if "reason" in row:
                if row["reason"] not in reasons:
                    reasons.append(row["reason"])
                cells.append(f"- ({reasons.index(row['reason']) + 1})")
            else:
                cells.append(_cell(row))
        lines.append(f"| {case}. {title} | " + " | ".join(cells) + " |")
    return [*lines, "", "Passed of all, and the worst figure with the component that it is of. -: nothing to test, because", ""] + [
        f"{number}. {reason}." for number, reason in enumerate(reasons, 1)
    ] + [""]


def _cell(row: dict) -> str:
    text = f"{row['passed']}/{row['count']}" + (f" ({row['skipped']} not permitted)" if row["skipped"] else "")
    return text if row["figure"] is None else f"{text}; {row['figure']:.2g} {row['unit']}, {row['component']}"


def _engines(parts: dict[str, dict]) -> list[str]:
    lines = ["| part | inputs | rows passed | worst | seconds |", "|---|---|---|---|---|"]
    for name, part in parts.items():
        rows = part["rows"]
        inputs, passed = sum(row.get("count") or 1 for row in rows), sum(row["passed"] is True for row in rows)
        skipped = sum(row["passed"] is None for row in rows)
        share = "" if part["share"] >= 1 else f" (a share of {part['share']:g})"
        skips = f", {skipped} not permitted" if skipped else ""
        lines.append(f"| {name}{share} | {inputs} | {passed}/{len(rows)}{skips} | {_worst(name, rows)} | {part['seconds']:.0f} |")
    return lines


# Which figure of an engine is the worst, and what it is.
_WORST = {
    "fuzz": (min, "inputs a second"), "sweeps": (max, "digits lost"), "conditioning": (min, "digits right"),
    "noise": (max, "times the error of clean images"), "long": (max, "MB grown"), "digests": (min, "fits with the same bits"),
    "disks": (min, "writes stopped"),
}


def _worst(name: str, rows: list[dict]) -> str:
    if name == "sweeps":  # gradients by direction count the digits that are kept
        rows = [row for row in rows if "kept" not in row["case"]]
    figures = [(row["figure"], row["component"]) for row in rows if row.get("figure") is not None]
    if name not in _WORST or not figures:
        return "-"
    choose, unit = _WORST[name]
    value, component = choose(figures)
    return f"{value:.3g} {unit}, {component}"


def failures(parts: dict[str, dict]) -> list[str]:
    """Return what to say of each row that did not pass."""
    return [
        f"{name}: {row['case']}, {row['component']}, figure {row['figure']}: {row['note'] or 'beyond its bound'}"
        for name, part in parts.items() for row in part["rows"] if row["passed"] is False
    ]
