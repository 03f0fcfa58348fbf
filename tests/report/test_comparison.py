"""Comparisons: repeats, budgets, curves, fronts, rows that survive an interruption, and labels that can be read."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
from tests.report.reading import Reading
from tests.support import all_pairs, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, RangeError
from torchmat.fitting.geometry import Flat, Recover
from torchmat.report import compare, write_comparison
from torchmat.report.comparison import closed_forms, default_models, parse_model
from torchmat.report.compare_page import SORTING, comparison_page, table_page
from torchmat.report.compare_plots import PLOTS, write_plots
from torchmat.report.compare_rows import entry_of, front, judged, mark_fronts
from torchmat.report.place_labels import overlap, place
from torchmat.report.tables import COMPARE_COLUMNS, COMPARE_MEANINGS, comparison_table

LIGHT, VIEW = all_pairs(hemisphere(), hemisphere(((0, 1), (60, 3))))
NEURAL = "neural:geometry=flat,latent=2,hidden=4,effort=0.004"


@pytest.fixture(scope="module")
def btf():
    return Btf.from_tensors(plausible_images(LIGHT, VIEW, 8, 9).astype(np.float32), LIGHT, VIEW)


@pytest.fixture(scope="module")
def rows(btf):
    return compare(btf, ["texture", "ptm", NEURAL], repeats=2, progress=False)


def row(error, seconds=1.0, total=1.0, rate=1.0, after=None, model="texture"):
    return {
        "model": model, "relative_error": error, "relative_error_after_export": after, "fit_seconds": seconds,
        "total_bytes_per_texel": total, "shade_mtexels_per_s": rate,
    }


def test_repeats_are_timed_on_one_split_and_give_the_same_bits(btf, rows):
    for one in rows:
        assert len(one["repeats"]) == 2 and min(one["repeats"]) <= one["fit_seconds"] <= max(one["repeats"])
        assert one["fit_seconds_spread"] == max(one["repeats"]) - min(one["repeats"])
        assert one["same_bits"] is True
    assert rows[1]["relative_error"] == tm.fit(btf, "ptm").report["held_out"]["relative_error"]


def test_repeats_that_differ_say_so_with_all_errors(btf, monkeypatch):
    import torchmat.report.compare_rows as compare_rows

    seeds = iter((0, 1))
    honest = compare_rows.fit

    def unsteady(data, model, **settings):
        # Another split is what a fit that depends on chance looks like from outside.
        return honest(data, model, **{**settings, "seed": next(seeds)})

    monkeypatch.setattr(compare_rows, "fit", unsteady)
    found = compare(btf, ["texture"], repeats=2, progress=False)[0]
    assert found["same_bits"] is False and len(set(found["relative_errors"])) == 2
    assert found["relative_errors"][-1] == found["relative_error"]


def test_what_all_texels_share_is_spread_over_them(rows):
    for one in rows:
        assert one["total_bytes_per_texel"] == one["bytes_per_texel"] + one["shared_bytes"] / 72
    # Two latent channels of 8 bits; tables of 4 x 11, 4 x 5 and 3 x 5 numbers in half precision.
    assert rows[2]["bytes_per_texel"] == 2 and rows[2]["shared_bytes"] == 2 * (44 + 20 + 15)


def test_iterative_solvers_have_a_curve_and_closed_forms_none(rows):
    assert rows[0]["curve"] == rows[1]["curve"] == []
    seconds, errors = zip(*rows[2]["curve"], strict=True)
    assert len(seconds) >= 2 and list(seconds) == sorted(seconds) and all(map(math.isfinite, errors))
    # All 18 held-out samples are within the curve's 64, so it ends at the row's own error.
    assert abs(errors[-1] / rows[2]["relative_error"] - 1) < 1e-9
    assert [one["solver"] for one in rows] == ["closed_form", "closed_form", "minibatch"]


def test_curves_can_be_left_out(btf):
    assert compare(btf, [NEURAL], curves=False, progress=False)[0]["curve"] == []


def test_a_budget_stops_iterative_solvers_and_the_row_says_so(btf):
    found = compare(btf, ["ptm", "neural:latent=2,hidden=4,effort=1000.0"], budget=0.3, progress=False)
    assert [one["stop_reason"] for one in found] == ["converged", "budget spent"]
    assert math.isfinite(found[1]["relative_error"]) and found[1]["same_bits"] is None


def test_memory_is_that_of_the_fit_or_unknown(rows):
    for one in rows:
        assert one["fit_memory_mb"] is None or 0 <= one["fit_memory_mb"] < 500


def test_geometry_may_stand_in_a_models_text(btf):
    entry = entry_of("lambert:geometry=recover,storage=png8", Flat())
    assert (entry.model, entry.options, entry.geometry) == ("lambert", {"storage": "png8"}, Recover())
    assert entry_of("lambert", Recover()).geometry == Recover()
    assert entry_of("lambert", None).geometry == Flat() and entry_of("neural", None).geometry == Recover(or_flat=True)
    assert parse_model("lambert:geometry=flat") == ("lambert", {"geometry": "flat"})
    with pytest.raises(RangeError, match="Did you mean 'recover'"):
        parse_model("lambert:geometry=recovr")


def test_a_relief_that_the_data_cannot_show_fails_alone():
    light, view = all_pairs(hemisphere()[4:5], hemisphere(((0, 1), (30, 4), (60, 6))))
    one_light = Btf.from_tensors(plausible_images(light, view, 8, 9).astype(np.float32), light, view)
    found = compare(one_light, ["lambert:geometry=recover", "texture"], progress=False)
    assert "not in one plane" in found[0]["failed"] and found[0]["relative_error"] is None
    assert found[1]["failed"] is None and found[1]["front"] == "bytes, seconds, shading"


def test_the_default_has_every_family():
    families = {text.partition(":")[0] for text in default_models()}
    assert families == set(tm.models.MATERIALS)
    assert not any(text.startswith(("neural", "distribution")) for text in closed_forms())
    assert {"phong_srf:solver=varpro", "phong_srf:solver=adam", "distribution:solver=lbfgs"} <= set(default_models())
    assert len({repr(entry_of(text, "flat")) for text in default_models()}) == len(default_models())


@pytest.mark.parametrize(("models", "settings", "said"), [
    (["texture", "texture"], {}, "'texture' is the same as 'texture'. Use repeats"),
    (["hsh", "hsh:terms=9"], {}, "'hsh:terms=9' is the same as 'hsh'"),
    (["lambert", "lambert:geometry=flat"], {}, "is the same as 'lambert'"),
    (["texture:solver=closed_form", "texture"], {}, "'texture' is the same as 'texture:solver=closed_form'"),
    (["texture"], {"repeats": 0}, "repeats must be a whole number of at least 1; it is 0"),
    (["texture"], {"repeats": 1.5}, "repeats must be a whole number"),
    (["texture"], {"budget": 0}, "budget must be positive; it is 0"),
    (["texture"], {"budget": float("nan")}, "budget must be positive"),
    (["texture"], {"holdout": 1.5}, "must lie in [0, 1)"), (["texture"], {"holdout_by": "vew"}, "Did you mean 'view'"),
    (["texture"], {"geometry": "recovr"}, "Did you mean 'recover'"),
    (["auto"], {}, "'auto' is the choice among them"),
    (["phong_srf:solver=adm"], {}, "Did you mean 'adam'"),
    ([], {}, "be a list of at least one"), ("texture", {}, "be a list of at least one"),
])
def test_what_makes_no_sense_is_refused_before_any_fit(btf, monkeypatch, models, settings, said):
    import torchmat.report.compare_rows as compare_rows

    monkeypatch.setattr(compare_rows, "fit", None)
    with pytest.raises(RangeError) as error:
        compare(btf, models, progress=False, **settings)
    assert said in str(error.value)


def test_rows_so_far_are_handed_out_and_an_interruption_loses_none(btf, tmp_path, monkeypatch):
    import torchmat.report.compare_rows as compare_rows

    honest = compare_rows.fit

    def interrupted(data, model, **settings):
        if model == "hsh":
            raise KeyboardInterrupt
        return honest(data, model, **settings)

    monkeypatch.setattr(compare_rows, "fit", interrupted)
    folder = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        compare(
            btf, ["texture", "ptm", "hsh"], progress=False,
            each=lambda so_far: write_comparison(so_far, folder, plots=False),
        )
    written = json.loads((folder / "comparison.json").read_text("utf-8"))
    assert [one["model"] for one in written] == ["texture", "ptm"]
    assert {path.name for path in folder.iterdir()} == {"comparison.json", "comparison.csv", "comparison.html"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]  # nothing half-built beside it


def test_the_front_holds_what_nothing_beats_in_both():
    errors = (0.3, 0.2, 0.25, 0.1, 0.1, None)
    given = [row(error, total=total) for error, total in zip(errors, (1, 2, 3, 4, 5, 0.5), strict=True)]
    assert front(given, "total_bytes_per_texel") == [0, 1, 3]
    assert front([row(0.1, total=2), row(0.2, total=2)], "total_bytes_per_texel") == [0]
    # Of a throughput more is better.
    given = [row(error, rate=rate) for error, rate in ((0.3, 9), (0.2, 5), (0.25, 4), (0.1, 1))]
    assert front(given, "shade_mtexels_per_s") == [0, 1, 3]


def test_fronts_go_by_the_error_after_export():
    given = [row(0.1, total=2, after=0.4), row(0.2, total=2, after=0.2)]
    assert judged(given[0]) == 0.4 and front(given, "total_bytes_per_texel") == [1]
    marked = mark_fronts([row(0.3, total=1, seconds=2, rate=1), row(0.2, total=2, seconds=1, rate=2)])
    assert [one["front"] for one in marked] == ["bytes", "bytes, seconds, shading"]


def test_every_column_is_explained_and_written(rows, tmp_path):
    folder = write_comparison(rows, tmp_path / "out")
    assert {path.stem for path in folder.glob("*.png")} == set(PLOTS)
    with (folder / "comparison.csv").open(newline="", encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    assert tuple(lines[0]) == COMPARE_COLUMNS == tuple(COMPARE_MEANINGS)
    assert float(lines[2]["fit_seconds"]) == rows[2]["fit_seconds"] and lines[2]["same_bits"] == "True"
    page = (folder / "comparison.html").read_text("utf-8")
    read = Reading(page)
    assert set(COMPARE_COLUMNS) <= set(read.code) and read.keys() == []
    assert len(read.of("img")) == 3 + 2 * len(rows)  # the plots, and target and fit of each row
    written = json.loads((folder / "comparison.json").read_text("utf-8"))
    assert "picture" not in written[2] and written[2]["curve"] == [list(point) for point in rows[2]["curve"]]
    assert "neural" in comparison_table(rows) and "exported" in comparison_table(rows)


def test_plots_hold_a_single_point_and_costs_of_nothing(tmp_path):
    assert len(write_plots(mark_fronts([row(0.0, seconds=0.0, total=0.0)]), tmp_path)) == 3


def test_labels_cover_neither_points_nor_each_other():
    random = np.random.default_rng(0)
    points = [(100 + 12 * n % 60, 200 + float(random.uniform(-30, 30))) for n in range(18)]
    sizes = [(70.0, 11.0)] * len(points)
    boxes = [box for box, _ in place(points, sizes, (0, 0, 600, 400), 1.0)]
    for number, box in enumerate(boxes):
        assert box[0] >= 0 and box[1] >= 0 and box[2] <= 600 and box[3] <= 400
        assert all(overlap(box, other) == 0 for other in boxes[number + 1 :])
        assert all(not (box[0] < x < box[2] and box[1] < y < box[3]) for x, y in points)


def test_without_room_every_label_still_has_a_place():
    found = place([(5.0, 5.0), (6.0, 5.0)], [(50.0, 10.0)] * 2, (0, 0, 20, 20), 1.0)
    assert len(found) == 2


# The page


def test_the_page_sorts_by_what_each_cell_holds_and_marks_the_front(rows):
    failed = {**dict.fromkeys(rows[0]), "model": "<b>", "solver": "closed_form", "geometry": "flat", "failed": "<i>too few</i>"}
    page = comparison_page("Models on <data>", [*mark_fronts(rows), failed], [])
    read = Reading(page)
    heads = read.of("th")
    assert len(read.of("button")) == len(heads) - 1 and all(button["type"] == "button" for button in read.of("button"))
    assert [head.get("data-first") for head in heads] == [*[None] * 5, "descending", None, None, "descending", None, "descending", None]
    assert all("lower is better" in cell or "higher is better" in cell for cell in read.rows[0][2:-1])
    cells = [attributes for attributes in read.of("td") if "data-value" in attributes]
    per_row = [cells[number : number + len(heads) - 1] for number in range(0, len(cells), len(heads) - 1)]
    assert [row[0]["data-value"] for row in per_row] == [*(one["model"] for one in rows), "<b>"]
    assert [row[1]["data-value"] for row in per_row] == [*(str(one["total_bytes_per_texel"]) for one in rows), ""]
    assert [row[6]["data-value"] for row in per_row[:-1]] == [str(one["relative_error"]) for one in rows]
    marked = [attributes.get("class") == "front" for attributes in read.of("tr")[1:]]
    assert marked == [bool(one["front"]) for one in mark_fronts(rows)] + [False]
    assert "failed: <i>too few</i>" in read.text and read.of("b") == read.of("i") == [] and read.keys() == []
    assert read.scripts == [SORTING]


def test_rows_show_the_same_photograph_beside_their_own_fit(rows):
    assert len({one["picture"]["target"] for one in rows}) == 1 and len({one["picture"]["fit"] for one in rows}) == 3
    assert len({one["picture"]["sample"] for one in rows}) == 1
    read = Reading(comparison_page("x", rows, []))
    assert [image["alt"] for image in read.of("img")] == [f"{which}, {one['model']}" for one in rows for which in ("target", "fit")]
    assert {(image["height"], image["width"]) for image in read.of("img")} == {("64", "72")}


def test_the_page_says_first_which_row_is_truest_smallest_and_quickest():
    given = mark_fronts([row(0.3, 2.0, 1.0, model="small"), row(0.1, 3.0, 9.0, model="true"), row(0.2, 0.5, 5.0, model="quick"), row(None)])
    bare = dict.fromkeys(COMPARE_COLUMNS) | {"picture": None}
    read = Reading(comparison_page("x", [bare | one for one in given], []))
    assert read.code[:3] == ["true", "small", "quick"] and read.of("img") == []
    assert "Truest: (relative error 0.1); smallest: at 1 bytes a texel (relative error 0.3); quickest to fit: in 0.5 s" in read.text
    assert "No row has an error" in Reading(comparison_page("x", [bare | row(None)], [])).text


def test_a_summary_can_be_sorted_and_escapes():
    columns = {"data": "Where the images are.", "relative_error": "On held-out samples.", "failed": "Why there is no result."}
    read = Reading(table_page("Many", columns, [{"data": "a_<b>", "relative_error": 0.5, "failed": None}]))
    assert [cell["data-value"] for cell in read.of("td")] == ["a_<b>", "0.5", ""] and read.keys() == [] and read.of("b") == []
    assert len(read.of("button")) == 3
