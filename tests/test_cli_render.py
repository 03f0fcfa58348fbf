"""torchmat render: objects, lights, cameras and moving pictures from the command line."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.support import assert_close

from torchmat import load_btf, load_material, sample_path, save_material
from torchmat.brdf import AnalyticBrdf, tabulate, write_merl
from torchmat.btf.interpolated import RawBtf
from torchmat.cli import main
from torchmat.images import read_image, write_image
from torchmat.models import Texture
from torchmat.rendering import Camera, Directional, Point, environment_lights, render
from torchmat.rendering.as_mesh import as_mesh

LIGHT = (0.3, 0.4, 0.8)


@pytest.fixture
def folder(tmp_path):
    generator = torch.Generator().manual_seed(0)
    return save_material(Texture({"albedo": torch.rand(3, 6, 6, generator=generator)}), tmp_path / "Stoff ü")


def run(*arguments) -> int:
    return main(["render", *map(str, arguments)])


def pixels(path) -> torch.Tensor:
    return torch.from_numpy(read_image(path).astype(np.float32)).permute(2, 0, 1)


def test_objects_are_what_render_says(folder, capsys):
    size = ("--size", 16, "--exr", "--light", *LIGHT)
    assert run(folder, "--mesh", "torus", "cube", *size, "--view", 1, 1, 1, "--field-of-view-deg", 30, "--shadows") == 0
    said = capsys.readouterr().out
    material = load_material(folder)
    for name in ("torus", "cube"):
        path = folder / "pictures" / f"render_{name}.exr"
        assert str(path) in said and path.with_suffix(".png").is_file()
        mesh = as_mesh(name)
        camera = Camera.framing(mesh.centre, mesh.radius, (1, 1, 1), np.radians(30.0))
        expected = render(material, mesh, [Directional(LIGHT)], size=16, camera=camera, shadows=True)
        assert float(expected.max()) > 0.1
        assert_close(pixels(path), expected, 1e-5)


def test_points_and_an_environment_light_the_object(folder, tmp_path):
    sky = np.random.default_rng(0).random((4, 8, 3)).astype(np.float32)
    write_image(tmp_path / "sky.exr", sky)
    out = tmp_path / "pictures"
    arguments = ("--mesh", "sphere", "--size", 8, "--exr", "--repeat", 1, "--out", out)
    assert run(folder, *arguments, "--point", 0, 0, 3, "--environment", tmp_path / "sky.exr", "--environment-lights", 5) == 0
    lights = [Point((0.0, 0.0, 3.0)), *environment_lights(torch.from_numpy(sky).permute(2, 0, 1), 5)]
    assert_close(pixels(out / "render_sphere.exr"), render(load_material(folder), "sphere", lights, size=8), 1e-5)


def test_a_mesh_file_and_a_patch(folder, tmp_path):
    square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    (tmp_path / "tile.obj").write_text(square)
    assert run(folder, "--mesh", tmp_path / "tile.obj", "patch", "--size", 12, "--exr", "--out", tmp_path / "pictures") == 0
    tile, patch = (pixels(tmp_path / "pictures" / f"render_{name}.exr") for name in ("tile", "patch"))
    assert tile.shape == patch.shape == (3, 12, 12)
    # The square stands inside of its bounding circle; its middle is the patch's.
    assert float((tile[:, 5:7, 5:7].mean() - patch[:, 5:7, 5:7].mean()).abs()) < 0.1


def test_moving_pictures(folder, tmp_path, capsys):
    arguments = ("--mesh", "cube", "--size", 12, "--rays", 1, "--out", tmp_path)
    assert run(folder, *arguments, "--turntable", 5, "--sweep", 4) == 0
    assert run(folder, *arguments, "--sweep", 3, "--gif") == 0
    said = capsys.readouterr()
    assert said.err == ""
    for name in ("render_cube_turntable.png", "render_cube_turntable.apng", "render_cube_sweep.png", "render_cube_sweep.gif"):
        assert (tmp_path / name).is_file() and str(tmp_path / name) in said.out
    assert read_image(tmp_path / "render_cube_turntable.png").shape == (2 * 12 + 4, 3 * 12 + 8, 3)


@pytest.mark.parametrize("arguments, words", [
    (("--mesh", "teapott"), "Did you mean 'teapot'"),
    (("--mesh", "nowhere.obj"), "nowhere.obj"),
    (("--rays", 5), "rays must be one of"),
    (("--point", 0, 0, 0, "--mesh", "sphere"), "the light must lie outside of the mesh 'sphere'"),
    (("--environment", "nowhere.hdr"), "nowhere.hdr"),
    (("--field-of-view-deg", 200, "--mesh", "cube"), "field_of_view must lie between 0 and pi"),
    (("--turntable", 2, "--point", 0, 0, 9, "--mesh", "cube"), "the lights must be distant"),
    (("--point", 0, 0, 9, "--mesh", "patch"), "the lights of a patch must be directional"),
])
def test_what_is_wrong_is_named_and_nothing_is_written(folder, arguments, words, capsys):
    assert run(folder, "--size", 8, *arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and words in said
    assert not (folder / "pictures").exists()


def _shown(path, out) -> torch.Tensor:
    assert run(path, "--mesh", "sphere", "--repeat", 1, "--size", 8, "--exr", "--light", *LIGHT, "--out", out) == 0
    return pixels(out / "render_sphere.exr")


def test_other_inputs_are_shown_too(tmp_path, capsys):
    lights = [Directional(LIGHT)]
    brdf = AnalyticBrdf("ggx", roughness=0.4)
    table = tabulate(brdf, (20, 10, 20))
    write_merl(tmp_path / "paint.binary", table)
    assert_close(_shown(tmp_path / "paint.binary", tmp_path / "a"), render(table, "sphere", lights, size=8), 1e-4)
    codes = np.broadcast_to(np.array([0, 80, 160, 240], np.uint8)[:, None, None, None], (4, 5, 6, 3))
    (tmp_path / "wool.3pm").write_bytes(b"VL\n#components 3\n6 5 4\n255\n" + codes.tobytes())
    shown = _shown(tmp_path / "wool.3pm", tmp_path / "b")
    assert float(shown.max()) > 0.1
    assert_close(shown, render(load_material(tmp_path / "wool.3pm"), "sphere", lights, size=8), 1e-5)
    btf = load_btf(sample_path())
    assert_close(_shown(sample_path(), tmp_path / "c"), render(RawBtf(btf), "sphere", lights, size=8), 1e-5)
    capsys.readouterr()
    for name, words in (("paint.binary", "MERL table"), ("wool.3pm", "shading_map")):
        assert main(["info", str(tmp_path / name)]) == 0
        assert words in capsys.readouterr().out


def test_a_path_that_is_nothing(tmp_path, capsys):
    assert run(tmp_path / "nowhere") == 2
    assert "nowhere" in capsys.readouterr().err


@pytest.mark.parametrize("arguments, words", [
    (("--mesh", "patch", "--turntable", 3), "a patch does not turn"),
    (("--sweep", 3, "--light", 0, 0, 1), "bring its own light"),
    (("--mesh", "cube", "a/cube.obj"), "two are called cube"),
    (("--mesh", "cube", "--repeat", 0), "size and repeat must be positive"),
])
def test_arguments_that_do_not_go_together(folder, arguments, words, capsys, tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "cube.obj").touch()
    monkeypatch.chdir(tmp_path)
    assert run(folder, "--size", 8, *arguments) == 2
    assert words in capsys.readouterr().err
    assert not (folder / "pictures").exists()


def test_a_point_light_is_for_objects(folder):
    assert run(folder, "--size", 8, "--point", 1, 1, 3) == 0
    assert sorted(path.name for path in (folder / "pictures").iterdir()) == ["render_sphere.png"]
