"""torchmat fit-many."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from torchmat.cli.arguments import DataArguments


@dataclass
class FitMany:
    """Fit many materials, or the tiles of a large one, on all cores or on a cluster (needs torchmat[dask])."""

    model: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL|CONFIG|JOBS")]
    """As of torchmat fit, a model or a config for all data; or with no data a TOML list of jobs: [[job]] with data, config,
    out, set."""
    data: Annotated[list[str], tyro.conf.Positional] = field(default_factory=list)
    """Folders or zips of images."""
    out: Path = Path("materials")
    """Folder in which each material gets a folder of its own, and the summary one called `summary`."""
    set: Annotated[list[str], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Set an option of the model or a key of a config, for example --set seed=3; may be repeated."""
    workers: int = 0
    """Local processes; 0 is one for each core."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://HOST:PORT, instead of local processes."""
    tiles: bool = False
    """Share out the tiles of one material, not whole materials."""
    work: Path | None = None
    """With --tiles: folder that keeps finished tiles; a run that was stopped goes on there."""
    again: bool = False
    """Fit anew what is there already."""
    force: bool = False
    """Replace materials that were painted or edited since too, and keep each as NAME.backup-1."""
    no_pictures: bool = False
    """Write the materials and report.json only."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def check_names(self) -> None:
        from torchmat.cli.early import check_model

        if self.data:  # else the text is a list of jobs
            check_model(self.model, self.set)

    def run(self) -> int:
        from torchmat.many import check_target, fit_many, summary_table, write_summary

        jobs = self._jobs()
        if self.tiles:
            self._run_tiles(jobs)
            return 0
        summary = self.out / "summary"
        check_target(summary)  # before the work, not after it
        rows = fit_many(
            jobs, workers=self.workers, scheduler=self.scheduler, again=self.again, pictures=not self.no_pictures,
            force=self.force,
        )
        print(summary_table(rows))
        print()
        print(f"summary    {write_summary(rows, summary)}")
        return int(any(row["failed"] for row in rows))

    def _jobs(self):
        from torchmat.errors import RangeError, message
        from torchmat.fitting import load_config
        from torchmat.many import jobs_of, load_jobs

        read = self.read.keywords()
        if self.work and not self.tiles:
            raise RangeError(message("fit-many", "--work", "come with --tiles", "they are not asked for"))
        if not self.data:
            if self.set:
                step = 'Write set = ["seed=3"] beside the config of a job.'
                raise RangeError(message("fit-many", "--set", "override a config", "jobs have their own", step))
            return load_jobs(self.model, self.out, read)
        return jobs_of(self.data, load_config(self.model, self.set), self.out, read)

    def _run_tiles(self, jobs) -> None:
        from torchmat.errors import RangeError, message
        from torchmat.many import fit_by_tiles
        from torchmat.material_io import check_target
        from torchmat.report import write_fit
        from torchmat.report.tables import fit_tables

        if len(jobs) != 1:
            step = "Leave --tiles out to share out whole materials."
            raise RangeError(message("fit-many", "--tiles", "be of one material", f"there are {len(jobs)}", step))
        job = jobs[0]
        check_target(job.out, self.force)
        btf, result = fit_by_tiles(job, workers=self.workers, scheduler=self.scheduler, work=self.work)
        folder = write_fit(btf, result, job.out, pictures=not self.no_pictures, force=self.force)
        print(fit_tables(result.report))
        print()
        print(f"material   {folder}")
