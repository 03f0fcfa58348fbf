"""What is wrong with arguments is said before torch is loaded, in the words of the errors that come later."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from torchmat.btf.decode import ENCODINGS
from torchmat.btf.load import DUPLICATE_WAYS, INVALID_WAYS
from torchmat.btf.reader import READERS
from torchmat.btf.split import HOLDOUT_WAYS
from torchmat.capturing.board import PAPERS
from torchmat.capturing.photometry import LIGHTS
from torchmat.cli import known
from torchmat.cli.arguments import DataArguments
from torchmat.cli.early import check_model
from torchmat.errors import DataError, RangeError
from torchmat.fitting import RECIPES, FitConfig
from torchmat.fitting.data_settings import DATA_KEYS
from torchmat.fitting.evaluate import MEASURES
from torchmat.fitting.models import linear, phong_srf, shading_map
from torchmat.fitting.models.spheres import to_btf
from torchmat.fitting.recipes import default_options
from torchmat.fitting.wanted import Target
from torchmat.fitting.certainty.plan import VIEWS
from torchmat.fitting.certainty.search import CRITERIA
from torchmat.geometry.from_photographs import INTEGRATIONS
from torchmat.material_io import packing, relief_folder
from torchmat.material_io.exporter import EXPORTERS
from torchmat.models.resample import FILTERS
from torchmat.models.storage import STORAGES
from torchmat.rendering.scene import PATCH
from torchmat.rendering.shapes import SHAPES

_RUN = "import sys; from torchmat.cli import main; code = main(sys.argv[1:]); print(code, 'torch' in sys.modules)"
_RUN_EACH = """
import json, os, sys, traceback
import torchmat.cli.run
from torchmat.cli import main
assert "torch" not in sys.modules
for arguments, place, said in json.load(sys.stdin):
    child = os.fork()
    if child == 0:
        os.chdir(place)
        for name, stream in (("out", 1), ("error", 2)):
            os.dup2(os.open(os.path.join(said, name), os.O_CREAT | os.O_WRONLY), stream)
        try:
            print(main(arguments), "torch" in sys.modules)
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(0)
    os.waitpid(child, 0)
"""


def run(*arguments: str, cwd=None) -> tuple[str, str]:
    """Return what a fresh process prints of a command: its code and whether torch was loaded, and its error."""
    done = subprocess.run([sys.executable, "-c", _RUN, *arguments], capture_output=True, text=True, cwd=cwd)
    return done.stdout.strip(), done.stderr.strip()


def test_the_names_that_are_known_early_are_those_that_there_are():
    assert known.OPTIONS == {model: tuple(default_options(model)) for model in (*RECIPES, "auto")}
    assert known.CONFIG_KEYS == tuple(field.name for field in dataclasses.fields(FitConfig))
    assert known.TABLES == {"target": tuple(field.name for field in dataclasses.fields(Target)), "data": DATA_KEYS}
    assert known.PAPERS == tuple(PAPERS) and known.LAMPS == LIGHTS
    assert known.STORAGES == tuple(STORAGES) and known.MESHES == (PATCH, *SHAPES)
    ours = {name for name, reader in READERS.items() if reader.listing.__module__.startswith("torchmat.")}
    assert known.ENCODINGS == tuple(ENCODINGS) and known.HOLDOUT_WAYS == HOLDOUT_WAYS and known.MEASURES == MEASURES
    assert known.FILTERS == FILTERS and known.INTEGRATIONS == INTEGRATIONS and known.PACK_DEPTHS == packing.DEPTHS
    assert known.CRITERIA == CRITERIA and known.PLAN_VIEWS == VIEWS
    assert known.RELIEF_DEPTHS == relief_folder.DEPTHS and {*known.KINDS} == ours
    assert DataArguments.words == {"encoding": ENCODINGS, "invalid": INVALID_WAYS, "duplicates": DUPLICATE_WAYS}
    assert {*known.EXPORTERS} == {*EXPORTERS} == {*known.known_exporters()}


def test_the_choices_that_are_known_early_are_those_that_the_models_take():
    assert known.CHOICES == {
        "lambert": {"normals": ("auto", *linear.NORMALS)},
        "ptm": {"space": linear.SPACES}, "lptm": {"space": linear.SPACES}, "rbf": {"space": linear.SPACES},
        "hsh": {"terms": tuple(linear.HSH_TERMS), "space": linear.SPACES},
        "phong_srf": {"residual": tuple(phong_srf.RESIDUALS), "phong": tuple(phong_srf.PHONG_WAYS), "base": tuple(phong_srf.LOBES)},
        "sphere_images": {"base": tuple(to_btf.SPHERE_BASES)},
        "shading_map": {"brdf": tuple(shading_map.ANALYTIC), "overflow": tuple(shading_map.OVERFLOWS)},
    }


MISSPELT = [
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
    (("fit", "phong_srf", "--set", "residual=half_lihgt"), "Did you mean 'half_light'?"),
    (("fit", "ptm", "--set", "residual=half"), "It is an option of phong_srf, not of ptm: options.residual there."),
    (("fit", "phong_srf", "--set", "target.residual=half"), "It is an option of phong_srf: options.residual."),
    (("fit", "ptm", "--set", "psnr=25"), "It has its place in the table target: target.psnr."),
    (("fit", "ptm", "--set", "options.seed=2"), "It is a key of the config itself: seed."),
    (("fit", "misplaced.toml"), "misplaced.toml: key 'terms' must be one of"),
    (("fit", "misplaced.toml"), "It is an option of hsh: options.terms."),
    (("fit", "ptm", "stonse"), "Did you mean 'stones'?"),
    (("fit", "ptm", "stones", "--data", "bad.toml"), "fit: the data must be named once; stones stands in its place"),
    (("refit", "stones", "stones", "--data", "bad.toml"), "refit: the data must be named once"),
    (("fit", "ptm", "--out", "bad.toml/out"), "its place must be a folder that can be written to"),
    (("info", "stones", "--plot", "bad.toml/x.png"), "its place must be a folder that can be written to"),
    (("render", "stones", "--mesh", "teapto"), "Did you mean 'teapot'?"),
    (("render", "stones", "--mesh", "bunny.obj"), "bunny.obj: the path must exist"),
    (("render", "stones", "--scene", "teapto.toml"), "teapto.toml: the path must exist"),
    (("export", "stones", "--to", "pakced"), "Did you mean 'packed'?"),
    (("fit", "ptm", "--set", "holdout=2"), "config: holdout must lie in [0, 1); it is 2."),
    (("fit", "ptm", "--set", "holdout_by=lights"), "Did you mean 'light'?"),
    (("fit", "ptm", "--measure", "ful"), "Did you mean 'full'?"),
    (("fit", "ptm", "--kind", "manifets"), "Did you mean 'manifest'?"),
    (("compare", "--holdout", "-1"), "compare: --holdout must lie in [0, 1); it is -1.0."),
    (("fit-many", "ptm", "stones", "--downscale", "0"), "fit-many: --downscale must be at least 1; it is 0."),
    (("render", "stones", "--size", "0"), "render: --size must be at least 1; it is 0."),
    (("blend", "stones", "stones", "--weight", "3"), "blend: --weight must lie in [0, 1]; it is 3.0."),
    (("create", "stones", "--storage", "png9"), "Did you mean 'png8'?"),
    (("geometry", "stones", "--depth", "99"), "geometry: --depth must be one of '16', 'float'"),
]


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """Return what `run` does of each of MISSPELT, all in one process that forks for each: what it loads is loaded once."""
    asked = []
    for arguments, _ in MISSPELT:
        place = tmp_path_factory.mktemp("misspelt")
        (place / "stones").mkdir()
        (place / "misplaced.toml").write_text('model = "hsh"\nterms = 4\n')
        (place / "bad.toml").write_text('model = "ptm"\n[optoins]\n')
        asked.append((arguments, str(place), str(tmp_path_factory.mktemp("said"))))
    subprocess.run([sys.executable, "-c", _RUN_EACH], input=json.dumps(asked), text=True, check=True)
    return {arguments: [(Path(said) / name).read_text().strip() for name in ("out", "error")] for arguments, _, said in asked}


@pytest.mark.parametrize(("arguments", "words"), MISSPELT)
def test_a_misspelt_name_is_reported_before_torch_is_there(arguments, words, answers):
    out, error = answers[arguments]
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
    kept, loaded = _help("import sys; from torchmat.cli import main\ntry: main(['--help'])\nfinally: print('last:', 'tyro' in sys.modules)", 80)
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
