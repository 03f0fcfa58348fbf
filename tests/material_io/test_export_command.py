"""torchmat export to forms of renderers: meshes by name, photographs that the fit never saw, and what is printed."""

from __future__ import annotations

import json

import pytest
import torch
from tests.material_io.forms import microfacet
from tests.models.examples import directions, per_image

import torchmat as tm
from torchmat import Btf, RangeError
from torchmat.cli import main
from torchmat.rendering.mesh import load_mesh


def photographs(material, count=10) -> Btf:
    light, view = (directions(count, torch.float32, seed) for seed in (1, 2))
    with torch.no_grad():
        return Btf.from_tensors(material.shade(per_image(light), per_image(view)), light, view)


def test_a_glb_on_a_mesh_by_its_name(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tm.save_material(microfacet("normal").stored_as("float"), "m", {"seed": 7})
    assert main(["export", "m", "--out", "cube.glb", "--mesh", "cube"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("exact: nothing; approximated (error ") and "against the material): diffuse" in said
    table = json.loads((tmp_path / "cube.glb.loss.json").read_text("utf-8"))
    assert table["options"] == {"mesh": "cube", "depth": 16} and table["errors"]["native"] < 1e-6
    assert len(load_mesh("cube.glb").faces) == 12
    assert main(["info", "cube.glb"]) == 0
    told = capsys.readouterr().out
    assert "12" in told and "microfacet" in told and "specular_f0" in told  # the mesh, and what it brings along
    assert main(["export", "m", "--out", "quad.glb", "--mesh", "quad"]) == 0
    assert main(["export", "cube.glb", "--to", "orm", "--set", "vendor=poliigon"]) == 0  # a GLB is a material too
    assert (tmp_path / "cube_orm" / "material_COL.png").is_file()
    capsys.readouterr()
    assert main(["export", "m", "--out", "x.glb", "--mesh", "bunny.obj"]) == 2 and "bunny.obj" in capsys.readouterr().err
    assert main(["export", "m", "--to", "packed", "--mesh", "cube"]) == 2
    assert "key 'mesh' must be one of: depth" in capsys.readouterr().err and not (tmp_path / "x.glb").exists()


def test_the_error_against_photographs_is_measured_and_kept(tmp_path):
    material = microfacet("rolloff")
    btf = photographs(material)
    losses = tm.export(material, tmp_path / "m.glb", btf=btf, samples=torch.tensor([1, 5]))
    wanted = tm.evaluate(losses.held, btf, torch.tensor([1, 5]), perceptual=False).report["relative_error"]
    assert losses.errors["held_out"] == pytest.approx(wanted) and losses.errors["native"] > 1e-5
    assert "against the material, " in str(losses) and "against samples): " in str(losses)
    assert json.loads((tmp_path / "m.glb.loss.json").read_text("utf-8"))["errors"] == losses.errors
    with pytest.raises(RangeError, match="the form must be one that is measured on a BTF; it is not"):
        tm.export(material, tmp_path / "folder", to="folder", btf=btf)
    assert not (tmp_path / "folder").exists()


def test_the_command_measures_on_what_the_fit_held_out(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    btf = tm.load_btf(tm.sample_path(), crop=(0, 0, 6, 6), cache=False, progress=False)
    result = tm.fit(btf, "lambert", holdout=0.3, seed=3, measure=False, progress=False)
    data = {"crop": [0, 0, 6, 6], "cache": False}
    tm.save_material(result.material.stored_as("float"), "m", {"holdout": 0.3, "holdout_by": "pair", "seed": 3, "data": data})
    assert main(["export", "m", "--out", "m.glb", "--btf", "sample"]) == 0
    told = json.loads((tmp_path / "m.glb.loss.json").read_text("utf-8"))["errors"]
    held = tm.load_material("m.glb")
    wanted = tm.evaluate(held, btf, result.split.held_out, 512, perceptual=False).report["relative_error"]
    assert told["held_out"] == pytest.approx(wanted, rel=1e-3) and "against samples" in capsys.readouterr().out
