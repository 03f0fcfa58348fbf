"""torchmat fit and torchmat render with one scene file."""

from __future__ import annotations

import json

import pytest
from tests.support import all_pairs, hemisphere, plausible_images

from torchmat import Btf, RangeError
from torchmat.cli.fit import Fit
from torchmat.cli.render import Render
from torchmat.images import read_image

SCENE = """
mesh = "quad"
size = 10
rays = 1
[[lights]]
direction = [0.2, 0.3, 0.9]
"""


@pytest.fixture()
def scene(tmp_path):
    path = tmp_path / "near.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def test_one_scene_file_serves_fit_and_render(tmp_path, scene, monkeypatch, capsys):
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1), (40, 5))))
    btf = Btf.from_tensors(plausible_images(light, view, 8, 8), light, view)
    monkeypatch.setattr("torchmat.cli.arguments.DataArguments.load", lambda *_: btf)
    (tmp_path / "fit.toml").write_text('model = "texture"\n', encoding="utf-8")
    Fit(tmp_path / "fit.toml", out=tmp_path / "out", scene=[scene], no_pictures=True).run()
    assert "relative error at the scene's points" in capsys.readouterr().out
    assert json.loads((tmp_path / "out" / "report.json").read_text())["scene"]["samples_share"] < 1
    Render(str(tmp_path / "out"), scene=scene).run()
    assert read_image(tmp_path / "out" / "pictures" / "render_near.png").shape == (10, 10, 3)


def test_a_scene_file_comes_without_other_lights(tmp_path, scene):
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1), (40, 5))))
    btf = Btf.from_tensors(plausible_images(light, view, 8, 8), light, view)
    command = Render("data", scene=scene, mesh=["teapot"], out=tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchmat.cli.arguments.DataArguments.load", lambda *_: btf)
        with pytest.raises(RangeError, match="--scene"):
            command.run()
