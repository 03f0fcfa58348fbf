"""What is wrong with arguments is said before torch is loaded, in the words of the errors that come later."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys

import pytest

from torchmat.cli import known
from torchmat.cli.early import check_model
from torchmat.errors import DataError, RangeError
from torchmat.fitting import RECIPES, FitConfig
from torchmat.fitting.recipes import default_options

_RUN = "import sys; from torchmat.cli import main; code = main(sys.argv[1:]); print(code, 'torch' in sys.modules)"


def run(*arguments: str, cwd=None) -> tuple[str, str]:
    """Return what a fresh process prints of a command: its code and whether torch was loaded, and its error."""
    done = subprocess.run([sys.executable, "-c", _RUN, *arguments], capture_output=True, text=True, cwd=cwd)
    return done.stdout.strip(), done.stderr.strip()


def test_the_names_that_are_known_early_are_those_that_there_are():
    assert known.OPTIONS == {model: tuple(default_options(model)) for model in (*RECIPES, "auto")}
    assert known.CONFIG_KEYS == tuple(field.name for field in dataclasses.fields(FitConfig))


@pytest.mark.parametrize(("arguments", "words"), [
    (("fit", "phong_srv"), "Did you mean 'phong_srf'?"),
    (("fit", "ptm", "--data", "stonse"), "Did you mean 'stones'?"),
    (("fit", "hsh", "--set", "term=9"), "Did you mean 'terms'?"),
    (("fit", "absent.toml"), "absent.toml: the config must be readable"),
    (("fit", "bad.toml"), "bad.toml: key 'optoins' must be one of"),
    (("compare", "stones", "--models", "ptm", "hsh:tems=4"), "Did you mean 'terms'?"),
    (("render", "absent/material"), "There is no folder absent either."),
    (("refit", "stones", "--data", "nothing"), "nothing: the path must exist; there is nothing"),
    (("blend", "stones", "stone"), "Did you mean 'stones'?"),
    (("models", "neurel"), "Did you mean 'neural'?"),
])
def test_a_misspelt_name_is_reported_before_torch_is_there(arguments, words, tmp_path):
    (tmp_path / "stones").mkdir()
    (tmp_path / "bad.toml").write_text('model = "ptm"\n[optoins]\n')
    out, error = run(*arguments, cwd=tmp_path)
    assert out == "2 False" and words in error and "Traceback" not in error


def test_the_version_is_told_without_torch():
    out, _ = run("--version")
    assert out.startswith("torchmat ") and out.endswith("0 False")


def test_what_is_right_passes(tmp_path):
    (tmp_path / "own.toml").write_text('model = "hsh"\nseed = 3\n[options]\nterms = 4\n')
    check_model(str(tmp_path / "own.toml"), ["terms=9", "options.storage=png8", "target.psnr=3", "seed=2"])
    check_model("phong_srf_half_light.toml", ["model=ptm", "storage=half"])
    check_model("auto", ["target.psnr=25"])
    with pytest.raises(RangeError, match="own.toml"):
        (tmp_path / "own.toml").write_text('model = "hsm"\n')
        check_model(str(tmp_path / "own.toml"))
    with pytest.raises(DataError, match="TOML"):
        (tmp_path / "own.toml").write_text("model = \n")
        check_model(str(tmp_path / "own.toml"))


@pytest.mark.parametrize(("given", "spins"), [({}, "1000"), ({"GOMP_SPINCOUNT": "7"}, "7"), ({"OMP_WAIT_POLICY": "ACTIVE"}, "None")])
def test_idle_threads_of_a_command_give_way_unless_the_user_says_how_they_wait(given, spins):
    code = "import os; from torchmat.cli import main; main(['--version']); print(os.environ.get('GOMP_SPINCOUNT'))"
    clean = {name: value for name, value in os.environ.items() if name not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env={**clean, **given})
    assert done.stdout.split()[-1] == spins


def _help(code: str, columns: int) -> tuple[str, str]:
    """Return the help that a fresh process prints in so many columns, and what it prints last."""
    usual = {**os.environ, "COLUMNS": str(columns), "PYTHONIOENCODING": "utf-8"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", env=usual)
    text, _, last = done.stdout.rpartition("last:")
    return text, last.strip()


def test_the_help_that_is_kept_is_what_the_commands_say_of_themselves():
    made, _ = _help("from torchmat.cli.run import read_arguments\ntry: read_arguments(['--help'], None)\nfinally: print('last:')", 80)
    kept, loaded = _help("import sys; from torchmat.cli import main; main(['--help']); print('last:', 'tyro' in sys.modules)", 80)
    assert kept == made, "run: COLUMNS=80 PYTHONIOENCODING=utf-8 python -c \"from torchmat.cli.run import read_arguments; " \
        "read_arguments(['--help'], None)\" > torchmat/cli/help.txt"
    assert loaded == "False" and made.startswith("usage: torchmat")


def test_a_narrow_terminal_has_a_help_of_its_own():
    text, _ = _help("from torchmat.cli import main\ntry: main(['--help'])\nfinally: print('last:')", 50)
    assert max(len(line) for line in text.splitlines()[3:]) == 50


def test_the_script_that_completes_names_knows_commands_and_options():
    done = subprocess.run([sys.executable, "-m", "torchmat.cli", "--tyro-print-completion", "bash"], capture_output=True, encoding="utf-8")
    assert done.returncode == 0 and "complete -F _tyro_torchmat torchmat" in done.stdout
    assert all(name in done.stdout for name in ("fit-many", "--no-pictures", "--height-scale"))
