"""The command line loses no work: painted folders, Ctrl-C, jobs that fail, caches that cannot be, runs that are repeated."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.support import all_pairs, hemisphere, plausible_images

from torchmat import load_material
from torchmat.cli import main
from torchmat.images import read_image, write_image

LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (30, 3))), hemisphere(((0, 1), (60, 3))))


@pytest.fixture
def data(tmp_path):
    return put(tmp_path / "data")


def put(folder, factor: float = 1.0):
    folder.mkdir()
    lines = ["file,light_x,light_y,light_z,view_x,view_y,view_z"]
    for number, image in enumerate(plausible_images(LIGHT, VIEW, 6, 7)):
        write_image(folder / f"{number:03d}.exr", factor * image.transpose(1, 2, 0).astype(np.float32))
        lines.append(f"{number:03d}.exr," + ",".join(f"{value:.9f}" for value in (*LIGHT[number], *VIEW[number])))
    (folder / "manifest.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


@pytest.fixture
def picture(tmp_path):
    write_image(tmp_path / "cloth.png", np.random.default_rng(0).integers(30, 120, (9, 8, 3), dtype=np.uint8))
    return tmp_path / "cloth.png"


def run(*arguments):
    return main([str(argument) for argument in arguments])


def files(folder) -> dict[str, bytes]:
    return {one.relative_to(folder).as_posix(): one.read_bytes() for one in folder.rglob("*") if one.is_file()}


def paint(path) -> bytes:
    write_image(path, np.full_like(read_image(path), 7))
    return path.read_bytes()


def test_create_render_and_edit_over_a_painted_folder_lose_nothing(picture, tmp_path, capsys):
    out = tmp_path / "m"
    assert run("create", picture, "--out", out, "--no-pictures") == 0
    painted = paint(out / "diffuse.png")
    before = files(out)
    capsys.readouterr()
    assert run("create", picture, "--out", out, "--no-pictures") == 2
    said = capsys.readouterr().err
    assert "'diffuse.png'" in said and "--force" in said and len(said.splitlines()) == 1
    assert files(out) == before
    assert run("render", out, "--size", 8) == 0
    assert {name: files(out)[name] for name in before} == before
    assert run("edit", out, "--fresnel", 0.1, 1, "--height-scale", 0.02) == 0
    after = files(out)
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"fresnel.png", "manifest.json"}  # of the height only the white that its codes stand for is another
    assert float(np.ptp(load_material(out).maps["height"].detach().numpy())) < 0.02
    assert {"pictures/render_patch.png", "pictures/render_sphere.png"} <= set(after)
    assert run("create", picture, "--out", out, "--no-pictures", "--force") == 0
    assert files(tmp_path / "m.backup-1") == after and after["diffuse.png"] == painted
    assert files(out)["diffuse.png"] != painted
    assert set(files(out)) - set(before) == {"pictures/render_patch.png", "pictures/render_sphere.png"}


def test_fit_refuses_a_painted_folder_before_it_works(data, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    arguments = ("fit", "texture", "--data", data, "--out", out, "--no-pictures", "--set", "storage=png8")
    assert run(*arguments) == 0 == run(*arguments)
    paint(out / "albedo.png")
    before = files(out)
    monkeypatch.setattr("torchmat.fitting.fit", None)  # not reached
    capsys.readouterr()
    assert run(*arguments) == 2
    assert "'albedo.png'" in capsys.readouterr().err and files(out) == before


def test_a_result_has_a_place_when_its_folder_was_painted_meanwhile(data, tmp_path, capsys, monkeypatch):
    import torchmat.fitting

    out, fit = tmp_path / "out", torchmat.fitting.fit
    arguments = ("fit", "texture", "--data", data, "--out", out, "--no-pictures", "--set", "storage=png8")
    assert run(*arguments) == 0
    painted = []

    def meanwhile(*given, **more):
        painted.append(paint(out / "albedo.png"))
        return fit(*given, **more)

    monkeypatch.setattr(torchmat.fitting, "fit", meanwhile)
    assert run(*arguments) == 0
    said = capsys.readouterr()
    assert f"The result is in {out}.new-1 instead" in said.err and f"{out}.new-1" in said.out
    assert (out / "albedo.png").read_bytes() == painted[0]
    assert load_material(tmp_path / "out.new-1").name == "texture"


def test_edit_takes_every_control(picture, tmp_path, capsys):
    out = tmp_path / "m"
    assert run("create", picture, "--out", out, "--no-pictures", "--specular", "glossy", "rim") == 0
    capsys.readouterr()
    assert run(
        "edit", out, "--normal-strength", 2, "--mask", 0.1, 1.2, "--darken", 0.1, "--tilt", "0:0,30:0.1,90:1",
        "--centre", 0.5, 0.5, "--region", 0, 0, 0.5, 1, "--index", 3, "--specular", "keep", "soft", "noise:seed=2",
        "--softness", 5, "--tiles", "True",
    ) == 0
    said = capsys.readouterr().out
    material = load_material(out)
    assert material.tiles and material.options["lobes"] == 3
    assert material.options["parts"] == ["normal", "specular_mask", "fresnel", "rotation", "tilt"]
    for name in ("normal", "specular_mask", "diffuse", "tilt", "rotation", "index", "specular"):
        assert name in said.splitlines()[0]
    assert float(material.maps["tilt"].detach()[0, 0, 15]) == pytest.approx(0.05, abs=1e-4)
    table = json.loads((out / "manifest.json").read_text())
    assert table["edits"][0]["mask"] == {"brightness": 0.1, "contrast": 1.2, "source": "diffuse"}
    assert run("edit", out, "--without", "tilt", "--out", tmp_path / "other") == 0
    assert "tilt.png" in files(out) and "tilt.png" not in files(tmp_path / "other")
    assert run("edit", out) == 2 and "--height-scale" in capsys.readouterr().err
    assert run("edit", tmp_path / "nowhere", "--darken", 0.1) == 2


def test_ctrl_c_says_what_is_left_in_one_line(data, tmp_path, capsys, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    out = tmp_path / "out"
    arguments = ("fit", "texture", "--data", data, "--out", out, "--no-pictures")
    with monkeypatch.context() as patched:
        patched.setattr("torchmat.report.write.to_json", stop)  # half of the folder is written
        assert run(*arguments) == 130
    assert capsys.readouterr() == ("", "stopped; nothing written\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "torchmat-cache"]
    with monkeypatch.context() as patched:
        patched.setattr("torchmat.report.tables.fit_tables", stop)
        assert run(*arguments) == 130
    assert capsys.readouterr().err == f"stopped; kept, whole: {out}\n"
    assert load_material(out).name == "texture"
    work = tmp_path / "work"
    with monkeypatch.context() as patched:
        patched.setattr("torchmat.fitting.unseen.evaluate_parts", stop)
        assert run(*arguments[:-1], "--work", work, "--set", "tile_size=4") == 130
    assert capsys.readouterr().err == f"stopped; finished tiles are kept in {work}, and the same command goes on there\n"


def test_fit_many_ends_with_1_when_a_job_failed(data, tmp_path, capsys, monkeypatch):
    from torchmat.many import run as many

    def in_this_process(client, jobs, pictures, force):
        for place, job in enumerate(jobs):
            yield place, many.fit_one(job, pictures, force)

    class Nothing:
        def __enter__(self):
            return None

        def __exit__(self, *_):
            return None

    monkeypatch.setattr(many, "_run", in_this_process)
    monkeypatch.setattr(many, "cluster", lambda *_: Nothing())
    out = tmp_path / "out"
    arguments = ("fit-many", "texture", data, "--out", out, "--no-pictures", "--again", "--set", "storage=png8")
    assert run(*arguments) == 0
    painted = paint(out / "data" / "albedo.png")
    assert run(*arguments) == 1
    assert "1 failed" in capsys.readouterr().out and (out / "data" / "albedo.png").read_bytes() == painted
    assert run(*arguments, "--force") == 0
    assert (out / "data.backup-1" / "albedo.png").read_bytes() == painted


def test_a_cache_that_cannot_be_is_done_without_and_said(data, tmp_path, capsys):
    (tmp_path / "file").write_text("no folder")
    arguments = ("fit", "texture", "--data", data, "--out", tmp_path / "out", "--no-pictures")
    assert run(*arguments, "--cache", tmp_path / "file" / "cache") == 0
    said = capsys.readouterr().err
    assert said.startswith(f"note: {tmp_path}/file/cache: decoded images are not kept") and len(said.splitlines()) == 1


def test_what_load_converts_is_a_note(picture, tmp_path, capsys):
    assert run("create", picture, "--out", tmp_path / "m", "--no-pictures") == 0
    write_image(tmp_path / "m" / "fresnel.png", np.full((4, 4, 3), 60, np.uint8))
    capsys.readouterr()
    assert run("info", tmp_path / "m") == 0
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2 and all(line.startswith("note: ") and "fresnel.png" in line for line in said)


def test_a_fit_is_run_again_from_its_folder(data, tmp_path, capsys):
    out, again = tmp_path / "out", tmp_path / "again"
    scene = tmp_path / "scene.toml"
    scene.write_text('mesh = "quad"\nsize = 8\n[[lights]]\ndirection = [0.3, 0.1, 1.0]\n', encoding="utf-8")
    arguments = ("fit", "ptm", "--data", data, "--out", out, "--no-pictures", "--seed", 3, "--crop", 0, 1, 5, 6)
    assert run(*arguments, "--scene", scene, "--set", "storage=png16", "--set", "holdout=0.3") == 0
    kept = json.loads((out / "report.json").read_text())["run"]
    assert kept["command"][:3] == ["torchmat", "fit", "ptm"] and kept["data"] == str(data)
    assert kept["config"]["seed"] == 3 and kept["config"]["data"]["crop"] == [0, 1, 5, 6]
    assert run("fit", "--again", out, "--out", again, "--no-pictures") == 0
    first, second = files(out), files(again)
    for name in first:
        assert name in ("report.json", "manifest.json") or first[name] == second[name], name
    assert json.loads(second["report.json"])["held_out"] == json.loads(first["report.json"])["held_out"]
    third = tmp_path / "third"  # of what was run again, by the report itself, with something changed
    assert run("fit", "--again", again / "report.json", "--out", third, "--no-pictures", "--seed", 4) == 0
    assert json.loads((third / "report.json").read_text())["seed"] == 4
    scene.write_text(scene.read_text().replace("0.3", "0.4"), encoding="utf-8")
    assert run("fit", "--again", out, "--out", again, "--no-pictures") == 2
    assert "scene.toml must be what the material was fitted with" in capsys.readouterr().err


def test_other_data_are_not_the_same_run(data, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("fit", "texture", "--data", data, "--out", out, "--no-pictures") == 0
    before = files(out)
    moved = data.rename(tmp_path / "moved")
    assert run("fit", "--again", out, "--no-pictures") == 2
    assert run("fit", "--again", out, "--no-pictures", "--data", moved, "--out", tmp_path / "again") == 0
    other = put(tmp_path / "data", 1.01)
    capsys.readouterr()
    assert run("fit", "--again", out, "--no-pictures") == 2
    said = capsys.readouterr().err
    assert f"{other}: the data must be what {out} was fitted to" in said and "--data" in said
    assert files(out) == before


def test_again_says_what_it_needs(data, tmp_path, capsys):
    assert run("fit") == 2 and "neither is given" in capsys.readouterr().err
    assert run("fit", "ptm", "--again", tmp_path) == 2 and "both are" in capsys.readouterr().err
    assert run("fit", "--again", tmp_path) == 2 and "report.json" in capsys.readouterr().err
    (tmp_path / "report.json").write_text('{"model": "ptm"}', encoding="utf-8")
    assert run("fit", "--again", tmp_path) == 2
    assert "the report must say how it was run" in capsys.readouterr().err


def test_the_digest_of_data_is_of_every_image(small_btf, data):
    from torchmat import Btf, load_btf

    images, light, view = small_btf.images(range(len(small_btf))), small_btf.light, small_btf.view
    first = Btf.from_tensors(images, light, view).digest()
    assert first == Btf.from_tensors(images.clone(), light, view).digest()
    for row in range(0, len(images), 37):
        other = images.clone()
        other[row, 0, 0, 0] += 0.01
        assert Btf.from_tensors(other, light, view).digest() != first
    assert load_btf(data).digest() == load_btf(data).digest() == load_btf(data, cache=False).digest()
    assert torch.equal(small_btf.light, light)


def test_a_studio_knows_the_form_of_what_was_fitted(data, tmp_path):
    from torchmat.studio.known import first_of

    fit = ["fit", "ptm", str(data), "--no-pictures", "--measure", "none"]
    assert main([*fit, "--no-cache", "--out", str(tmp_path / "a")]) == 0
    assert first_of(tmp_path / "a") is None
    assert main([*fit, "--out", str(tmp_path / "b")]) == 0
    assert first_of(tmp_path / "b") is not None and first_of(tmp_path / "a") is not None
