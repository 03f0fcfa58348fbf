"""Files of RTI programs: decoded by their descriptions, read back, written again with the same codes, refused where they lie."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.material_io.rti_decoders import harmonics, lit_ptm, lit_relight, lit_rti, relight_polynomial
from tests.models.distributions import distribution
from tests.models.examples import make

import torchmat as tm
from torchmat import DataError, RangeError, colour
from torchmat.images import read_image
from torchmat.report.describe import describe_material, is_material

LIGHTS = ((0.0, 0.0), (0.6, 0.1), (-0.3, 0.7), (-0.5, -0.55))
DECODERS = {"ptm": lit_ptm, "rti": lit_rti, "relight": lit_relight, "openlime": lit_relight}
NATIVE = [
    ("ptm", "ptm", {}, {}), ("ptm", "lptm", {}, {}), ("rti", "hsh", {"terms": 4}, {}), ("rti", "hsh", {"terms": 9}, {}),
    ("rti", "hsh", {"terms": 16}, {}),
    ("relight", "ptm", {}, {"image": "png"}), ("relight", "lptm", {}, {"image": "png"}),
    ("relight", "hsh", {"terms": 4}, {"image": "png"}), ("relight", "hsh", {"terms": 9}, {"image": "png"}),
    ("openlime", "hsh", {"terms": 9}, {"image": "png"}),
]
IDS = ["-".join((form, model, *map(str, options.values()))) for form, model, options, _ in NATIVE]


def material_of(model, options, seed=0):
    return make(model, {**options, "space": "srgb"}, 5, 7, torch.float32, seed=seed)


def target_of(folder, form, name="m"):
    return folder / (f"{name}.{form}" if form in ("ptm", "rti") else name)


def shown(material, x, y):
    light = torch.tensor([x, y, (1 - x * x - y * y) ** 0.5])[:, None, None]
    with torch.no_grad():
        linear = material.shade(light, torch.tensor([0.0, 0, 1])[:, None, None])
    return colour.linear_to_srgb(linear).permute(1, 2, 0).numpy()


def codes_of(path):
    if path.is_dir():
        return {file.name: read_image(file).tobytes() for file in path.glob("plane_*")}
    return path.read_bytes()


@pytest.mark.parametrize(("form", "model", "options", "asked"), NATIVE, ids=IDS)
def test_the_decoder_of_the_description_sees_the_material(form, model, options, asked, tmp_path):
    material, target = material_of(model, options), target_of(tmp_path, form)
    losses = tm.export(material, target, form, **asked)
    found = tm.load_material(target)
    assert found.name == model and found.size == (5, 7) and found.options["space"] == "srgb"
    for x, y in LIGHTS:
        decoded = np.clip(DECODERS[form](target, x, y), 0, None)
        assert np.abs(decoded - shown(found, x, y)).max() < 2e-5
        # Each coefficient is half a step of its range off at most.
        assert np.abs(decoded - shown(material, x, y)).max() < 0.02
    assert set(losses.approximated) == {"coefficients"} and losses.lost == {} and losses.exact == ()
    assert losses.approximated["coefficients"].startswith("8 bits: shading under 24 lights ")


@pytest.mark.parametrize(("form", "model", "options", "asked"), NATIVE, ids=IDS)
def test_what_was_read_is_written_with_the_same_codes(form, model, options, asked, tmp_path):
    first, second = target_of(tmp_path, form), target_of(tmp_path, form, "again")
    tm.export(material_of(model, options), first, form, **asked)
    found = tm.load_material(first)
    assert tm.export(found, second, form, **asked) == tm.Losses(exact=("coefficients",))
    assert codes_of(second) == codes_of(first)
    kept = tm.load_material(tm.save_material(found, tmp_path / "folder"))
    tm.export(kept, target_of(tmp_path, form, "third"), form, **asked)
    assert codes_of(target_of(tmp_path, form, "third")) == codes_of(first)


@pytest.mark.parametrize(("form", "model"), [("ptm", "ptm"), ("ptm", "lptm"), ("rti", "hsh")])
def test_from_one_program_to_another_and_back(form, model, tmp_path):
    tm.export(material_of(model, {}), tmp_path / f"a.{form}")
    tm.export(tm.load_material(tmp_path / f"a.{form}"), tmp_path / "planes", "relight", image="png")
    tm.export(tm.load_material(tmp_path / "planes"), tmp_path / f"b.{form}")
    assert (tmp_path / f"b.{form}").read_bytes() == (tmp_path / f"a.{form}").read_bytes()


def test_a_changed_material_gets_ranges_of_its_own(tmp_path):
    tm.export(material_of("ptm", {}), tmp_path / "a.ptm")
    found = tm.load_material(tmp_path / "a.ptm")
    brighter = found.with_maps(polynomial=found.maps["polynomial"].detach() * 3)
    losses = tm.export(brighter, tmp_path / "b.ptm")
    assert "coefficients" in losses.approximated
    assert np.abs(shown(tm.load_material(tmp_path / "b.ptm"), 0.3, 0.2) - shown(brighter, 0.3, 0.2)).max() < 0.05


def test_bytes_by_hand(tmp_path):
    head = b"PTM_1.2\nPTM_FORMAT_LRGB\n1\n2\n1 1 1 1 1 2.0\n0 0 0 5 0 55 \n"
    bottom, top = bytes((0, 0, 0, 0, 0, 100)), bytes((0, 0, 0, 105, 0, 80))
    (tmp_path / "a.ptm").write_bytes(head + bottom + top + bytes((255, 0, 51, 0, 255, 0)))
    found = tm.load_material(tmp_path / "a.ptm")
    # The first row of the file is the lowest: luminance 2 (100 - 55), red and a fifth blue.
    assert np.allclose(shown(found, 0.0, 0.0)[1, 0] * 255, (90, 0, 18), atol=1e-2)
    assert np.allclose(shown(found, 0.5, 0.0)[1, 0] * 255, (87.5, 0, 17.5), atol=1e-2)
    assert np.allclose(shown(found, 0.5, 0.0)[0, 0] * 255, (0, 100, 0), atol=1e-2)
    older = head.replace(b"PTM_1.2", b"PTM_1.1") + bottom + bytes((255, 0, 51)) + top + bytes((0, 255, 0))
    (tmp_path / "b").write_bytes(older)  # known by its start, whatever its name
    assert torch.equal(tm.load_material(tmp_path / "b").maps["luminance"], found.maps["luminance"])


def test_others_are_fitted_and_what_is_lost_is_said(tmp_path):
    material = distribution(6, 5, 1, ("normal",), relief=True)
    losses = tm.export(material, tmp_path / "m", "relight")
    assert set(losses.lost) >= {"view", "height"} and losses.exact == ()
    said = "fitted as hsh to 128 lights in codes of a screen, 8 bits, JPEG of quality 98: "
    assert losses.approximated["coefficients"].startswith(said)
    matte = make("lambert", {}, 5, 7, torch.float32)
    losses = tm.export(matte, tmp_path / "a.ptm", colours="lrgb")
    assert losses.lost == {} and b"PTM_FORMAT_LRGB" in (tmp_path / "a.ptm").read_bytes()[:40]
    losses = tm.export(make("ptm", {"space": "linear"}, 5, 7, torch.float32), tmp_path / "b.ptm")
    assert losses.approximated["coefficients"].startswith("fitted as ptm to 128 lights")


def test_a_fit_is_the_least_squares_one(tmp_path):
    """A sum of codes is found again by the fit of another material that shows it: here of a hsh, in linear light."""
    source = material_of("hsh", {"terms": 4})
    with torch.no_grad():
        harmonic = source.maps["harmonic"]
        source = source.with_maps(harmonic=torch.cat((harmonic[:3] + 2, 0.2 * harmonic[3:])))
    # Its 4 harmonics are among the 9 that it is fitted with.
    tm.export(source, tmp_path / "a.rti", terms=9)
    for x, y in LIGHTS:
        assert np.abs(lit_rti(tmp_path / "a.rti", x, y) - shown(source, x, y)).max() < 0.02


@pytest.mark.skipif(shutil.which("node") is None, reason="the page is evaluated by node, which is not here")
def test_the_page_weighs_as_the_description_says(tmp_path):
    tm.export(material_of("hsh", {"terms": 9}), tmp_path / "m", "openlime")
    page = (tmp_path / "m" / "index.html").read_text("utf-8")
    assert page.count("data:image/jpeg;base64,") == 9 and "/*" not in page.split("</style>")[1].split("PLANES")[0]
    script = page.split("<script>")[1].split("</script>")[0] + """
    ;const lrgb = {type: "ptm", colorspace: "lrgb", nplanes: 9};
    console.log(JSON.stringify([weights(INFO, 0.3, -0.5), weights(lrgb, 0.3, -0.5), lightAt(0, -3)]))"""
    done = subprocess.run(["node", "-"], input=script, capture_output=True, text=True, check=True, timeout=60)
    found = json.loads(done.stdout)
    assert np.allclose(found[0], harmonics(0.3, -0.5)[:9]) and np.allclose(found[1], relight_polynomial(0.3, -0.5))
    assert np.allclose(found[2], (0, -0.995))


def test_info_and_other_names(tmp_path):
    tm.export(material_of("ptm", {}), tmp_path / "m", "relight", image="png")
    assert is_material(tmp_path / "m") and is_material(tmp_path / "m" / "info.json")
    text = describe_material(tmp_path / "m")
    assert "ptm" in text and "code_range=18 entries" in text and "5 x 7 texels" in text
    assert tm.load_material(tmp_path / "m" / "info.json").size == (5, 7)


def test_code_ranges_are_checked():
    maps = {"polynomial": torch.zeros(18, 1, 1)}
    with pytest.raises(RangeError, match="code_range must hold 18 pairs of finite numbers"):
        tm.models.Ptm(maps, space="srgb", code_range=[[0, 1]])


HEAD = b"PTM_1.2\nPTM_FORMAT_RGB\n1\n1\n1 1 1 1 1 1\n0 0 0 0 0 0\n"
RTI_HEAD = b"#HSH1.2\n3\n1 1 3\n4 2 1\n" + np.ones(8, "<f4").tobytes()


@pytest.mark.parametrize(("name", "data", "words"), [
    ("a.ptm", b"", "the head must begin with PTM_1.2 and a format"),
    ("a.ptm", b"\x89PNG\r\n\x1a\n", "the head must begin with PTM_1.2"),
    ("a.ptm", HEAD, "the PTM must have the size that its head says; 1 x 1 x 18 are 18 bytes and 0 follow the head"),
    ("a.ptm", HEAD + bytes(19), "18 bytes and 19 follow the head"),
    ("a.ptm", HEAD.replace(b"_RGB", b"_JPEG_RGB") + bytes(18), "it is PTM_1.2, PTM_FORMAT_JPEG_RGB.*Save it uncompressed"),
    ("a.ptm", HEAD.replace(b"1 1 1 1 1 1", b"1 1 0 1 1 1") + bytes(18), "biases must be finite, and scales not 0"),
    ("a.ptm", HEAD.replace(b"1 1 1 1 1 1", b"1 1 e 1 1 1") + bytes(18), "scales and biases must be finite"),
    ("a.ptm", HEAD.replace(b"1\n1\n1", b"999999999\n999999999\n1") + bytes(18), "follow the head"),
    ("a.ptm", HEAD[:40], "must be width, height, six scales and six biases"),
    ("a.rti", b"", "the head must begin with #HSH1.2"),
    ("a.rti", RTI_HEAD, "the RTI must have the size that its head says"),
    ("a.rti", RTI_HEAD.replace(b"\n3\n", b"\n1\n") + bytes(12), "the head says kind 1, 3 colours, 4 terms of 1 bytes"),
    ("a.rti", RTI_HEAD.replace(b"4 2 1", b"5 2 1") + bytes(12), "4, 9, 16 terms of 1 byte"),
    ("a.rti", RTI_HEAD[:22] + b"\0\0\xc0\x7f" + RTI_HEAD[26:] + bytes(12), "scales and offsets must be finite"),
    ("a.rti", RTI_HEAD[:22] + b"\1\0\xa0\x7f" + RTI_HEAD[26:] + bytes(12), "scales and offsets must be finite"),  # it signals
])
def test_files_that_lie(name, data, words, tmp_path):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(DataError, match=words) as caught:
        tm.load_material(tmp_path / name)
    assert name in str(caught.value)


def good_info(folder: Path) -> dict:
    tm.export(material_of("ptm", {}), folder, "relight", image="png")
    return json.loads((folder / "info.json").read_text())


@pytest.mark.parametrize(("change", "words"), [
    ({"type": "rbf"}, "the basis must be ptm of 6 terms, or hsh of 4 or 9.*it is 'rbf', 'rgb' with 18 planes"),
    ({"type": ["ptm"]}, "the basis must be"), ({"colorspace": "mycc"}, "the basis must be"),
    ({"nplanes": 3e9}, "the basis must be"), ({"width": 0}, "height and width must lie in 1 to 65535"),
    ({"width": 8}, r"plane_0.png: the plane must be \(5, 8, 3\)"), ({"materials": []}, "materials must be one; there are 0"),
    ({"materials": 3}, "must hold a scale and a bias for each plane"),
    ({"materials": [{"scale": [1] * 17, "bias": [0] * 18}]}, "must be 18 finite numbers each"),
    ({"materials": [{"scale": [0] * 18, "bias": [0] * 18}]}, "scales not 0"),
])
def test_descriptions_that_lie(change, words, tmp_path):
    info = good_info(tmp_path / "m") | change
    (tmp_path / "m" / "info.json").write_text(json.dumps(info))
    with pytest.raises(DataError, match=words):
        tm.load_material(tmp_path / "m")


def test_a_plane_that_is_missing_and_options_that_are_wrong(tmp_path):
    good_info(tmp_path / "m")
    (tmp_path / "m" / "plane_3.png").unlink()
    with pytest.raises(DataError, match="plane_3.jpg: the plane must exist; it is not there. .*cut into tiles"):
        tm.load_material(tmp_path / "m")
    for form, wrong, words in (
        ("relight", {"image": "gif"}, "image must be one of jpg, png"),
        ("relight", {"quality": 0}, "quality must be a whole number"),
        ("relight", {"model": "pca"}, "model must be one of"), ("ptm", {"colours": "cmy"}, "colours must be a known form"),
        ("rti", {"terms": 5}, "terms must be those of a band"),
    ):
        with pytest.raises(RangeError, match=words):
            tm.export(material_of("ptm", {}), target_of(tmp_path, form, "new"), form, **wrong)
    assert [path.name for path in tmp_path.iterdir()] == ["m"]
