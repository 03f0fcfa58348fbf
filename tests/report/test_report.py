"""Tables, pages, and the folders that hold them."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from tests.report.reading import Reading
from tests.support import all_pairs, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, DataError, RangeError
from torchmat.report import compare, write_comparison, write_fit
from torchmat.report.comparison import parse_model
from torchmat.report.describe import describe_btf, describe_material, is_material
from torchmat.report.pictures import directions_picture
from torchmat.report.tables import COMPARE_COLUMNS, comparison_table, error_table, number, stopped_text, text_table, to_json

LIGHT, VIEW = all_pairs(hemisphere(), hemisphere(((0, 1), (60, 3))))

VIEWER = 2  # scripts of the material that moves: its data, and what shows it


@pytest.fixture(scope="module")
def btf():
    return Btf.from_tensors(plausible_images(LIGHT, VIEW, 8, 9).astype(np.float32), LIGHT, VIEW)


def assert_self_contained(page, scripts=0):
    """Nothing is fetched: pictures are in the page, links lead to files beside it, scripts are its own."""
    read = Reading(page)
    assert all(image["src"].startswith("data:image/png;base64,") for image in read.of("img"))
    assert all(re.fullmatch(r"[\w.%-]+", link["href"]) for link in read.of("a")) and read.of("link") == []
    assert [script.get("src") for script in read.of("script")] == [None] * scripts
    assert not re.search(r"https?://|file://|@import|url\(", page)


def write_together(btf, folder, **settings):
    return write_fit(btf, tm.fit(btf, "ptm", **settings), folder)


def test_a_fit_is_written_whole(btf, tmp_path):
    folder = write_together(btf, tmp_path / "Stoff & <Wolle>")
    names = {path.name for path in folder.iterdir()}
    assert {"manifest.json", "report.json", "report.html", "pictures", "polynomial_1.exr"} <= names
    report = json.loads((folder / "report.json").read_text("utf-8"))
    assert report["model"] == "ptm" and report["held_out"]["samples"] > 0
    pictures = {path.name for path in (folder / "pictures").iterdir()}
    drawn = {"comparison", "error_by_angle", "sphere", "directions", "maps", "hemisphere"}  # coverage is the same everywhere
    assert pictures == {f"{name}.png" for name in drawn}
    page = (folder / "report.html").read_text("utf-8")
    assert_self_contained(page, VIEWER)
    assert number(report["held_out"]["relative_error"]) in page
    provenance = json.loads((folder / "manifest.json").read_text("utf-8"))["provenance"]
    assert provenance["seed"] == 0 and provenance["options"] == report["options"]
    assert write_together(btf, folder, seed=1) == folder  # an earlier fit is replaced
    assert json.loads((folder / "report.json").read_text("utf-8"))["seed"] == 1


def test_a_fit_that_did_not_end_well_says_so():
    assert stopped_text({"stop_reason": "step limit", "figures": {"solver_steps": 9}}) == ""
    assert stopped_text({"stop_reason": "diverged", "figures": {"solver_steps": 640}}).startswith(
        "the fit diverged after 640 steps: this is the best it had met before, not a finished one"
    )
    assert stopped_text({"stop_reason": "not finite", "figures": {}}).startswith("the fit met values that are not finite: ")
    choice = {"auto": {"chosen": {"fit_stopped": "diverged"}}, "steps": 3}
    assert stopped_text({"stop_reason": "target met", "figures": choice}).startswith("the fit diverged after 3 steps")
    back = {"geometry": {"fell_back": "the fit on the relief ended (diverged) at 20 dB"}}
    assert stopped_text({"stop_reason": "step limit", "figures": back}) == f"{back['geometry']['fell_back']}: the surface is flat"


def test_the_page_warns_of_a_fit_that_diverged(btf, tmp_path):
    result = tm.fit(btf, "texture")
    result = replace(result, report={**result.report, "stop_reason": "diverged"})
    page = (write_fit(btf, result, tmp_path / "out") / "report.html").read_text("utf-8")
    assert "The fit diverged: this is the best it had met before" in page


def test_without_pictures_only_the_material_and_the_report(btf, tmp_path):
    folder = write_fit(btf, tm.fit(btf, "texture"), tmp_path / "out", pictures=False)
    assert {path.name for path in folder.iterdir()} == {"manifest.json", "report.json", "albedo.exr"}


@pytest.mark.parametrize("settings", [{"holdout": 0}, {"measure": False}], ids=["all used", "not measured"])
def test_what_was_not_held_out_or_measured_is_left_out(btf, tmp_path, settings):
    folder = write_together(btf, tmp_path / "out", **settings)
    assert json.loads((folder / "report.json").read_text("utf-8"))["held_out"] is None
    assert_self_contained((folder / "report.html").read_text("utf-8"), VIEWER)


@pytest.mark.parametrize("path", ["file/plot.png", "plot.nothing"])
def test_a_picture_that_cannot_be_written_is_named(btf, tmp_path, path):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    with pytest.raises(DataError, match=r"the picture must be writable"):
        directions_picture(btf, tmp_path / path)


# Comparisons


def test_a_row_holds_error_bytes_and_seconds(btf):
    rows = compare(btf, ["texture", "hsh:terms=4,storage=png8"], progress=False)
    assert [row["model"] for row in rows] == ["texture", "hsh:terms=4,storage=png8"]
    for row in rows:
        report = row["report"]
        assert row["failed"] is None and row["relative_error"] == report["held_out"]["relative_error"]
        assert row["relative_error_after_export"] == report["held_out_after_export"]["relative_error"]
        assert [row["relative_error_low"], row["relative_error_high"]] == report["held_out"]["relative_error_interval"]
        assert f"{number(row['relative_error_low'])} to {number(row['relative_error_high'])}" in comparison_table(rows)
        assert row["bytes_per_texel"] == {"texture": 6, "hsh": 12}[report["model"]]
        assert row["fit_seconds"] > 0 and row["shade_mtexels_per_s"] > 0
        assert set(COMPARE_COLUMNS) <= set(row)
    assert rows[1]["report"]["options"] == {"terms": 4, "space": "srgb", "storage": "png8", "solver": "closed_form", "objective": "linear"}


def test_the_interval_of_the_error_stands_in_the_table_of_a_fit(btf):
    report = tm.fit(btf, "texture").report
    low, high = report["held_out"]["relative_error_interval"]
    assert low <= report["held_out"]["relative_error"] <= high
    line = next(line for line in error_table(report).splitlines() if "interval" in line)
    assert f"{number(low)} to {number(high)}" in line and line.count(" to ") == 3


def test_one_split_for_all(btf):
    rows = compare(btf, ["texture", "ptm"], seed=3, holdout=0.3, progress=False)
    assert rows[0]["relative_error"] == tm.fit(btf, "texture", seed=3, holdout=0.3).report["held_out"]["relative_error"]
    assert rows[0]["report"]["held_out"]["samples"] == rows[1]["report"]["held_out"]["samples"]


def test_a_model_that_cannot_be_fitted_says_why(btf, tmp_path):
    rows = compare(btf, ["pca:components=5000", "texture"], progress=False)
    assert "Use at most" in rows[0]["failed"] and rows[0]["relative_error"] is None
    assert rows[1]["failed"] is None
    folder = write_comparison(rows, tmp_path / "out")
    written = json.loads((folder / "comparison.json").read_text("utf-8"))
    assert "Use at most" in written[0]["failed"]
    with (folder / "comparison.csv").open(newline="", encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    assert lines[0]["model"] == "pca:components=5000" and lines[0]["relative_error"] == ""
    assert float(lines[1]["relative_error"]) == rows[1]["relative_error"]
    assert_self_contained((folder / "comparison.html").read_text("utf-8"), scripts=1)


def test_only_failures_are_written_without_plots(btf, tmp_path):
    rows = compare(btf, ["pca:components=5000"], progress=False)
    folder = write_comparison(rows, tmp_path / "out")
    assert {path.name for path in folder.iterdir()} == {"comparison.json", "comparison.csv", "comparison.html"}


def test_a_perfect_fit_can_be_plotted(tmp_path):
    # An error of 0 and a figure of 0 bytes have no place on logarithmic axes.
    btf = Btf.from_tensors(np.zeros((len(LIGHT), 3, 6, 6), np.float32), LIGHT, VIEW)
    rows = compare(btf, ["texture", "ptm"], progress=False)
    assert rows[0]["relative_error"] == 0
    rows[1]["relative_error"] = None  # black data and a model that is not: relative to nothing
    assert (write_comparison(rows, tmp_path / "out") / "error_against_bytes.png").is_file()


@pytest.mark.parametrize(("text", "said"), [
    ("textur", "Did you mean 'texture'"), ("hsh:term=4", "Did you mean 'terms'"), ("hsh:terms", "has no '='"),
    ("hsh:terms=four", "whole number"),
])
def test_models_that_are_not_understood_are_refused_before_any_fit(btf, text, said):
    with pytest.raises(RangeError, match=said):
        compare(btf, ["texture", text], progress=False)


def test_options_are_parsed_as_toml_or_text():
    assert parse_model("phong_srf: residual=half_light, ridge=0.5") == ("phong_srf", {"residual": "half_light", "ridge": 0.5})
    assert parse_model("hsh") == ("hsh", {})


def test_an_earlier_comparison_is_replaced_and_anything_else_refused(btf, tmp_path):
    rows = compare(btf, ["texture"], progress=False)
    folder = write_comparison(rows, tmp_path / "out")
    write_comparison(rows, folder)
    (folder / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(DataError, match=r"out: the target must be empty or an earlier comparison and nothing else; .* first 'notes.txt'"):
        write_comparison(rows, folder)
    assert (folder / "notes.txt").read_text("utf-8") == "mine" and len(list(folder.iterdir())) == 7
    with pytest.raises(DataError, match="it is a file"):
        write_comparison(rows, folder / "notes.txt")


# Words and numbers


def test_what_is_not_finite_becomes_null():
    text = to_json({"a": float("nan"), "b": [float("inf"), 1.5, (-float("inf"),)], "c": "ü"})
    assert json.loads(text) == {"a": None, "b": [None, 1.5, [None]], "c": "ü"}


@pytest.mark.parametrize(("value", "text"), [
    (None, "-"), (True, "True"), (12345, "12345"), (12345.6, "12346"), (0.00012345678, "0.0001235"), (0.0, "0"), ("a", "a"),
])
def test_numbers_for_reading(value, text):
    assert number(value) == text


def test_a_table_is_aligned():
    lines = text_table(["name", "x"], [["a", 1], ["long name", 2.5]]).splitlines()
    assert lines[0] == "| name      | x   |" and len({len(line) for line in lines}) == 1


def test_descriptions(btf, tmp_path):
    text = describe_btf(btf)
    for said in ("88", "8 x 9 texels", "22, polar 0.0 to 70.0 degrees", "88 of 88 (100.0 %)", "float32"):
        assert said in text, said
    folder = tm.save_material(tm.fit(btf, "hsh", terms=4, measure=False).material, tmp_path / "out")
    assert is_material(folder) and not is_material(tmp_path)
    text = describe_material(folder)
    assert "hsh" in text and "terms=4" in text and "(12, 8, 9)" in text
