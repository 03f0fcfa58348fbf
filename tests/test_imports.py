"""Imports point one way through the rooms, and the public names are the ones that are listed."""

from __future__ import annotations

import ast
import importlib.metadata
import subprocess
import sys
from pathlib import Path

import torchmat
from torchmat.fitting import RECIPES

PACKAGE = Path(torchmat.__file__).parent

# A room may import from rooms of a lower level only, or from itself.
LEVELS = {
    "docstrings": 0, "errors": 0, "parts_of": 0, "figures": 0, "mesh_arrays": 0, "safe": 0, "planes": 0, "written": 0, "repeatable": 0, "colour": 0, "progress": 0, "machine": 0,
    "cache_place": 1, "fast": 1, "file_lock": 0,
    "icc": 1, "atomic": 1, "swap": 1, "channels": 1, "frames": 1, "images": 1, "text_file": 1, "zip_names": 0, "places": 0, "metrics": 1, "bootstrap": 0, "sample": 1, "shipped": 1,
    "solvers": 1,
    "brdf": 2, "btf": 2, "geometry": 2, "models": 3, "fitting": 4, "rendering": 4, "scene_use": 2, "material_io": 4,
    "create": 4, "web": 4, "report": 5, "many": 5, "studio": 6, "capturing": 6, "cli": 7,
}
_SIDE_BY_SIDE = {"fitting", "rendering", "material_io", "create"}
ROOMS_THAT_DO_NOT_MEET = {room: _SIDE_BY_SIDE - {room} for room in _SIDE_BY_SIDE}
ROOMS_THAT_DO_NOT_MEET["models"] = {"btf"}

PUBLIC = {
    "LBFGS", "Adam", "Brdf", "Btf", "Camera", "ClosedForm", "DataError", "Directional", "Exporter", "FitConfig",
    "FitError", "FitResult", "LevenbergMarquardt", "Losses", "Material", "Minibatch", "Plan", "Point", "RangeError", "RawBtf", "capture",
    "Reader", "Recipe", "Scene", "ShapeError", "TorchmatError", "Uncertainty", "VariableProjection", "compare", "describe_model",
    "describe_models", "environment_lights", "evaluate", "export", "fit", "load_brdf", "load_btf", "load_config",
    "load_material", "open_studio", "pack", "plan", "recover_geometry", "refit", "register", "register_exporter", "register_reader", "render",
    "sample_path", "sample_truth", "save_material", "split_samples", "uncertainty",
}


def rooms_imported(path: Path) -> set[str]:
    """Return the rooms of the package that a module imports, wherever in the module it does."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("torchmat"):
            parts = node.module.split(".")
            found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("torchmat.")}
    return found


def upward_edges(package: Path) -> list[str]:
    """Return a line for each import that points upward or between rooms that do not see each other."""
    wrong = []
    for path in sorted(package.rglob("*.py")):
        room = path.relative_to(package).parts[0].removesuffix(".py")
        if room == "__init__" or room == "cli":
            continue
        for other in rooms_imported(path) - {room}:
            if other not in LEVELS or room not in LEVELS:
                wrong.append(f"{path.name}: room {room} or {other} has no level")
            elif LEVELS[other] > LEVELS[room] or other in ROOMS_THAT_DO_NOT_MEET.get(room, set()):
                wrong.append(f"{path.relative_to(package)} imports {other}")
    return wrong


def test_imports_point_downward():
    assert upward_edges(PACKAGE) == []


def test_an_upward_import_is_found(tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "bad.py").write_text("from torchmat.btf import Btf\nfrom torchmat.fitting.fit import fit\n")
    assert len(upward_edges(tmp_path)) == 2


def test_public_names_are_the_listed_ones():
    assert set(torchmat.__all__) == PUBLIC
    assert all(hasattr(torchmat, name) for name in PUBLIC)


def test_no_package_has_the_name_of_a_public_function():
    packages = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert not packages & PUBLIC
    assert torchmat.__version__ == importlib.metadata.version("torchmat")


def _loaded(code: str, *modules: str) -> list[str]:
    """Return which of some modules a fresh process has after some code."""
    code = f"import sys\n{code}\nprint([name for name in {modules} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return ast.literal_eval(done.stdout.strip())


def test_importing_the_package_loads_nothing_and_its_names_no_heavy_libraries():
    heavy = ("matplotlib", "sklearn", "kornia", "OpenImageIO", "distributed", "trimesh", "cv2")
    assert _loaded("import torchmat, torchmat.errors, torchmat.cli; dir(torchmat)", "torch", "numpy", *heavy) == []
    assert _loaded("import torchmat; [getattr(torchmat, name) for name in torchmat.__all__]", *heavy) == []


def test_a_name_that_is_not_there_is_an_attribute_error_and_rooms_are_attributes():
    assert not hasattr(torchmat, "no_such_name") and torchmat.models.MATERIALS is torchmat.fitting.recipe.MATERIALS
    assert set(torchmat.__all__) <= set(dir(torchmat))


def test_a_fit_and_a_picture_load_nothing_that_takes_longer_than_they_do():
    code = """
import sys, torch, torchmat as tm
btf = tm.load_btf(tm.sample_path(), cache=False, crop=(0, 0, 4, 4), progress=False)
material = tm.fit(btf, "ptm", holdout=0, measure=False).material
tm.render(material.on_relief(torch.rand(1, 4, 4) / 100), size=4)
print(*sorted({"sympy", "matplotlib", "mitsuba", "sklearn"} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


MECHANISM = ("fitting/on_relief.py", "fitting/from_material.py", "fitting/fit.py", "fitting/choice/*.py", "fitting/tiles/*.py",
             "fitting/scene/*.py", "fitting/relief/*.py", "report/compare*.py")


def models_named(path: Path, names: set[str]) -> set[str]:
    """Return the models whose name stands in a module as a text, or whose class it imports."""
    classes = {"".join(part.title() for part in name.split("_")): name for name in names}
    found, tree = set(), ast.parse(path.read_text(encoding="utf-8"))
    report_keys = {id(key) for node in ast.walk(tree) if isinstance(node, ast.Dict) for key in node.keys}  # "texture": a file
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and node.value in names and id(node) not in report_keys:
            found.add(node.value)
        if isinstance(node, ast.ImportFrom):
            found |= {classes[alias.name] for alias in node.names if alias.name in classes}
    return found


def test_mechanism_asks_no_model_for_its_name(tmp_path):
    names = set(RECIPES)
    named = {str(path): models_named(path, names) for pattern in MECHANISM for path in PACKAGE.glob(pattern)}
    # The default of fit() is a model's name, and the only one.
    assert {path: some for path, some in named.items() if some} == {str(PACKAGE / "fitting/fit.py"): {"phong_srf"}}
    (tmp_path / "bad.py").write_text('from torchmat.models import LocalPca\nif model == "distribution": pass\n')
    assert models_named(tmp_path / "bad.py", names) == {"local_pca", "distribution"}
