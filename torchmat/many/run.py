"""Many jobs on a cluster: each its own fit, none in the way of the others."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from typing import Any

from torchmat.errors import TorchmatError
from torchmat.many.cluster import cluster
from torchmat.many.jobs import Job, checked
from torchmat.progress import progress

DONE, SKIPPED, FAILED = "done", "skipped", "failed"


def fit_many(
    jobs: Sequence[Job], *, workers: int = 0, scheduler: str | None = None, again: bool = False, pictures: bool = False,
    force: bool = False, show: bool | None = None,
) -> list[dict[str, Any]]:
    """Fit all jobs and write each result as `torchmat fit` does; return a row for each, in their order.

    `workers` local processes, or the cluster of the `scheduler` at an address. A result that is there already, fitted
    as its job says, is skipped unless `again`. A worker that dies is replaced and its job begun again, up to three
    times; a job that fails has a row that says why, and the others go on. Results have the same bits as in one process.

    Raises RangeError for no jobs or two with one folder, DataError when there is no cluster.
    """
    jobs = checked(list(jobs))
    rows: dict[int, dict[str, Any]] = {}
    for number, job in enumerate(jobs):
        report = None if again else job.finished()
        if report is not None:
            rows[number] = _row(job, SKIPPED, report)
    left = [number for number in range(len(jobs)) if number not in rows]
    if left:
        with cluster(workers if scheduler else min(workers or os.cpu_count() or 1, len(left)), scheduler) as client:
            found = _run(client, [jobs[number] for number in left], pictures, force)
            for place, row in progress(found, "materials", total=len(left), show=show):
                rows[left[place]] = row
    return [rows[number] for number in range(len(jobs))]


def _run(client: Any, jobs: list[Job], pictures: bool, force: bool) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield (place, row) of jobs as they end."""
    from distributed import as_completed

    # Not pure: a job writes a folder, and the same job twice is two.
    futures = {client.submit(fit_one, job, pictures, force, pure=False): place for place, job in enumerate(jobs)}
    for future in as_completed(futures, loop=client.loop, raise_errors=False):
        place = futures[future]
        if future.status == "finished":
            yield place, future.result()
        else:
            yield place, _row(jobs[place], FAILED, failed=_reason(future))
        future.release()


def _reason(future: Any) -> str:
    from distributed import KilledWorker

    error = future.exception() if future.status == "error" else None
    if isinstance(error, KilledWorker):
        return f"its worker died {error.allowed_failures + 1} times; it may take more memory than there is"
    return f"{type(error).__name__}: {error}" if error else f"it was {future.status}"


def fit_one(job: Job, pictures: bool = False, force: bool = False) -> dict[str, Any]:
    """Fit one job in this process and write its result; return its row."""
    from torchmat.btf import load_btf
    from torchmat.fitting import fit
    from torchmat.material_io import check_target
    from torchmat.report import write_fit

    start = time.perf_counter()
    try:
        check_target(job.out, force)
        btf = load_btf(job.data, **job.reading, progress=False)
        result = fit(btf, job.settled, progress=False)
        write_fit(btf, result, job.out, pictures=pictures, force=force)
    except TorchmatError as error:
        return _row(job, FAILED, failed=str(error), seconds=time.perf_counter() - start)
    except Exception as error:  # whatever it is, it must not end the others
        return _row(job, FAILED, failed=f"{type(error).__name__}: {error}", seconds=time.perf_counter() - start)
    return _row(job, DONE, result.report, seconds=time.perf_counter() - start)


def _row(
    job: Job, status: str, report: dict[str, Any] | None = None, failed: str | None = None, seconds: float | None = None
) -> dict[str, Any]:
    report = report or {}
    held_out, after = (report.get(part) or {} for part in ("held_out", "held_out_after_export"))
    return {
        "data": str(job.data), "status": status, "model": report.get("model", job.config.model), "out": str(job.out),
        "bytes_per_texel": report.get("bytes_per_texel"), "shared_bytes": report.get("shared_bytes"),
        "fit_seconds": report.get("fit_seconds"), "seconds": seconds,
        "relative_error": held_out.get("relative_error"), "psnr_db": held_out.get("psnr_db"),
        "relative_error_after_export": after.get("relative_error"), "stop_reason": report.get("stop_reason"),
        "failed": failed,
    }
