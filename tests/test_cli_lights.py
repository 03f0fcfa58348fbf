"""Commands on photographs under one view: which has which light, how well the lights explain them, and a chrome ball."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from tests.btf.files import put_image
from tests.btf.test_lambert import LAMPS, LIGHT, dome, srgb_encoded
from tests.btf.test_lighting import CIRCLE, put_ball, put_lp

from torchmat import load_btf
from torchmat.cli import main
from torchmat.images import read_image


def run(*arguments):
    return main([str(argument) for argument in arguments])


def put_photographs(folder, images=None, encode=srgb_encoded):
    for number, image in enumerate(dome() if images is None else images):
        put_image(folder / f"photo.{number}.png", np.rint(encode(image.transpose(1, 2, 0)) * 65535).astype(np.uint16))
    return folder


@pytest.fixture
def lights(tmp_path):
    np.savetxt(tmp_path / "lights.txt", LIGHT)
    return tmp_path / "lights.txt"


def test_geometry_says_the_pairs_and_the_residual(tmp_path, lights, capsys):
    folder = put_photographs(tmp_path / "d")
    assert run("geometry", folder, "--lights", lights, "--out", tmp_path / "out") == 0
    said = capsys.readouterr().out
    assert "light of   photo.2.png" in said and "light of   photo.11.png" in said and "photo.7.png" not in said
    assert "14 photographs in all" in said and "Lambert    residual 0.0" in said and "(good" in said
    assert "taken to be equally bright" in said and "warning" not in said
    kept = json.loads((tmp_path / "out" / "relief.json").read_text("utf-8"))["provenance"]
    assert list(kept["lights"]) == [f"photo.{number}.png" for number in range(14)]
    assert kept["lights"]["photo.10.png"] == pytest.approx(LIGHT[10], abs=1e-5)
    assert kept["lambert"]["residual"] < 0.02
    assert run("info", folder, "--lights", lights, "--verbose", "--no-plot") == 0
    assert capsys.readouterr().out.count("light of ") == 14


def test_geometry_estimates_intensities_and_warns_of_the_encoding(tmp_path, lights, capsys):
    folder = put_photographs(tmp_path / "lamps", dome() * LAMPS[:, :, None, None] / 2)
    for name, more in (("a", ()), ("b", ("--intensities", "none"))):
        assert run("geometry", folder, "--lights", lights, "--out", tmp_path / name, "--depth", "float", *more) == 0
    said = capsys.readouterr().out
    assert "intensities of the lights are estimated" in said and "seem not to be equally bright" in said
    plain = put_photographs(tmp_path / "plain")
    assert run("geometry", plain, "--lights", lights, "--out", tmp_path / "c", "--depth", "float") == 0
    truth, found, off = (read_image(tmp_path / name / "normal_gl.exr") for name in "cab")
    assert np.abs(found - truth).max() < 0.02 < np.abs(off - truth).max()
    linear = put_photographs(tmp_path / "linear", encode=lambda values: values)
    capsys.readouterr()
    assert run("geometry", linear, "--lights", lights, "--out", tmp_path / "e") == 0
    assert "if they are linear, say --encoding linear" in capsys.readouterr().out


def test_fit_and_compare_take_lights_and_intensities(tmp_path, lights, capsys):
    folder = put_photographs(tmp_path / "d", dome() * LAMPS[:, :, None, None] / 2)
    np.savetxt(tmp_path / "lamps.txt", LAMPS / 2)
    given = ("--lights", lights, "--intensities", tmp_path / "lamps.txt")
    assert run("fit", "lambert", "--data", folder, "--out", tmp_path / "out", "--no-pictures", *given) == 0
    assert "Lambert residual" in capsys.readouterr().out
    report = json.loads((tmp_path / "out" / "report.json").read_text("utf-8"))
    assert report["held_out"]["relative_error"] < 0.01 and report["lambert_residual"]["residual"] < 0.02
    assert report["data"]["light_table"] == str(lights) and len(report["source"]["lights_of"]) == 14
    more = ("--no-pictures", "--lights", lights, "--measure", "none")
    assert run("fit", "lambert", "--data", folder, "--out", tmp_path / "not", *more) == 0
    assert json.loads((tmp_path / "not" / "report.json").read_text("utf-8"))["held_out"] is None
    code = run("compare", folder, "--models", "texture", "lambert", "--out", tmp_path / "rows", "--measure", "quick", *given)
    said = capsys.readouterr().out
    assert code == 0 and "light of   photo.2.png" in said and "Lambert    residual" in said


def test_lights_of_a_ball_are_written_for_again(tmp_path, capsys):
    folder, ball = put_photographs(tmp_path / "d"), put_ball(tmp_path / "ball", LIGHT)
    given = ("--ball", ball, "--circle", *CIRCLE)
    assert run("geometry", folder, *given, "--write-lights", tmp_path / "ball.lp", "--out", tmp_path / "out") == 0
    assert read_image(tmp_path / "out" / "ball.png").shape[0] > 100 and read_image(tmp_path / "ball.png").shape[0] > 100
    by_ball, again = load_btf(folder, ball=ball, circle=CIRCLE), load_btf(folder, light_table=tmp_path / "ball.lp")
    assert again.source.files == by_ball.source.files
    assert float((again.light - by_ball.light).abs().max()) < 1e-6
    assert run("info", folder, *given, "--no-plot", "--write-lights", tmp_path / "ball.lp") == 2
    assert "ball.lp: the file must be a new one; it is there already" in capsys.readouterr().err
    assert run("geometry", folder, "--ball", ball, "--circle", 40, 24, 12, "--out", tmp_path / "wrong") == 2
    assert re.search(r"ball \d+.png", capsys.readouterr().err) and not (tmp_path / "wrong").exists()
    assert run("info", folder, *given, "--no-plot", "--write-lights", tmp_path / "new" / "x.lp") == 0
    assert (tmp_path / "new" / "x.lp").read_bytes() == (tmp_path / "ball.lp").read_bytes()


def test_bad_lights_are_skipped_on_request(tmp_path, capsys):
    folder = put_photographs(tmp_path / "d")
    light = LIGHT.copy()
    light[3, 2] *= -1
    put_lp(folder / "x.lp", [f"photo.{number}.png" for number in range(14)], light)
    assert run("info", folder, "--no-plot") == 2
    assert "--skip-bad-lights" in capsys.readouterr().err
    assert run("info", folder, "--no-plot", "--skip-bad-lights") == 0
    said = capsys.readouterr().out
    assert "note       1 of 14 photographs are skipped, whose lights are below the surface, first photo.3.png" in said
