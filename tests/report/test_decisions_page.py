"""The automatic choice in words, on the page, as a picture, and on the command line."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.fitting.auto_data import shorten_fits
from tests.report.reading import Reading
from tests.support import all_pairs, hemisphere

import torchmat as tm
from torchmat import Btf
from torchmat.cli import main
from torchmat.images import read_image, write_image
from torchmat.models import Lptm
from torchmat.models.storage import StoredAs
from torchmat.report import write_fit
from torchmat.report.decisions_page import decisions_picture, decisions_text, outcome_text, wanted_text
from torchmat.report.describe import describe_material

LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (30, 5), (60, 6))), hemisphere(((0, 1), (50, 3))))


def images(size=8):
    random = np.random.default_rng(1)
    shaded = LIGHT[:, 2, None, None, None] * random.uniform(0.2, 0.8, (3, size, size))
    return np.maximum(0, shaded + 0.002 * random.standard_normal(shaded.shape)).astype(np.float32)


@pytest.fixture(autouse=True)
def short_fits(monkeypatch):
    shorten_fits(monkeypatch)


@pytest.fixture(scope="module")
def met():
    btf = Btf.from_tensors(images(), LIGHT.astype(np.float32), VIEW.astype(np.float32))
    return btf, tm.fit(btf, "auto", psnr=35)


def test_the_log_says_what_was_wanted_tried_chosen_and_why(met):
    choice = met[1].report["figures"]["auto"]
    text = decisions_text(choice)
    assert wanted_text(choice) == "at least 35 dB"
    assert outcome_text(choice).startswith("target met: texture, 3 bytes a texel (3 and 0 that all share), ")
    for row in choice["candidates"]:
        assert row["candidate"] in text and row["why"] in text
    for part in ("8 x 8 x 3", "png8", "dB a byte", "dB a second", "kept", "skipped"):
        assert part in text
    assert max(map(len, text.split("\n\n")[0].splitlines())) < 200


def test_a_material_is_described_with_what_is_stored_otherwise(tmp_path):
    maps = {"chroma": torch.rand(3, 8, 8), "luminance": torch.rand(6, 8, 8)}
    stored = {"chroma": StoredAs((1, 1)), "luminance": StoredAs((4, 2), "png16")}
    folder = tm.save_material(Lptm(maps, storage="png8", stored=stored), tmp_path / "out")
    assert "chroma numbers, luminance 4 x 2 png16" in describe_material(folder)
    assert "stored otherwise" not in describe_material(tm.save_material(Lptm(maps), tmp_path / "plain"))


def test_every_target_has_its_words():
    target = {"error": 0.05, "psnr": None, "bytes": 4, "seconds": 9.5}
    assert wanted_text({"target": target}) == "a relative error of at most 0.05, at most 4 bytes a texel, 9.5 seconds"


def test_the_folder_holds_the_log_the_picture_and_the_table(met, tmp_path):
    btf, result = met
    folder = write_fit(btf, result, tmp_path / "out")
    choice = json.loads((folder / "report.json").read_text("utf-8"))["figures"]["auto"]
    assert (folder / "decisions.txt").read_text("utf-8") == decisions_text(choice)
    assert read_image(folder / "pictures" / "decisions.png").shape[0] > 300
    page = (folder / "report.html").read_text("utf-8")
    assert "What was tried" in page and outcome_text(choice) in page and "Error against bytes" not in page
    assert Reading(page).keys() == []
    assert write_fit(btf, result, folder, pictures=False) == folder  # its own files may be replaced


@pytest.mark.parametrize("wanted", [{"error": 0.001}, {"bytes": 1.0}, {"psnr": 90}])
def test_a_picture_of_every_kind_of_choice(wanted, tmp_path):
    btf = Btf.from_tensors(images(6), LIGHT.astype(np.float32), VIEW.astype(np.float32))
    choice = tm.fit(btf, "auto", geometry="flat", measure=False, **wanted).report["figures"]["auto"]
    assert decisions_picture(choice, tmp_path / "choice.png").stat().st_size > 10_000
    assert decisions_text(choice).startswith("Wanted: ")


def photographs(folder):
    lines = ["file,light_x,light_y,light_z,view_x,view_y,view_z"]
    folder.mkdir()
    for number, image in enumerate(images()):
        write_image(folder / f"{number:03d}.exr", image.transpose(1, 2, 0))
        lines.append(",".join([f"{number:03d}.exr", *(f"{value:.9f}" for value in (*LIGHT[number], *VIEW[number]))]))
    (folder / "manifest.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def test_the_command_line_tells_the_outcome(tmp_path, capsys):
    config, data = tmp_path / "auto.toml", photographs(tmp_path / "data")
    config.write_text('model = "auto"\ngeometry = "flat"\n[target]\npsnr = 25.0\n', "utf-8")
    arguments = ["fit", str(config), "--data", str(data), "--no-pictures", "--out"]
    assert main([*arguments, str(tmp_path / "met"), "--set", "target.psnr=35"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("target met: texture, 3 bytes a texel") and "decisions.txt" in said
    assert main([*arguments, str(tmp_path / "short"), "--set", "target.psnr=90"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("TARGET NOT MET, BY ") and "| stopped because" in said
    assert tm.load_material(tmp_path / "short").size == (8, 8)
    assert main([*arguments, str(tmp_path / "none"), "--set", "target.bytes=0.001"]) == 2
    assert "bytes must hold a material" in capsys.readouterr().err and not (tmp_path / "none").exists()
