"""From photographs to a BTF: what is written is what the material is, bad photographs are named, and what is moved is followed."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import torch
import torchmat.cli
from tests.capturing.corners import degrees_apart
from tests.capturing.known_light import KnownLight
from tests.capturing.shots import Lamp, Lens, shots_around
from tests.capturing.simulated import Studio, write

import torchmat as tm
from torchmat.capturing.board import Board
from torchmat.capturing.capture import capture
from torchmat.capturing.locate import photograph_files
from torchmat.capturing.page import steps_table
from torchmat.capturing.register import register
from torchmat.capturing.scene import Scene
from torchmat.capturing.write import manifest_text
from torchmat.capturing.rectify import Grid
from torchmat.errors import DataError, FitError
from torchmat.images import write_image

pytest.importorskip("cv2")
LENS, BOARD = Lens((720, 480), 790.0), Board(spheres=0)
MOVED = 3  # the sample is moved before this photograph


def pattern(light, view):
    """A matte sample of blots, no two alike."""
    grid = torch.nn.functional.interpolate(torch.rand(1, 3, 30, 30, generator=torch.Generator().manual_seed(3)), (109, 109), mode="bicubic")
    return (0.15 + 0.6 * grid[0].clamp(0, 1)) * light[2:].clamp(min=0)


@pytest.fixture(scope="module")
def studio():
    return Studio(pattern, BOARD, LENS, (109, 109), (-54.5, -54.5, 54.5, 54.5), full_well=30000)


@pytest.fixture(scope="module")
def shots():
    lamps = [Lamp((250 * np.cos(2 * i), 250 * np.sin(2 * i), 400)) for i in range(7)]
    shots = shots_around([12, 25, 35, 40, 48, 52, 57], [137.5 * i for i in range(7)], 380, lamps, roll=90)
    shots[MOVED] = dataclasses.replace(shots[MOVED], sample_moved=(1.5, -1.0, 0.8))
    return {f"photo_{number:02d}.jpg": shot for number, shot in enumerate(shots, 1)}


@pytest.fixture(scope="module")
def photographs(tmp_path_factory, studio, shots):
    folder = tmp_path_factory.mktemp("photographs")
    write(folder, studio.take(list(shots.values())), ".jpg", {"Exif:FocalLengthIn35mmFilm": 39})
    write_image(folder / "table.png", np.full((480, 720, 3), 90, np.uint8))
    (folder / "torn.jpg").write_bytes((folder / "photo_01.jpg").read_bytes()[:200])
    return folder


@pytest.fixture(scope="module")
def scenes():
    return []


@pytest.fixture(scope="module")
def captured(tmp_path_factory, photographs, shots, scenes):
    def light(scene):
        scenes.append(scene)
        return KnownLight(shots, scene, unlit=("photo_07.jpg",))

    return capture(photographs, tmp_path_factory.mktemp("out") / "btf", BOARD, light, measured=150.0, texel=1.0)


def test_each_photograph_that_is_not_used_has_its_reason(captured):
    assert captured.left_out.keys() == {"table.png", "torn.jpg", "photo_07.jpg"}
    assert captured.left_out["table.png"].startswith("no board") and captured.left_out["torn.jpg"].startswith("unreadable")
    assert captured.left_out["photo_07.jpg"] == "its light was not found" and len(captured.used) == 6
    assert "6 of 9" in steps_table(captured.steps) or "7 of 9" in steps_table(captured.steps)


def test_the_btf_has_the_materials_values_and_directions(captured, studio, shots):
    btf = tm.load_btf(captured.folder, cache=False)
    assert btf.source.kind == "manifest" and btf.image(0).shape[1:] == captured.grid.shape == (109, 109) and len(btf) == 6
    errors = {}
    for row, name in enumerate(captured.used):
        shot = shots[name]
        assert degrees_apart(btf.view[row].numpy(), np.array(shot.position)) < 0.1 and degrees_apart(btf.light[row].numpy(), np.array(shot.lamp.position)) < 0.1
        light, _, _ = shot.lamp.at(studio.texel_points())
        wanted = pattern(torch.from_numpy(np.moveaxis(light, -1, 0).astype(np.float32)), None)
        inner = (slice(None), slice(6, -6), slice(6, -6))
        beside = (btf.image(row) - wanted)[inner]
        errors[name] = float((beside**2).sum() / (wanted[inner] ** 2).sum()) ** 0.5
    # Noise, a JPEG's codes and halved colours, and the blur of pixels: 0.038 to 0.052 were measured.
    assert max(errors.values()) < 0.065, errors


def test_a_sample_that_was_moved_is_named_and_followed(captured):
    step = next(step for step in captured.steps if step.name == "registration")
    assert [note for note in step.notes if note.startswith("photo_04.jpg: the sample lies 1.")] and step.figures["moved"] == 1
    assert step.figures["after_texels"] < 0.1 < step.figures["before_texels"]


def test_a_sample_above_the_board_is_found(captured, scenes, shots):
    light = KnownLight(shots, scenes[0])
    found = register(scenes[0], light, dataclasses.replace(captured.grid, height=-2.0), show=False)
    assert found.height == pytest.approx(0, abs=0.1) and "above the board" in found.step.notes[0]


def test_the_folder_says_what_was_found(captured):
    record = json.loads((captured.folder / "capture.json").read_text())
    assert record["steps"]["board"]["left_out"] == {name: why for name, why in captured.left_out.items() if name != "photo_07.jpg"}
    assert record["steps"]["camera"]["matrix"][0][0] == pytest.approx(790, rel=0.01) and record["steps"]["texels"]["columns"] == 109
    page = (captured.folder / "capture.html").read_text()
    assert page.count("<img") >= 4 and "table.png: no board" in page and "http" not in page.replace("http-equiv", "")


def test_a_changed_capture_and_other_files_are_not_replaced(captured, photographs, shots, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(DataError, match="notes.txt"):
        capture(photographs, tmp_path, BOARD, lambda scene: KnownLight(shots, scene))
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_no_light_at_all_is_an_error(tmp_path, shots, scenes, captured):
    from torchmat.capturing.capture import _without_unlit

    scene = scenes[0]
    located = dataclasses.make_dataclass("Located", ["scene"])(scene)
    with pytest.raises(FitError, match="none of 7 has"):
        _without_unlit(located, KnownLight(shots, scene, unlit=tuple(shots)))


def test_two_photographs_under_one_name_are_refused(tmp_path):
    for name in ("a.jpg", "A.png", "b.jpg"):
        (tmp_path / name).touch()
    with pytest.raises(DataError, match="A.png.*a.jpg|a.jpg.*A.png"):
        photograph_files(tmp_path)
    with pytest.raises(DataError, match="holds none"):
        photograph_files([])
    with pytest.raises(DataError, match="folder of photographs"):
        photograph_files(tmp_path / "nowhere")


def test_the_table_counts_from_the_middle_of_the_samples_plane():
    grid = Grid((-10, -10, 30, 10), (4, 8), 2.0)
    near = manifest_text(["a,b.exr"], grid, np.array([[10.0, 0, 302]]), np.array([[110.0, 0, 102]]), True)
    assert near.splitlines() == ["file,light_x,light_y,light_z,view_x,view_y,view_z,sample_width,falloff", '"a,b.exr",100,0,100,0,0,300,40,0']
    far = manifest_text(["a.exr"], grid, np.array([[10.0, 0, 302]]), np.array([[0.0, -0.6, 0.8]]), False)
    cells = far.splitlines()[1].split(",")
    assert float(cells[1]) == pytest.approx(36.8698976) and float(cells[2]) == pytest.approx(270)


def test_a_scene_has_one_camera_and_pose_a_photograph(scenes, captured):
    assert isinstance(scenes[0], Scene) and len(scenes[0].cameras) == len(scenes[0].poses) == len(scenes[0].photographs) == 7


def test_the_command_captures_and_says_what_each_step_found(photographs, shots, tmp_path, capsys):
    given = ["--spheres", "0", "--texel", "2", "--no-register", "--lights", "shading"]
    assert torchmat.cli.main(["capture", str(photographs), "--out", str(tmp_path / "btf"), *given]) == 0
    out = capsys.readouterr().out
    assert all(f"\n{name} " in f"\n{out}" for name in ("scale", "board", "camera", "poses", "lights", "white", "texels")) and "not measured" in out
    assert "note       board: table.png: no board" in out and "registration" not in out
    btf = tm.load_btf(tmp_path / "btf", cache=False)
    assert btf.image(0).shape[1:] == (54, 54) or btf.image(0).shape[1:] == (55, 55)
    # Of shading alone, which says so: lamps within some degrees.
    assert degrees_apart(btf.light[0].numpy(), np.array(shots["photo_01.jpg"].lamp.position)) < 10


def test_the_command_names_what_is_wrong_before_the_work(photographs, tmp_path, capsys):
    corners = ["--chart-corners", *map(str, range(8))]
    wrongs = [(["--size", "A9"], "A9"), (["--measured", "0"], "--measured"), (["--lights", "sun"], "spheres"), (["--spheres", "3"], "spheres"), (corners, "--chart FILE")]
    for wrong, said in wrongs:
        assert torchmat.cli.main(["capture", str(photographs), "--out", str(tmp_path / "btf"), *wrong]) == 2
        assert said in capsys.readouterr().err and not (tmp_path / "btf").exists()
