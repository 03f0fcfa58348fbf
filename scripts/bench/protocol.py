"""The protocol of accuracy: models beside each other on pairs, lights and views that no fit saw, and on directions off the grid.

``python scripts/bench/protocol.py`` fits every model to every data set for every way of holding out and every seed, and writes
``results/protocol.json`` after each row. A row that stands there is not measured again: what was stopped goes on where it was.
Parts of it: ``--data stones leather --models microfacet neural --by light view --seeds 0 --set effort=0.3``. Errors are those of
the exported material, 8 bits a channel.
"""

from __future__ import annotations

import argparse
import inspect
import json
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import torch
from measure import RESULTS, SHARED, save

import torchmat as tm
from torchmat.btf.split import ARC, HOLDOUT_WAYS
from torchmat.errors import check_known_keys
from torchmat.fitting.recipe import recipe_of
from torchmat.report.comparison import parse_model
from torchmat.text_file import parse_value

NAME = "protocol"
REFERENCES = ("leather", "wallpaper", "stones", "disk", "weave_ubo2003")
DATA = ("sample", *REFERENCES)
MODELS = ("distribution", "microfacet", "neural", "lambert")
WAYS = tuple(way for way in HOLDOUT_WAYS if way != ARC)
SEEDS = (0, 1)
_FIT = frozenset(inspect.signature(tm.fit).parameters)
_KEY = ("data", "model", "settings", "by", "seed")


def load(name: str) -> tuple[tm.Btf, tm.Btf | None]:
    """Return a data set by its name, and images of it off its grid where there are any."""
    if name == "sample":
        try:
            off = tm.sample_path("random")
        except tm.DataError as error:  # said, and measured without it
            print(error, flush=True)
            return tm.load_btf(tm.sample_path()), None
        return tm.load_btf(tm.sample_path()), tm.load_btf(off)
    return tm.load_btf(SHARED / "reference" / f"{name}.zip"), None


def measure(btf: tm.Btf, test: tm.Btf | None, model: str, settings: dict[str, Any], by: str, seed: int) -> dict[str, Any]:
    """Fit one model and return what its row says: errors of what 8-bit textures hold, bytes, seconds."""
    name, own = parse_model(model)
    # What another model alone has, such as an effort, is none of this one's.
    given = {key: value for key, value in settings.items() if key in _FIT or key in recipe_of(name).options}
    options = {"geometry": "recover", "storage": "png8", **given, **own}
    start = time.perf_counter()
    result = tm.fit(btf, name, holdout_by=by, seed=seed, measure="none", progress=False, **options)
    seconds, report, exported = time.perf_counter() - start, result.report, result.material.as_exported()
    row = {
        **_errors(exported, btf, result.split.held_out),
        "bytes": report["bytes_per_texel"], "shared bytes": report["shared_bytes"], "seconds": report["fit_seconds"],
        "with loading": seconds, "held out": len(result.split.held_out), "stopped because": report["stop_reason"],
        "geometry": report["figures"].get("geometry", {}).get("chosen", report["geometry"]),
    }
    if test is not None:
        row |= {f"random {key}": value for key, value in _errors(exported, test, torch.arange(len(test))).items()}
    return row


def _errors(material: tm.Material, btf: tm.Btf, rows: torch.Tensor) -> dict[str, Any]:
    found = tm.evaluate(material, btf, rows, perceptual=False).report
    return {"dB": found["psnr_db"], "error": found["relative_error"], "interval": found["relative_error_interval"]}


def wanted(
    data: Sequence[str], models: Sequence[str], ways: Sequence[str], seeds: Sequence[int], settings: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    """Yield what tells each row from all others, seed by seed: a run that is stopped has the first of all before the second."""
    for seed, one, by, model in product(seeds, data, ways, models):
        yield {"data": one, "model": model, "settings": settings, "by": by, "seed": seed}


def standing(path: Path) -> list[dict[str, Any]]:
    """Return the rows that were measured before; those that failed are tried again."""
    rows = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.is_file() else []
    return [row for row in rows if not row.get("failed")]


def protocol(
    data: Sequence[str] = DATA, models: Sequence[str] = MODELS, ways: Sequence[str] = WAYS, seeds: Sequence[int] = SEEDS,
    settings: dict[str, Any] | None = None, again: bool = False,
    source: Callable[[str], tuple[tm.Btf, tm.Btf | None]] = load,
) -> list[dict[str, Any]]:
    """Measure all rows that are asked for and do not stand in the results, or `again` those too; return all that stand there."""
    asked = list(wanted(data, models, ways, seeds, settings or {}))
    rows = standing(RESULTS / f"{NAME}.json")
    if again:
        rows = [row for row in rows if not any(_same(row, key) for key in asked)]
    left = [key for key in asked if not any(_same(row, key) for row in rows)]
    print(f"{len(left)} rows to measure, {len(asked) - len(left)} stand in the results", flush=True)
    loaded: dict[str, tuple[tm.Btf, tm.Btf | None]] = {}
    for key in left:
        if key["data"] not in loaded:
            loaded = {key["data"]: source(key["data"])}
        try:
            found = measure(*loaded[key["data"]], key["model"], key["settings"], key["by"], key["seed"])
        except tm.TorchmatError as error:  # the others go on
            found = {"failed": str(error)}
        rows.append({**key, **found})
        save(NAME, rows)
        print(rows[-1], flush=True)
    return rows


def _same(row: dict[str, Any], key: dict[str, Any]) -> bool:
    return all(row.get(name) == key[name] for name in _KEY)


def summary(rows: Sequence[dict[str, Any]]) -> list[list[Any]]:
    """Return a line for each data, way of holding out and model: what is held out, bytes, seconds, and errors over the seeds.

    dB and error are means, the interval is from the least to the most of all seeds. Fits by pair of data that has images off its
    grid have a second line, of those.
    """
    lines, measured = [], [row for row in rows if not row.get("failed")]
    for key in dict.fromkeys(_group(row) for row in measured):
        alike = [row for row in measured if _group(row) == key]
        data, by, model = key
        cost = (len(alike), _mean(alike, "bytes"), round(_mean(alike, "shared bytes")), _mean(alike, "seconds"))
        lines.append([data, f"new {'light and view' if by == 'both' else by}", model, *cost, *_pooled(alike)])
        if by == "pair" and "random error" in alike[0]:
            lines.append([data, "random directions", model, *cost, *_pooled(alike, "random ")])
    return sorted(lines, key=lambda line: [list(dict.fromkeys(one[k] for one in lines)).index(line[k]) for k in (0, 1)])


def _group(row: dict[str, Any]) -> tuple[str, str, str]:
    name, _, own = row["model"].partition(":")
    options = ",".join([*filter(None, [own]), *(f"{key}={value}" for key, value in row["settings"].items())])
    return row["data"], row["by"], f"{name}:{options}" if options else name


def _pooled(rows: Sequence[dict[str, Any]], prefix: str = "") -> tuple[Any, ...]:
    ends = [row[f"{prefix}interval"] for row in rows if row[f"{prefix}interval"]]
    interval = f"{min(low for low, _ in ends):.3g} to {max(high for _, high in ends):.3g}" if ends else None
    return f"{_mean(rows, f'{prefix}dB'):.1f}", _mean(rows, f"{prefix}error"), interval


def _mean(rows: Sequence[dict[str, Any]], key: str) -> float:
    return sum(row[key] for row in rows) / len(rows)


HEAD = ("data", "held out", "model", "seeds", "bytes/texel", "+ shared", "fit (s)", "dB", "error", "95 % interval")


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", default=DATA, choices=DATA)
    parser.add_argument("--models", nargs="+", default=MODELS, help="with options after a colon, as torchmat compare takes them")
    parser.add_argument("--by", nargs="+", default=WAYS, choices=WAYS)
    parser.add_argument("--seeds", nargs="+", type=int, default=SEEDS)
    parser.add_argument("--set", action="append", default=[], metavar="OPTION=VALUE", help="an option of the fit, or of the models that have it")
    parser.add_argument("--again", action="store_true", help="measure anew what stands in the results")
    given = parser.parse_args()
    names = [parse_model(model)[0] for model in given.models]  # what is misspelt is said now
    settings = {name: parse_value(value) for name, _, value in (text.partition("=") for text in given.set)}
    check_known_keys("--set", settings, (*_FIT, *(option for name in names for option in recipe_of(name).options)))
    protocol(given.data, given.models, given.by, given.seeds, settings, given.again)


if __name__ == "__main__":
    main()
