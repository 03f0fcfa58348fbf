"""Commands on an object that does not fill its photographs: a mask by a file, a guess, or none."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.btf.files import put_image
from tests.geometry.test_masked import sphere_cap

from torchmat import load_btf, load_material
from torchmat.cli import main
from torchmat.images import read_image
from torchmat.report.html import fit_page
from torchmat.report.pictures import mask_picture

SIZE = 32


def run(*arguments):
    return main([str(argument) for argument in arguments])


@pytest.fixture
def capture(tmp_path):
    """Photographs of a cap on a dark table, as linear EXR, with their lights; and the cap's mask as a file."""
    images, light, inside, _, _ = sphere_cap(SIZE)
    for number, image in enumerate(images):
        put_image(tmp_path / "d" / f"{number:02d}.exr", image.permute(1, 2, 0).numpy().astype(np.float32))
    np.savetxt(tmp_path / "d" / "light_directions.txt", light)
    put_image(tmp_path / "object.png", (inside.numpy() * 255).astype(np.uint8)[:, :, None])
    return tmp_path, inside


def test_geometry_with_a_mask(capture, capsys):
    folder, inside = capture
    spans = {}
    for name, mask in (("with", folder / "object.png"), ("without", "none")):
        assert run("geometry", folder / "d", "--mask", mask, "--out", folder / name, "--depth", "float") == 0
        record = json.loads((folder / name / "relief.json").read_text())
        spans[name] = record["height_high"] - record["height_low"]
        assert ("object" in record["provenance"]) == (name == "with")
        assert (folder / name / "object_mask.png").exists() == (name == "with")
    said = capsys.readouterr().out
    share = 100 * float(inside.double().mean())
    assert f"{share:.1f} % of the texels are the object" in said
    assert json.loads((folder / "with" / "relief.json").read_text())["provenance"]["object"] == {
        "mask": str(folder / "object.png"), "texels": int(inside.sum()), "share": float(inside.double().mean()),
    }
    height = read_image(folder / "with" / "height.exr")[:, :, 0]
    assert set(height[~inside.numpy()].tolist()) == {float(height[inside.numpy()].min())}
    assert spans["with"] < spans["without"]


def test_a_guess_is_suggested_and_said(capture, capsys):
    folder, inside = capture
    assert run("info", folder / "d", "--no-plot") == 0
    assert "of the border is dark in all photographs" in capsys.readouterr().out
    assert run("info", folder / "d", "--no-plot", "--mask", "background") == 0
    said = capsys.readouterr().out
    assert "the mask is a guess" in said and f"{100 * float(inside.double().mean()):.1f} % of the texels, by the background" in said


def test_a_fit_with_a_mask_and_its_report(capture, capsys):
    folder, inside = capture
    assert run("fit", "lambert", "--data", folder / "d", "--mask", folder / "object.png", "--out", folder / "m", "--no-pictures") == 0
    report = json.loads((folder / "m" / "report.json").read_text())
    assert report["source"]["object"]["texels"] == int(inside.sum())
    assert report["data"]["mask"] == str(folder / "object.png")
    assert f"of the texels, by {folder / 'object.png'}" in fit_page(report, [])
    material = load_material(folder / "m")
    assert torch.equal(material.maps["opacity"][0] == 1, inside) and set(material.maps["opacity"].unique().tolist()) == {0, 1}
    assert run("fit", "--again", folder / "m", "--out", folder / "again", "--no-pictures") == 0
    assert (folder / "again" / "diffuse.exr").exists() == (folder / "m" / "diffuse.exr").exists()
    for texture in folder.glob("m/*.exr"):
        assert texture.read_bytes() == (folder / "again" / texture.name).read_bytes()


def test_the_picture_of_a_mask_dims_what_is_outside(capture):
    folder, _ = capture
    assert mask_picture(load_btf(folder / "d", cache=False), folder / "none.png") is None
    path = mask_picture(load_btf(folder / "d", mask=folder / "object.png", cache=False), folder / "mask.png")
    pixels = read_image(path)[:, :, :3].astype(float)
    rows, columns = pixels.shape[:2]
    red = pixels[..., 0] - pixels[..., 1]
    assert red[rows // 2, columns // 2] == 0 and red[rows - 15, 15] > 40  # the cap is grey, the table reddish


def test_masks_that_cannot_be_used(capture, capsys):
    folder, _ = capture
    assert run("fit", "ptm", "--data", folder / "d", "--mask", folder / "objet.png") != 0
    assert "Did you mean" in capsys.readouterr().err
    assert run("geometry", folder / "d", "--mask", folder / "object.png", "--integration", "fourier", "--out", folder / "f") != 0
    assert "integration must be 'poisson' with an object mask" in capsys.readouterr().err
    put_image(folder / "small.png", np.full((4, 4, 1), 255, np.uint8))
    assert run("compare", folder / "d", "--models", "ptm", "--mask", folder / "small.png", "--out", folder / "c") != 0
    assert "it is 4 x 4 and they are 32 x 32" in capsys.readouterr().err
