"""Images that are never fitted, measured beside those held out."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.btf.files import put_image
from tests.support import all_pairs, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, FitConfig, RangeError, ShapeError
from torchmat.errors import NotMeasuredError
from torchmat.many.jobs import Job
from torchmat.report.html import fit_page
from torchmat.report.tables import fit_tables, to_json

LIGHT, VIEW = all_pairs(hemisphere(), hemisphere(((0, 1), (60, 3))))
OFF_LIGHT, OFF_VIEW = all_pairs(hemisphere(((20, 3), (40, 4))), hemisphere(((10, 1), (45, 3))))


def made(light, view, height=6, width=5, **keywords):
    return Btf.from_tensors(plausible_images(light, view, height, width).astype(np.float32), light, view, **keywords)


@pytest.fixture(scope="module")
def btf():
    return made(LIGHT, VIEW)


@pytest.fixture(scope="module")
def other():
    return made(OFF_LIGHT, OFF_VIEW)


def test_they_are_measured_as_held_out_samples_are_and_change_nothing_else(btf, other):
    result, alone = tm.fit(btf, "hsh", test=other), tm.fit(btf, "hsh")
    report = result.report
    for part, material in (("test", result.material), ("test_after_export", result.material.as_exported())):
        assert report[part] == tm.evaluate(material, other, torch.arange(len(other))).report
        assert report[part].keys() == report["held_out"].keys()
    assert report["test_source"] == {"path": "memory", "kind": "tensors", "samples": len(other), "pairs_in_data": 0}
    assert report["held_out"] == alone.report["held_out"] and "test" not in alone.report
    assert all(torch.equal(value, alone.material.maps[name]) for name, value in result.material.maps.items())


def test_tables_and_the_page_say_it(btf, other):
    report = tm.fit(btf, "ptm", test=other).report
    text = fit_tables(report)
    assert "test after export" in text and f"measured on, test  {len(other)} images".split()[-2] in text
    page = fit_page(json.loads(to_json(report)), [])
    assert "test photographs, none of the data" in page and f"{len(other)} photographs from memory" in page


def test_pairs_that_the_data_has_too_are_counted_and_said(btf):
    light, view = np.concatenate([OFF_LIGHT, LIGHT[:5]]), np.concatenate([OFF_VIEW, VIEW[:5]])
    report = tm.fit(btf, "texture", test=made(light, view)).report
    assert report["test_source"]["pairs_in_data"] == 5
    assert "the data has the pair of light and view of 5 of them too" in fit_page(json.loads(to_json(report)), [])


def test_another_size_and_the_data_itself_are_refused(btf):
    with pytest.raises(ShapeError, match="memory: the test images must have the size of the data; it has 6 x 4 and memory 6 x 5"):
        tm.fit(btf, "texture", test=made(OFF_LIGHT, OFF_VIEW, 6, 4))
    for same in (btf, made(LIGHT, VIEW)):
        with pytest.raises(RangeError, match="the test images must be others than the data"):
            tm.fit(btf, "texture", test=same)
    with pytest.raises(RangeError, match="be others than the data"):
        tm.fit(btf.masked(torch.arange(30).reshape(6, 5) > 9), "texture", test=btf)


def test_few_or_none_are_measured_where_that_is_asked_for(btf, other, monkeypatch):
    import importlib

    monkeypatch.setattr(importlib.import_module("torchmat.fitting.evaluate"), "QUICK_TEXELS", 9 * 30)
    assert tm.fit(btf, "texture", test=other, measure="quick").report["test"]["samples"] == 9
    report = tm.fit(btf, "texture", test=other, measure="none").report
    with pytest.raises(NotMeasuredError, match="measure='none'"):
        report["test"]["psnr_db"]
    assert json.loads(to_json(report))["test"] is None


def test_the_mask_of_the_object_holds_for_them(btf, other):
    mask = torch.ones(6, 5, dtype=torch.bool)
    mask[:, 2:] = False
    found = tm.fit(btf.masked(mask), "texture", test=other).report["test"]
    # What is outside of the object counts nowhere: the errors are those of a test that shows the object alone.
    left = tm.fit(btf.window(0, 0, 6, 2), "texture", test=other.window(0, 0, 6, 2)).report["test"]
    assert found["relative_error"] == pytest.approx(left["relative_error"], rel=1e-5)


def test_a_material_that_descends_is_tested_too(btf, other):
    start = tm.fit(btf, "lambert").material
    report = tm.fit(btf, start, solver="adam", steps=2, test=other).report
    assert report["test"]["samples"] == len(other)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Two folders of photographs of one texture, and their folder."""
    folder = tmp_path_factory.mktemp("data")
    for name, (light, view) in {"grid": (LIGHT, VIEW), "off": (OFF_LIGHT, OFF_VIEW)}.items():
        (folder / name).mkdir()
        rows = ["file,view_x,view_y,view_z,light_x,light_y,light_z"]
        images = plausible_images(light, view, 6, 5)
        for k, image in enumerate(images):
            code = (np.clip(image, 0, 1) ** (1 / 2.2) * 250).round().astype(np.uint8)
            put_image(folder / name / f"{k:03d}.png", code.transpose(1, 2, 0))
            rows.append(",".join([f"{k:03d}.png", *(f"{x:.9f}" for x in (*view[k], *light[k]))]))
        (folder / name / "manifest.csv").write_text("\n".join(rows))
    return folder


def test_a_path_is_read_as_the_data_is(written, tmp_path):
    btf = tm.load_btf(written / "grid", exposure=2.0, cache=False)
    config = FitConfig("texture", data={"exposure": 2.0, "lights": list(range(8))})
    report = tm.fit(btf, config, test=written / "off").report
    read = tm.load_btf(written / "off", exposure=2.0, cache=False)
    wanted = tm.evaluate(tm.fit(btf, config).material, read, torch.arange(len(read))).report
    assert report["test"] == wanted and report["test_source"]["path"] == str(written / "off")
    (tmp_path / "a.toml").write_text(f'model = "texture"\ntest = {str(written / "off")!r}\n[data]\nexposure = 2.0\n')
    assert tm.fit(btf, tmp_path / "a.toml").report["test"] == wanted


def test_a_job_is_finished_when_it_was_tested_as_is_asked(written, tmp_path):
    config = FitConfig("texture", test=str(written / "off"))
    report = tm.fit(tm.load_btf(written / "grid", cache=False), config).report
    (tmp_path / "report.json").write_text(to_json(report))
    assert Job(written / "grid", config, tmp_path).finished() is not None
    assert Job(written / "grid", FitConfig("texture"), tmp_path).finished() is None
    assert Job(written / "grid", FitConfig("texture", test="elsewhere"), tmp_path).finished() is None


def test_the_command_line_tests_and_repeats_it(written, tmp_path, capsys):
    from torchmat.cli import main

    out = tmp_path / "out"
    arguments = ["fit", "texture", str(written / "grid"), "--test", str(written / "off"), "--no-pictures", "--no-cache"]
    assert main([*arguments, "--out", str(out)]) == 0
    assert "test after export" in capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    assert report["run"]["config"]["test"] == str(written / "off") and str(written / "off") in report["run"]["files"]
    assert main(["fit", "--again", str(out), "--out", str(tmp_path / "again"), "--no-pictures", "--no-cache"]) == 0
    assert json.loads((tmp_path / "again" / "report.json").read_text())["test"] == report["test"]
    assert main([*arguments[:3], "--test", str(tmp_path / "nowhere"), "--out", str(out)]) == 2
    assert "nowhere: the path must exist" in capsys.readouterr().err
