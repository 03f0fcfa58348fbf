"""What is to be fitted: a job for each material, from a list of data or from a file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchmat.errors import DataError, RangeError, check_known_keys, message
from torchmat.fitting import FitConfig, load_config
from torchmat.fitting.config import is_config
from torchmat.fitting.objective import described
from torchmat.fitting.recipes import AUTO, resolve_options
from torchmat.fitting.unseen import SAMPLE
from torchmat.geometry.tiling import AUTO_TILES
from torchmat.report.tables import to_json
from torchmat.sample import sample_path
from torchmat.shipped import find_file
from torchmat.text_file import read_toml

_KEYS = ("data", "config", "out", "set")


@dataclass(frozen=True)
class Job:
    """One material: where its data is, how it is fitted, and the folder for the result.

    `read` are keywords of `load_btf` that override the config's [data].
    """

    data: Path
    config: FitConfig
    out: Path
    read: Mapping[str, Any] = field(default_factory=dict)

    @property
    def reading(self) -> dict[str, Any]:
        """All keywords of `load_btf`."""
        return {**self.config.data, **self.read}

    @property
    def settled(self) -> FitConfig:
        """The config whose [data] is how the images are read in fact; where decoded images are kept decides nothing."""
        return self.config.read_as(self.read)

    def finished(self) -> dict[str, Any] | None:
        """Return the report of a result that is there already, of this data and by this config; else None."""
        try:
            report = json.loads((self.out / "report.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        config = self.settled
        wanted = {name: getattr(config, name) for name in ("seed", "holdout", "holdout_by", "tiles", "target", "data")}
        wanted["geometry"] = config.geometry_word
        chosen = bool(report.get("figures", {}).get("auto"))
        if config.model != AUTO:
            wanted |= {"model": config.model, "options": described(resolve_options(config.model, config.options))}
        wanted = json.loads(to_json(wanted))  # as a report holds it
        report = {**report, "tiles": AUTO_TILES if report.get("tiling") else report.get("tiles")}  # as it was asked for
        same = chosen == (config.model == AUTO) and all(report.get(name) == value for name, value in wanted.items())
        tested = (report.get("test_source") or {}).get("path")
        same &= (tested is None) if config.test is None else tested is not None and _same_place(tested, config.test)
        source = report.get("source", {}).get("path", "")
        return report if same and Path(source).resolve() == self.data.resolve() else None


def _same_place(found: str, asked: str) -> bool:
    """Return whether test images that were measured are those that are asked for."""
    return Path(found).resolve() == Path(asked).resolve() or (asked == SAMPLE and Path(found) == sample_path("random"))


def jobs_of(
    data: Sequence[str | Path], config: FitConfig, out: str | Path, read: Mapping[str, Any] | None = None
) -> list[Job]:
    """Return a job for each of several data, fitted alike, each in a folder of `out` that is called as the data is."""
    paths = [Path(one) for one in data]
    return checked([Job(path, config, Path(out) / path.name.removesuffix(".zip"), read or {}) for path in paths])


def load_jobs(path: str | Path, out: str | Path, read: Mapping[str, Any] | None = None) -> list[Job]:
    """Read a TOML list of jobs: tables ``[[job]]`` with `data`, `config`, and if wanted `out` and `set`.

    Paths are relative to the file, and `config` may be the name of a model as well; `out` is a folder within the given one, by default called as the data is; `set`
    lists what overrides the config, such as ``"seed=3"``. Raises DataError or RangeError, naming the file or the job.
    """
    path = Path(path)
    table = read_toml(path, "the list of jobs")
    check_known_keys(str(path), table, ("job",))
    rows = table.get("job", [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        step = "Begin each job with [[job]]."
        raise DataError(message(str(path), "job", "be a list of tables", f"it is {type(rows).__name__}", step))
    named = [(f"{path}: job {number + 1}", row) for number, row in enumerate(rows)]
    return checked([_job(where, row, path.parent, Path(out), read or {}) for where, row in named])


def _job(where: str, row: dict[str, Any], folder: Path, out: Path, read: Mapping[str, Any]) -> Job:
    check_known_keys(where, row, _KEYS)
    for name in ("data", "config"):
        if not isinstance(row.get(name), str):
            raise RangeError(message(where, name, "be a path", f"it is {row.get(name)!r}"))
    overrides = row.get("set", [])
    if not isinstance(overrides, list) or not all(isinstance(text, str) for text in overrides):
        raise RangeError(message(where, "set", "be a list of texts", f"it is {overrides!r}", 'For example ["seed=3"].'))
    data = folder / row["data"]
    name = row.get("out", data.name.removesuffix(".zip"))
    if not isinstance(name, str):
        raise RangeError(message(where, "out", "be a path", f"it is {name!r}"))
    config = find_file(row["config"], folder=folder) if is_config(row["config"]) else row["config"]
    return Job(data, load_config(config, overrides), out / name, read)


def checked(jobs: list[Job]) -> list[Job]:
    """Return the jobs; raises RangeError when there are none, or when two would write one folder."""
    if not jobs:
        raise RangeError(message("fit-many", "the jobs", "be at least one", "there is none", "Name the data to fit."))
    owners: dict[Path, Job] = {}
    for job in jobs:
        other = owners.setdefault(job.out.resolve(), job)
        if other is not job:
            step = "Give each its own out in a list of jobs."
            fact = f"{other.data} and {job.data} have it"
            raise RangeError(message("fit-many", f"the folder {job.out}", "be of one job", fact, step))
    for folder, job in owners.items():
        around = [owners[parent] for parent in folder.parents if parent in owners]
        if around:
            step, fact = "Put them side by side.", f"it lies in that of {around[0].data}"
            raise RangeError(message("fit-many", f"the folder {job.out}", "be of one job", fact, step))
    return jobs
