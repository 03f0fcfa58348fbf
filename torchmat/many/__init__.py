"""Many materials, or the tiles of one, fitted on a cluster."""

from torchmat.many.jobs import Job, jobs_of, load_jobs
from torchmat.many.run import fit_many
from torchmat.many.summary import SUMMARY_COLUMNS, check_target, summary_table, write_summary
from torchmat.many.tiles import fit_by_tiles

__all__ = [
    "SUMMARY_COLUMNS", "Job", "check_target", "fit_by_tiles", "fit_many", "jobs_of", "load_jobs", "summary_table",
    "write_summary",
]
