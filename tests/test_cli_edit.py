"""refit, blend, export and pack on the command line: the Python functions, with their targets and refusals."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import torch
from tests.models.distributions import distribution
from tests.models.examples import make
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat.cli import main
from torchmat.images import write_image
from torchmat.material_io import unpack
from torchmat.models import blend

RINGS = ((0, 1), (30, 3), (60, 5))
LIGHT, VIEW = all_pairs(hemisphere(RINGS), hemisphere(RINGS))


@pytest.fixture
def data(tmp_path):
    folder = tmp_path / "data"
    folder.mkdir()
    lines = ["file,light_x,light_y,light_z,view_x,view_y,view_z"]
    for number, image in enumerate(plausible_images(LIGHT, VIEW, 6, 6)):
        write_image(folder / f"{number:03d}.exr", image.transpose(1, 2, 0).astype(np.float32))
        lines.append(f"{number:03d}.exr," + ",".join(f"{value:.9f}" for value in (*LIGHT[number], *VIEW[number])))
    (folder / "manifest.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def run(*arguments):
    return main([str(argument) for argument in arguments])


def saved(path, *arguments, storage="float", provenance=None, **settings):
    tm.save_material(distribution(*arguments, storage=storage, **settings), path, provenance)
    return path


def provenance(folder):
    return json.loads((folder / "manifest.json").read_text("utf-8"))["provenance"]


def test_refit_keeps_what_was_painted_and_says_before_and_after(data, tmp_path, capsys):
    first = {"holdout": 0.25, "holdout_by": "pair", "seed": 3, "source": {"path": "x"}}
    painted = saved(tmp_path / "painted", 6, 6, 1, ("normal",), provenance=first)
    out = tmp_path / "again"
    assert run("refit", painted, "--data", data, "--keep", "diffuse,normal", "--out", out, "--effort", 0.05) == 0
    said = capsys.readouterr().out
    before, after = tm.load_material(painted), tm.load_material(out)
    for name in ("diffuse", "normal"):
        assert torch.equal(before.maps[name], after.maps[name])
    assert not torch.equal(before.maps["specular"], after.maps["specular"])
    report = json.loads((out / "report.json").read_text("utf-8"))
    expected = tm.refit(
        tm.load_btf(data), before, ("diffuse", "normal"), effort=0.05, holdout=0.25, seed=3, progress=False
    )
    assert report["held_out_after"]["psnr_db"] == expected.report["held_out_after"]["psnr_db"]
    assert report["train_after"]["psnr_db"] > report["train_before"]["psnr_db"]
    for word in ("train before", "held out after", "kept       diffuse, normal", str(out)):
        assert word in said
    found = provenance(out)
    assert (found["seed"], found["holdout"], found["source"]) == (3, 0.25, {"path": "x"})
    assert found["refit"]["kept"] == ["diffuse", "normal"] and found["refit"]["from"] == "painted"
    assert (out / "pictures" / "maps.png").is_file()


def test_refit_takes_spaces_and_its_own_split(data, tmp_path):
    painted = saved(tmp_path / "painted", 6, 6, 1, ("normal",), provenance={"seed": 3, "holdout": 0.25})
    out = tmp_path / "again"
    assert run(
        "refit", painted, "--data", data, "--keep", "diffuse", "normal,", "specular",
        "--seed", 5, "--holdout", 0, "--out", out, "--effort", 0.05, "--no-pictures",
    ) == 2  # everything is kept
    assert run(
        "refit", painted, "--data", data, "--keep", "diffuse", "normal", "--seed", 5, "--holdout", 0, "--out", out,
        "--effort", 0.05, "--no-pictures",
    ) == 0
    report = json.loads((out / "report.json").read_text("utf-8"))
    assert report["seed"] == 5 and report["held_out_after"] is None and not (out / "pictures").exists()


def test_refit_refuses_before_the_work(data, tmp_path, capsys):
    painted = saved(tmp_path / "painted", 6, 6, 1, ("normal",))
    before = (painted / "manifest.json").read_bytes()
    for arguments, words in (
        ((painted, "--keep", "difuse"), "keep must be one of 'diffuse', 'normal', 'specular'; it is 'difuse'. Did you mean"),
        ((painted, "--out", painted), f"refit: --out must be another than the material; both are {painted}"),
        ((painted, "--crop", 0, 0, 3, 3), "material must be 3 x 3 as the images; it is 6 x 6"),
        ((tmp_path / "none",), "none: the path must exist; there is nothing"),
    ):
        given = (*arguments, "--data", data, *(() if "--out" in arguments else ("--out", tmp_path / "out")))
        assert run("refit", *given) == 2
        assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists() and (painted / "manifest.json").read_bytes() == before


def test_blend_by_a_weight(tmp_path, capsys):
    a, b = saved(tmp_path / "a", seed=1), saved(tmp_path / "b", seed=2)
    assert run("blend", a, b, "--weight", 0.3, "--out", tmp_path / "out") == 0
    expected = blend(tm.load_material(a), tm.load_material(b), 0.3)
    found = tm.load_material(tmp_path / "out")
    assert found.maps.keys() == expected.maps.keys()
    assert all(torch.equal(found.maps[name], expected.maps[name]) for name in found.maps)
    assert provenance(tmp_path / "out") == {"blend": {"of": ["a", "b"], "weight": 0.3}}
    assert str(tmp_path / "out") in capsys.readouterr().out
    assert run("blend", a, b, "--out", tmp_path / "half", "--no-pictures") == 0
    half = blend(tm.load_material(a), tm.load_material(b), 0.5).maps["diffuse"]
    assert torch.equal(tm.load_material(tmp_path / "half").maps["diffuse"], half)


def test_blend_by_a_mask_takes_the_codes_for_weights(tmp_path, capsys):
    a, b = saved(tmp_path / "a", seed=1), saved(tmp_path / "b", seed=2)
    codes = np.zeros((4, 5, 1), np.uint8)
    codes[1, 2], codes[3] = 255, 51
    write_image(tmp_path / "mask.png", codes)
    assert run("blend", a, b, "--mask", tmp_path / "mask.png", "--out", tmp_path / "out", "--no-pictures") == 0
    one, other, found = (tm.load_material(tmp_path / name).maps["diffuse"].detach() for name in ("a", "b", "out"))
    assert torch.equal(found[:, 0], one[:, 0]) and torch.equal(found[:, 1, 2], other[:, 1, 2])
    assert_close(found[:, 3], 0.8 * one[:, 3] + 0.2 * other[:, 3], 1e-6)
    assert provenance(tmp_path / "out") == {"blend": {"of": ["a", "b"], "mask": "mask.png"}}
    assert "resampled" not in capsys.readouterr().out
    write_image(tmp_path / "small.png", np.full((2, 2, 1), 51, np.uint8))
    assert run("blend", a, b, "--mask", tmp_path / "small.png", "--out", tmp_path / "out", "--no-pictures") == 0
    assert "2 x 2, resampled to 4 x 5" in capsys.readouterr().out
    assert_close(tm.load_material(tmp_path / "out").maps["diffuse"].detach(), 0.8 * one + 0.2 * other, 1e-6)


def test_blend_refuses(tmp_path, capsys):
    a, b = saved(tmp_path / "a", seed=1), saved(tmp_path / "b", seed=2)
    colours = np.zeros((4, 5, 3), np.uint8)
    colours[0, 0, 0] = 200
    write_image(tmp_path / "red.png", colours)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "diary.txt").write_text("mine")
    for more, words in (
        (("--weight", 0.5, "--mask", tmp_path / "red.png"), "--weight and --mask must not both be given"),
        (("--mask", tmp_path / "red.png"), "red.png: the mask must be grey; its channels differ by up to 0.784"),
        (("--weight", 1.5), "weight must lie in [0, 1]"),
        (("--filter", "cubic", "--mask", tmp_path / "red.png"), "--filter must be one of 'bilinear', 'nearest', 'area'"),
        (("--out", b), "--out must be another than the material"),
        (("--out", tmp_path / "mine"), "first 'diary.txt'"),
    ):
        given = (*more, *(() if "--out" in more else ("--out", tmp_path / "out")))
        assert run("blend", a, b, *given) == 2
        assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_export_prints_and_writes_what_is_lost(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    wool = make("shading_map", {"slices": 4, "brdf": "phong"}, 2, 3, torch.float32)
    tm.save_material(wool, tmp_path / "wool", {"seed": 7})
    assert run("export", "wool", "--to", "3pm") == 0
    said = capsys.readouterr().out
    assert "exact: nothing; approximated: slices; lost: brdf, lobe, brightest\n" in said
    assert "3pm        wool.3pm" in said and "losses     wool.3pm.loss.json" in said
    table = json.loads((tmp_path / "wool.3pm.loss.json").read_text("utf-8"))
    assert table["provenance"] == {"seed": 7, "exported_from": "wool"}
    assert tm.load_material("wool.3pm").size == (2, 3)
    assert run("export", "wool", "--out", "other.3pm") == 0  # by its suffix
    assert (tmp_path / "other.3pm").read_bytes() == (tmp_path / "wool.3pm").read_bytes()
    assert run("export", "wool", "--to", "folder", "--set", "storage=png16") == 0
    assert provenance(tmp_path / "wool_folder")["seed"] == 7
    assert json.loads((tmp_path / "wool_folder" / "loss.json").read_text())["options"] == {"storage": "png16"}
    assert (tmp_path / "wool_folder" / "slices_0.png").is_file()


@pytest.mark.parametrize("arguments, words", [
    ((), "to must name an exporter"),
    (("--to", "gtlf"), "it is 'gtlf'. Did you mean 'gltf'?"),
    (("--to", "packed", "--set", "deep=8"), "export to packed: key 'deep' must be one of: depth"),
    (("--to", "packed", "--set", "depth=12"), "depth must be one of 8, 16; it is 12"),
    (("--to", "packed", "--set", "depth"), "--set: 'depth' must be OPTION=VALUE"),
    (("--to", "folder", "--out", "m"), "export: --out must be another than the material; both are m"),
    (("--to", "3pm"), "m.3pm: the material must be a shading_map for a .3pm file; it is distribution"),
])
def test_export_refuses(tmp_path, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    saved(tmp_path / "m")
    assert run("export", "m", *arguments) == 2
    assert words in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir() if path.name != "torchmat-cache"] == ["m"]


def test_pack_is_the_function_and_says_what_it_costs(tmp_path, capsys):
    folder = saved(tmp_path / "m", 4, 5, 2, ("normal",))
    assert run("pack", folder, "--out", tmp_path / "p", "--depth", 16) == 0
    said = capsys.readouterr().out
    assert "lost: nothing" in said and str(tmp_path / "p") in said
    tm.pack(tm.load_material(folder), tmp_path / "q", 16)
    assert (tmp_path / "p" / "diffuse.png").read_bytes() == (tmp_path / "q" / "diffuse.png").read_bytes()
    assert unpack(tmp_path / "p").size == (4, 5)
    assert run("pack", folder, "--out", tmp_path / "p") == 0  # replaced, in 8 bits
    assert json.loads((tmp_path / "p" / "loss.json").read_text())["options"] == {"depth": 8}
    (tmp_path / "p" / "diary.txt").write_text("mine")
    assert run("pack", folder, "--out", tmp_path / "p") == 2
    assert "first 'diary.txt'" in capsys.readouterr().err


FLAGS = {
    "refit": {
        "--data", "--keep", "--out", "--solver", "--steps", "--effort", "--objective", "--holdout", "--holdout-by", "--seed",
        "--no-pictures", "--crop",
    },
    "blend": {"--weight", "--mask", "--filter", "--out", "--no-pictures"},
    "export": {"--to", "--out", "--set"},
    "pack": {"--out", "--depth"},
}


@pytest.mark.parametrize("command", FLAGS)
def test_help_explains_every_flag(command, capsys):
    with pytest.raises(SystemExit) as end:
        run(command, "--help")
    lines = capsys.readouterr().out.splitlines()
    assert end.value.code == 0
    starts = [number for number, line in enumerate(lines) if line.strip("│| ").startswith("-")]
    for flag in FLAGS[command]:
        at = next(number for number in starts if re.search(rf"{flag}(?![a-z-])", lines[number]))
        end_of_it = next((number for number in starts if number > at), len(lines))
        said = " ".join(line.strip("│| ") for line in lines[at:end_of_it]).split(flag, 1)[1]
        # What tyro itself says of a flag stands in brackets; the words before them are ours.
        assert len(re.findall(r"[a-z]{2,}", said.split("(default")[0])) >= 2, said


def test_edit_lets_another_file_of_the_folder_be_a_texture(tmp_path, capsys):
    folder = saved(tmp_path / "wool", 4, 4, 1, ("normal",), storage="png8")
    write_image(folder / "diffuse_blue.png", np.full((4, 4, 3), (0, 0, 255), np.uint8))
    before = (folder / "diffuse.png").read_bytes()
    assert run("edit", folder, "--file", "diffuse=diffuse_blue.png") == 0
    diffuse = tm.load_material(folder).maps["diffuse"].detach()
    assert float(diffuse[2].min()) > 0 and float(diffuse[:2].max()) == 0
    assert (folder / "diffuse.png").read_bytes() == before and "diffuse is" in capsys.readouterr().out
    for wrong in ("diffuse=../x.png", "diffuse=none.png", "none=diffuse.png", "normal=diffuse_blue.png", "diffuse"):
        assert run("edit", folder, "--file", wrong) == 2
    assert run("edit", folder, "--file", "diffuse=diffuse.png", "--out", tmp_path / "other") == 2
    assert torch.equal(tm.load_material(folder).maps["diffuse"], diffuse)
    assert run("edit", folder, "--darken", 0.5) == 0
    assert (folder / "diffuse_blue.png").exists()
    assert_close(tm.load_material(folder).maps["diffuse"], diffuse / 2, 0.02)
