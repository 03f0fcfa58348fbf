"""The package as others get it: built, installed somewhere else, and used from another folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
RUN_SCRIPT = """
import runpy, sys, torchmat
print("package", torchmat.__file__)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def pip(*arguments):
    quiet = {**os.environ, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    command = [sys.executable, "-m", "pip", *map(str, arguments), "--no-deps", "--no-index", "--quiet"]
    done = subprocess.run(command, env=quiet, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder into which a wheel, built from this checkout, is installed."""
    wheels, target = tmp_path_factory.mktemp("wheels"), tmp_path_factory.mktemp("installed")
    pip("wheel", ROOT, "--no-build-isolation", "--wheel-dir", wheels)
    pip("install", *wheels.glob("*.whl"), "--target", target)
    return target


def files_of(folder):
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {str(path) for path in paths if path.suffix != ".pyc"}


def test_a_wheel_holds_the_package_and_the_configs(installed):
    expected = files_of(ROOT / "torchmat") | {f"configs/{name}" for name in files_of(ROOT / "configs")}
    assert files_of(installed / "torchmat") == expected
    assert {"py.typed", "data/sample.zip", "configs/auto.toml", "configs/scenes/teapot.toml"} <= expected


def run(installed, folder, *arguments):
    """Run the installed command with the installed package alone; return what it says."""
    environment = {**os.environ, "PYTHONPATH": str(installed), "TORCHMAT_CACHE": str(folder / "cache")}
    command = [sys.executable, "-c", RUN_SCRIPT, str(installed / "bin" / "torchmat"), *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert f"package {installed / 'torchmat' / '__init__.py'}" in done.stdout
    return done.stdout


def test_an_installed_package_fits_the_sample_from_any_folder(installed, tmp_path):
    said = run(installed, tmp_path, "fit", "phong_srf_half_light.toml", "--crop", 0, 0, 24, 24, "--out", "out")
    for name in ("manifest.json", "residual_hx.png", "report.json", "report.html", "pictures/comparison.png"):
        assert (tmp_path / "out" / name).is_file()
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert report["model"] == "phong_srf" and report["options"]["residual"] == "half_light" and report["samples"] == 625
    assert report["held_out_after_export"]["relative_error"] < 0.1  # measured 0.081
    assert "out/report.html" in said
