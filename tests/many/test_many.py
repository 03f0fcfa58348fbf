"""Many materials, and the tiles of one, on a local cluster; one cluster for the module."""

from __future__ import annotations

import csv
import json
import os
import signal
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.support import all_pairs, hemisphere, plausible_images

from torchmat import DataError, FitConfig, RangeError, fit, load_btf, load_material
from torchmat.cli import main
from torchmat.images import write_image
from torchmat.many import Job, fit_by_tiles, fit_many, jobs_of, load_jobs, run, summary_table, tiles, write_summary
from torchmat.many import cluster as cluster_module

LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (40, 5))), hemisphere(((0, 1), (60, 3))))
CONFIG = FitConfig("phong_srf", {"residual": "half_light"}, seed=1)


def write_btf(folder: Path, seed: int, height: int = 9, width: int = 8) -> Path:
    """Write a small BTF as files and return its folder."""
    folder.mkdir(parents=True)
    lines = ["file,light_x,light_y,light_z,view_x,view_y,view_z"]
    for number, image in enumerate(plausible_images(LIGHT, VIEW, height, width, seed)):
        write_image(folder / f"{number:03d}.exr", image.transpose(1, 2, 0).astype(np.float32))
        lines.append(f"{number:03d}.exr," + ",".join(f"{value:.9f}" for value in (*LIGHT[number], *VIEW[number])))
    (folder / "manifest.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def client():
    with cluster_module.cluster(2) as found:
        yield found


@pytest.fixture
def shared(client, monkeypatch):
    """Let the code under test use the module's cluster instead of starting its own."""

    @contextmanager
    def known(workers=0, scheduler=None):
        yield client

    monkeypatch.setattr(run, "cluster", known)
    monkeypatch.setattr(tiles, "cluster", known)
    return client


@pytest.fixture
def data(tmp_path):
    return [write_btf(tmp_path / f"cloth {number}", number) for number in range(3)]


def same_bits(first, second) -> bool:
    return all(torch.equal(first.maps[name], second.maps[name]) for name in second.maps)


def test_materials_are_those_of_one_process_and_a_broken_one_stops_no_other(shared, data, tmp_path):
    (data[1] / "004.exr").write_text("no picture")
    jobs = jobs_of(data, CONFIG, tmp_path / "out", {"cache": False})
    rows = fit_many(jobs)
    assert [row["status"] for row in rows] == ["done", "failed", "done"]
    assert "004.exr" in rows[1]["failed"] and not (tmp_path / "out" / "cloth 1").exists()
    for number in (0, 2):
        alone = fit(load_btf(data[number], cache=False), CONFIG, measure=False).material.as_exported()
        assert same_bits(load_material(tmp_path / "out" / f"cloth {number}"), alone)
        assert rows[number]["relative_error"] < 0.2 and rows[number]["failed"] is None
    assert "1 failed" in summary_table(rows) and "004.exr" in summary_table(rows)


def test_a_rerun_completes_what_is_missing(shared, data, tmp_path):
    jobs = jobs_of(data[:2], CONFIG, tmp_path / "out", {"cache": False})
    assert [row["status"] for row in fit_many(jobs[:1])] == ["done"]
    before = (jobs[0].out / "report.json").stat().st_mtime_ns
    rows = fit_many(jobs)
    assert [row["status"] for row in rows] == ["skipped", "done"]
    assert (jobs[0].out / "report.json").stat().st_mtime_ns == before
    report = json.loads((jobs[0].out / "report.json").read_text())
    assert rows[0]["relative_error"] == report["held_out"]["relative_error"]
    other = [Job(jobs[0].data, FitConfig("texture"), jobs[0].out, {"cache": False})]
    assert [row["status"] for row in fit_many(other)] == ["done"]  # fitted otherwise: that is no result of this job
    assert [row["status"] for row in fit_many(other, again=True)] == ["done"]


def test_images_read_otherwise_are_fitted_anew(data, tmp_path):
    plain, no_cache = FitConfig("texture"), {"cache": False}
    read = FitConfig("texture", data={"exposure": 2.0, "crop": [0, 0, 4, 8]})
    job = Job(data[0], plain, tmp_path / "out", no_cache)
    assert run.fit_one(job)["status"] == "done" and job.finished() is not None
    assert Job(data[0], plain, job.out).finished() is not None  # where decoded images are kept decides nothing
    assert Job(data[0], read, job.out, no_cache).finished() is None
    assert Job(data[0], plain, job.out, {"exposure": 2.0}).finished() is None
    assert run.fit_one(Job(data[0], read, job.out, no_cache))["status"] == "done"
    assert job.finished() is None
    for config, keywords in ((read, {}), (plain, {"exposure": 2.0, "crop": (0, 0, 4, 8)})):  # in the config or beside it
        assert Job(data[0], config, job.out, keywords).finished()["data"] == {"exposure": 2.0, "crop": [0, 0, 4, 8]}
    assert Job(data[0], read, job.out, {"exposure": 1.0}).finished() is None


def test_a_worker_that_dies_is_replaced_and_its_job_begun_again(shared, data, tmp_path):
    mark = tmp_path / "died"
    job = jobs_of(data[:1], CONFIG, tmp_path / "out", {"cache": False})[0]
    future = shared.submit(_die_once, str(mark), job, pure=False)
    assert future.result(timeout=60)["status"] == "done"
    assert mark.exists() and (job.out / "report.json").is_file()


def _die_once(mark: str, job: Job):
    if not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return run.fit_one(job)


def test_a_job_that_kills_its_workers_says_so():
    from distributed import KilledWorker

    class Dead:
        status = "error"

        def exception(self):
            return KilledWorker("fit_one", None, 3)

    assert "its worker died 4 times" in run._reason(Dead())


def test_tiles_on_a_cluster_give_the_bits_of_one_process(shared, tmp_path):
    folder = write_btf(tmp_path / "large", 5, 21, 26)
    config = FitConfig("phong_srf", {"residual": "half_light"}, tile_size=8)
    _, found = fit_by_tiles(Job(folder, config, tmp_path / "out", {"cache": False}))
    alone = fit(load_btf(folder, cache=False), config)
    assert same_bits(found.material, alone.material)
    assert found.report["held_out"] == alone.report["held_out"]
    assert found.report["figures"]["tiles"]["count"] == 12


def test_other_data_on_a_worker_is_refused(tmp_path):
    folder = write_btf(tmp_path / "one", 5)
    btf = load_btf(folder, cache=False)
    used = torch.ones(len(btf), dtype=torch.bool)
    samples = tiles._Samples(str(folder), {"cache": False}, "another", used, None, 0, True, torch.float32)
    with pytest.raises(DataError, match="be the same for all workers"):
        samples.training()


def test_the_summary_lists_all_jobs(tmp_path):
    job = Job(Path("a"), CONFIG, tmp_path / "a")
    rows = [run._row(job, run.FAILED, failed="no; \"data\""), run._row(job, run.DONE, {"bytes_per_texel": 3.0})]
    folder = write_summary(rows, tmp_path / "summary")
    assert json.loads((folder / "summary.json").read_text())[0]["failed"] == "no; \"data\""
    lines = (folder / "summary.csv").read_text().splitlines()
    assert [row["status"] for row in csv.DictReader(lines)] == ["failed", "done"]
    assert "no; &quot;data&quot;" in (folder / "summary.html").read_text()
    (folder / "other").touch()
    with pytest.raises(DataError, match="an earlier summary"):
        write_summary(rows, folder)


def test_jobs_from_a_file(tmp_path):
    (tmp_path / "fit.toml").write_text('model = "ptm"\n')
    second = 'data = "b"\nconfig = "fit.toml"\nout = "c"\nset = ["seed=3"]\n'
    (tmp_path / "jobs.toml").write_text(f'[[job]]\ndata = "a.zip"\nconfig = "fit.toml"\n[[job]]\n{second}')
    first, second = load_jobs(tmp_path / "jobs.toml", tmp_path / "out")
    assert (first.data, first.out) == (tmp_path / "a.zip", tmp_path / "out" / "a")
    assert (second.out, second.config.seed) == (tmp_path / "out" / "c", 3)
    named = '[[job]]\ndata = "a"\nconfig = "hsh"\nset = ["terms=4"]\n[[job]]\ndata = "b"\nconfig = "auto.toml"\n'
    (tmp_path / "jobs.toml").write_text(named)
    first, second = load_jobs(tmp_path / "jobs.toml", tmp_path / "out")
    assert first.config == FitConfig("hsh", {"terms": 4}) and second.config.target == {"psnr": 25.0}


@pytest.mark.parametrize("text, problem", [
    ("", "be at least one"),
    ("[[jobs]]\n", "job"),
    ("job = 3\n", "be a list of tables"),
    ("[[job]]\ndata = 'a'\n", "config must be a path"),
    ("[[job]]\ndata = 'a'\nconfig = 'fit.toml'\nset = 'x'\n", "be a list of texts"),
    ("[[job]]\ndata = 'a'\nconfig = 'fit.toml'\n[[job]]\ndata = 'x/a'\nconfig = 'fit.toml'\n", "be of one job"),
    ("[[job]]\ndata = 'a'\nconfig = 'fit.toml'\n[[job]]\ndata = 'b'\nout = 'a/b'\nconfig = 'fit.toml'\n", "lies in"),
    ("[[job]", "be TOML"),
])
def test_bad_lists_of_jobs(tmp_path, text, problem):
    (tmp_path / "fit.toml").write_text('model = "ptm"\n')
    (tmp_path / "jobs.toml").write_text(text)
    with pytest.raises((RangeError, DataError), match=problem):
        load_jobs(tmp_path / "jobs.toml", tmp_path / "out")


def test_no_scheduler_is_an_error_that_says_how_to_start_one(monkeypatch):
    monkeypatch.setattr(cluster_module, "PATIENCE", 0.5)
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        with pytest.raises(DataError, match=f"the scheduler {address} must be reachable"):
            with cluster_module.cluster(1, address):
                pass


def test_without_dask_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(cluster_module, "find_spec", lambda name: None)
    with pytest.raises(DataError, match=r"pip install torchmat\[dask\]"), cluster_module.cluster(1):
        pass


def test_workers_are_a_number():
    with pytest.raises(RangeError, match="workers"), cluster_module.cluster(-1):
        pass


def test_the_command_leaves_only_its_results(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = write_btf(tmp_path / "cloth", 1)
    (tmp_path / "fit.toml").write_text('model = "texture"\n')
    assert main(["fit-many", "fit.toml", str(folder), "--no-cache", "--no-pictures", "--workers", "1"]) == 0
    assert "1 done" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cloth", "fit.toml", "materials"]
    assert sorted(path.name for path in (tmp_path / "materials").iterdir()) == ["cloth", "summary"]
    for wrong, problem in (
        ([str(folder), str(tmp_path / "x" / "cloth")], "be of one job"),
        ([str(folder), "--work", "w"], "come with --tiles"),
        (["--set", "seed=3"], "override a config"),
        ([str(folder), str(tmp_path / "b"), "--tiles"], "be of one material"),
    ):
        assert main(["fit-many", "fit.toml", *wrong, "--no-cache"]) == 2
        assert problem in capsys.readouterr().err
