"""The page of a fit, read as a reader does: pictures with their labels, figures in words, links that lead somewhere."""

from __future__ import annotations

import json
from urllib.parse import unquote

import numpy as np
import pytest
import torch
from tests.report.reading import Reading
from tests.support import all_pairs, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf
from torchmat.report import write_fit
from torchmat.report.html import coverage_text, fit_page
from torchmat.report.inline import shown_size
from torchmat.report.page import Markup, page, paragraph, table
from torchmat.report.pictures import thinned
from torchmat.report.samples import Measured, difference_range, shown, shown_samples, telling_samples
from torchmat.report.verdict import verdict
from torchmat.report.words import COMPARED, FIGURES, STOPPED, figure_of, parameter, texture_name
from torchmat.solvers import stop_reasons

LIGHT, VIEW = all_pairs(hemisphere(), hemisphere(((0, 1), (60, 3))))


def made(light=LIGHT, view=VIEW, height=8, width=9):
    return Btf.from_tensors(plausible_images(light, view, height, width).astype(np.float32), light, view)


@pytest.fixture(scope="module")
def btf():
    return made()


@pytest.fixture(scope="module")
def ptm(btf, tmp_path_factory):
    folder = write_fit(btf, tm.fit(btf, "ptm"), tmp_path_factory.mktemp("fits") / "Stoff & <Wolle>")
    return folder, Reading((folder / "report.html").read_text("utf-8"))


def test_the_verdict_stands_first(ptm):
    folder, read = ptm
    sentence = verdict(json.loads((folder / "report.json").read_text("utf-8"))).sentence
    assert read.tags[read.tags.index(("main", {})) + 1][0] == "h1"
    assert any(attributes.get("class", "").startswith("verdict") for attributes in read.of("p")[:1])
    assert read.text.index(sentence) < read.text.index("Target, fit and difference") < read.text.index("How true it is")


def test_nothing_is_fetched_and_links_lead_to_the_textures(ptm):
    folder, read = ptm
    assert all(image["src"].startswith("data:image/png;base64,") for image in read.of("img"))
    links = [unquote(link["href"]) for link in read.of("a")]
    assert set(links) == {path.name for path in folder.glob("*.exr")} and all((folder / link).is_file() for link in links)
    assert read.of("link") == [] and all("src" not in script for script in read.of("script"))


def test_the_material_moves_right_below_the_verdict(ptm):
    tags = ptm[1].tags
    place = next(number for number, (_, attributes) in enumerate(tags) if attributes.get("id") == "torchmat-viewer")
    assert not {"h2", "img", "table"} & {name for name, _ in tags[:place]}


def test_every_picture_says_what_it_is_and_keeps_its_shape(ptm):
    images = ptm[1].of("img")
    assert all(image["alt"] for image in images)
    enlarged = [image for image in images if image.get("class") == "texels" and image["alt"].startswith(("Target", "Fit", "Difference"))]
    # 8 x 9 texels are shown by the largest whole factor within 320 pixels.
    assert {(image["height"], image["width"]) for image in enlarged} == {("280", "315")} and len(enlarged) % 3 == 0


def test_rows_have_labels_error_scale_and_directions(btf, ptm):
    rows = shown_samples(btf, tm.fit(btf, "ptm"))
    text = ptm[1].text
    for row in rows:
        assert f"{row.why.capitalize()} : light {row.light_deg[0]:.0f}°/{row.light_deg[1]:.0f}°, view" in text
        assert f"{row.relative_error:.3g}, {row.psnr_db:.1f} dB; {row.brightness}" in text
    assert text.count("Target Fit Difference") == len(rows)
    assert f"too dark by {difference_range(rows):g}" in text and f"too bright by {difference_range(rows):g}" in text


def test_no_key_of_a_program_is_left_in_what_is_read(ptm):
    assert ptm[1].keys() == []


def test_figures_have_words_and_a_direction(ptm):
    folder, read = ptm
    report = json.loads((folder / "report.json").read_text("utf-8"))
    rows = {row[0]: row for row in read.rows if row}
    for key, figure in FIGURES.items():
        found, wanted = rows[figure.name + figure.better], report["held_out"][key]
        numbers = [float(word) for word in found[2].split(" to ")]
        assert numbers == pytest.approx(wanted if key == "relative_error_interval" else [wanted], rel=1e-3) and found[-1] == figure.meaning
    assert FIGURES["psnr_db"].better == "higher is better" and FIGURES["relative_error"].better == "lower is better"


def test_how_it_was_made_is_told(btf):
    report = tm.fit(btf, "ptm").report
    run = {"command": ["torchmat", "fit", "ptm", "--data", "my <data>"], "digest": "abc123", "config": {}, "files": {}}
    read = Reading(fit_page({**report, "run": run}, []))
    assert "torchmat fit ptm --data 'my <data>'" in read.code and "abc123" in read.code
    assert f"torch {torch.__version__}" in read.text and "converged: nothing was left to gain" in read.text
    assert "solver=closed_form" in read.code


@pytest.fixture()
def no_plots(monkeypatch):
    """Leave out what takes the time, the plots: what the page itself shows is there."""
    import torchmat.report.write as write

    for name in ("maps_picture", "hemisphere_picture"):
        monkeypatch.setattr(write, name, lambda material, path, *rest, **more: path.with_name("maps.png"))
    monkeypatch.setattr(write, "write_pictures", lambda *given: [])


@pytest.mark.parametrize("name, options", [
    ("neural", {"geometry": "flat", "latent": 2, "hidden": 4, "effort": 0.004}), ("pca", {"components": 3}),
    ("phong_srf", {"residual": "half_light"}), ("distribution", {"geometry": "flat", "effort": 0.004}), ("shading_map", {}),
])
def test_pages_of_all_kinds_of_models(no_plots, btf, tmp_path, name, options):
    folder = write_fit(btf, tm.fit(btf, name, measure="quick", **options), tmp_path / "out")
    read = Reading((folder / "report.html").read_text("utf-8"))
    assert read.keys() == []
    files = [entry["file"] for entry in json.loads((folder / "manifest.json").read_text("utf-8"))["textures"]]
    assert {unquote(link["href"]) for link in read.of("a")} == set(files)
    if name == "phong_srf":
        rows = {row[0]: row[1:] for row in read.rows if len(row) == 3}
        assert float(rows["exponent"][0]) > 1 and rows["exponent"][1].startswith("no unit")
        assert "residual, half vector x" in read.text


@pytest.mark.parametrize("settings", [{"holdout": 0}, {"measure": False}], ids=["all used", "not measured"])
def test_without_what_was_held_out_or_measured_the_page_is_whole(no_plots, btf, tmp_path, settings):
    read = Reading((write_fit(btf, tm.fit(btf, "ptm", **settings), tmp_path / "out") / "report.html").read_text("utf-8"))
    assert ("No photographs were held out" in read.text) == ("holdout" in settings)
    assert ("How true it is was not measured" in read.text) == ("measure" in settings)
    assert "Target Fit Difference" in read.text and read.keys() == []


def test_what_the_user_named_is_escaped_everywhere(btf):
    report = tm.fit(btf, "texture").report
    evil = "</code><script>alert(1)</script>\"&"
    report = {
        **report, "run": {"command": ["torchmat", evil], "digest": evil}, "options": {"storage": evil}, "stop_reason": evil,
        "source": {**report["source"], "path": f"/data/{evil}", "kind": evil, "notes": [evil]}, "versions": {evil: evil},
    }
    read = Reading(fit_page(report, []))
    assert read.of("script") == [] and read.scripts == []
    assert read.text.count("<script>alert(1)</script>") >= 5


def test_only_markup_is_taken_as_it_is():
    assert paragraph("<b>") == "<p>&lt;b&gt;</p>" and paragraph(Markup("<b>x</b>")) == "<p><b>x</b></p>"
    assert "&lt;i&gt;" in table(["<i>"], []) and "<title>&lt;u&gt;</title>" in page("<u>", [])


# Which photographs


@pytest.mark.parametrize("held_out", [1, 2, 3, 4, 40])
def test_no_photograph_stands_there_twice(btf, held_out):
    result = tm.fit(btf, "texture", holdout=held_out / len(btf))
    assert len(result.split.held_out) == held_out
    chosen = telling_samples(btf, result)
    samples = [sample for _, sample in chosen]
    assert len(set(samples)) == len(samples) <= min(4, held_out) and set(samples) <= set(result.split.held_out.tolist())
    reasons = [reason for why, _ in chosen for reason in why.split(", ")]
    assert sorted(reasons) == ["best", "median", "most grazing", "worst"]


def test_they_are_the_best_the_median_the_worst_and_the_most_grazing(btf):
    result = tm.fit(btf, "texture")
    chosen = {reason: sample for why, sample in telling_samples(btf, result) for reason in why.split(", ")}
    held_out, errors = result.split.held_out.tolist(), result.held_out_errors.tolist()
    by_error = [sample for _, sample in sorted(zip(errors, held_out, strict=True))]
    assert (chosen["best"], chosen["worst"]) == (by_error[0], by_error[-1])
    assert chosen["median"] == by_error[(len(by_error) - 1) // 2]
    slant = {sample: float(btf.light[sample, 2] + btf.view[sample, 2]) for sample in held_out}
    assert slant[chosen["most grazing"]] == min(slant.values())


def test_without_errors_they_are_measured_on_a_few(btf):
    whole, quick = tm.fit(btf, "texture"), tm.fit(btf, "texture", measure=False)
    assert quick.held_out_errors is None and len(whole.split.held_out) > 16
    chosen = {reason: sample for why, sample in telling_samples(btf, quick) for reason in why.split(", ")}
    errors = dict(zip(whole.split.held_out.tolist(), whole.held_out_errors.tolist(), strict=True))
    assert errors[chosen["best"]] < errors[chosen["median"]] < errors[chosen["worst"]]


def test_a_difference_has_the_size_and_the_sign_of_what_is_seen():
    light, view = all_pairs(hemisphere(((0, 1),)), hemisphere(((0, 1),)))
    images = np.full((1, 3, 1, 2), 0.6, np.float32)
    btf = Btf.from_tensors(images, light.astype(np.float32), view.astype(np.float32))
    albedo = torch.full((3, 1, 2), 0.6)
    albedo[:, 0, 0], albedo[0, 0, 1] = 0.3, 0.9
    row = shown(btf, tm.models.MATERIALS["texture"]({"albedo": albedo}), 0, "the only")

    def srgb(value):
        return 1.055 * value ** (1 / 2.4) - 0.055

    assert row.scale == 1.0 and row.brightness == "shown as it is"
    assert float(row.difference[0, 0]) == pytest.approx(srgb(0.3) - srgb(0.6), abs=1e-5)
    assert float(row.difference[0, 1]) == pytest.approx((srgb(0.9) - srgb(0.6)) / 3**0.5, abs=1e-5)
    assert row.relative_error == pytest.approx((3 * 0.09 + 0.09) / (6 * 0.36), rel=1e-5)


def test_dark_photographs_are_brightened_and_say_so():
    light, view = all_pairs(hemisphere(((0, 1),)), hemisphere(((0, 1),)))
    btf = Btf.from_tensors(np.full((1, 3, 2, 2), 0.1, np.float32), light.astype(np.float32), view.astype(np.float32))
    row = shown(btf, tm.models.MATERIALS["texture"]({"albedo": torch.full((3, 2, 2), 0.05)}), 0, "it")
    assert row.brightness == "shown 10.0 times brighter" and float(row.target.max()) == pytest.approx(1.0)
    assert float(row.fit.max()) == pytest.approx(0.5)


def test_what_is_off_an_object_is_grey_and_counts_nowhere():
    light, view = all_pairs(hemisphere(((0, 1),)), hemisphere(((0, 1),)))
    images = np.full((1, 3, 1, 2), 0.1, np.float32)
    images[..., 1] = 0.9
    btf = Btf.from_tensors(images, light.astype(np.float32), view.astype(np.float32)).masked(torch.tensor([[True, False]]))
    row = shown(btf, tm.models.MATERIALS["texture"]({"albedo": torch.full((3, 1, 2), 0.05)}), 0, "it")
    assert row.scale == pytest.approx(0.1) and row.relative_error == pytest.approx(0.25)
    assert row.target[0, 0].tolist() == pytest.approx([1.0, 0.214]) and row.fit[0, 0].tolist() == pytest.approx([0.5, 0.214])
    assert float(row.difference[0, 1]) == 0 and float(row.difference[0, 0]) < 0
    assert difference_range([row]) == pytest.approx(0.3)  # 1 less the display value of 0.5 is 0.26


def test_the_page_of_an_object_shows_its_mask_and_no_sphere(btf, tmp_path):
    masked = btf.masked(torch.ones(8, 9, dtype=torch.bool).triu(-2), "cat.png")
    folder = write_fit(masked, tm.fit(masked, "ptm", measure="quick"), tmp_path / "out")
    names = {path.stem for path in (folder / "pictures").iterdir()}
    assert "object_mask" in names and "sphere" not in names
    read = Reading((folder / "report.html").read_text("utf-8"))
    assert "What counts as the object" in read.text and "% of the texels, by cat.png" in read.text


def test_directions_beyond_the_measured_are_found():
    def at(*polars):
        return torch.stack([torch.tensor([np.sin(p), 0.0, np.cos(p)]) for p in np.deg2rad(polars)])

    def ring(polar):
        turns = np.arange(8) * np.pi / 4
        sine, cosine = np.sin(np.deg2rad(polar)), np.cos(np.deg2rad(polar))
        return torch.tensor(np.stack([sine * np.cos(turns), sine * np.sin(turns), cosine + 0 * turns], 1))

    measured = Measured(torch.cat((at(0), ring(45))), torch.cat((at(0), ring(30))))
    straight = at(0, 0, 0, 0)
    assert measured.beyond(at(0, 44, 46, 60), straight) == [False, False, False, True]
    assert measured.beyond(straight, at(0, 29, 40, 90)) == [False, False, True, True]
    one_view = Measured(measured.lights, at(0))
    assert one_view.beyond(straight[:2], at(0, 20)) == [False, True]


def test_a_photograph_beyond_what_the_fit_saw_is_marked(btf):
    result = tm.fit(btf, "ptm", holdout_by="light", holdout=0.3, seed=1)
    rows = shown_samples(btf, result)
    outside = Measured(btf.light[result.split.train], btf.view[result.split.train])
    assert [row.beyond for row in rows] == [outside.beyond(btf.light[[row.sample]], btf.view[[row.sample]])[0] for row in rows]
    rows = [row._replace(beyond=number == 0) for number, row in enumerate(rows)]
    assert Reading(fit_page(result.report, [], rows)).text.count("Beyond the directions that the fit saw.") == 1


# Sizes and words


@pytest.mark.parametrize(("size", "wanted", "found"), [
    ((64, 64), 320, (320, 320)), ((64, 60), 256, (256, 240)), ((100, 200), 320, (100, 200)), ((500, 1), 320, (500, 1)), ((1, 1), 72, (72, 72)),
])
def test_pictures_are_enlarged_by_whole_factors(size, wanted, found):
    assert shown_size(*size, wanted) == found


def test_large_pictures_are_averaged():
    planes = torch.arange(16.0).reshape(1, 4, 4)
    assert thinned(planes, 2).tolist() == [[[2.5, 4.5], [10.5, 12.5]]] and thinned(planes, 4) is planes
    assert thinned(torch.zeros(3, 1, 1000), 320).shape == (3, 1, 250)


def test_the_page_of_large_noise_stays_bounded(tmp_path):
    light, view = all_pairs(hemisphere(((0, 1), (40, 3))), hemisphere(((0, 1), (50, 3))))
    images = np.random.default_rng(0).random((len(light), 3, 400, 700), dtype=np.float32)
    btf = Btf.from_tensors(images, light.astype(np.float32), view.astype(np.float32))
    folder = write_fit(btf, tm.fit(btf, "lambert", measure=False), tmp_path / "out")
    assert (folder / "report.html").stat().st_size < 6_000_000


def test_uniform_coverage_is_a_sentence_and_the_rest_a_picture(ptm, tmp_path):
    assert "every texel's samples determine all of its unknowns" in ptm[1].text and not (ptm[0] / "pictures" / "coverage.png").exists()
    assert coverage_text({"least": 0.5, "mean": 0.5, "texels_not_fully_determined": 9}) == "every texel's samples determine 50 % of its unknowns"
    assert coverage_text({"least": 0.5, "mean": 0.75, "texels_not_fully_determined": 9}) == (
        "texels' samples determine 50 % of their unknowns at least, 75 % on average; 9 texels not all"
    )


def test_parameters_have_names_values_and_units():
    assert parameter("log_exponent", float(np.log(20))) == ("exponent", pytest.approx(20), "no unit; larger is sharper")
    assert parameter("log_roughness_along", 0.0)[:2] == ("roughness along", 1.0)
    assert parameter("axis", np.pi / 2) == ("direction of the brushing", pytest.approx(90), "degrees from +x")
    assert parameter("specular_g", 0.25) == ("specular, green", 0.25, "share of light, linear")
    assert parameter("own_number", 3.0) == ("own number", 3.0, "no unit")


@pytest.mark.parametrize(("texture", "map_name", "said"), [
    ("polynomial_lx_ly", "polynomial", "polynomial, light x times light y"), ("polynomial_1", "polynomial", "polynomial, constant"),
    ("residual_hz", "residual", "residual, half vector z"), ("index_1", "index", "index 1"), ("height", "height", "height"),
    ("component_003", "component", "component 003"), ("specular_mask", "specular_mask", "specular mask"),
])
def test_textures_have_names(texture, map_name, said):
    assert texture_name(texture, map_name) == said


def test_words_cover_all_reasons_and_columns():
    reasons = {value for name, value in vars(stop_reasons).items() if name.isupper()}
    assert reasons == set(STOPPED)
    assert all("_" not in figure.name and figure.meaning for figure in (*FIGURES.values(), *COMPARED.values()))
    assert figure_of("seconds").name == "Seconds" and figure_of("relative_error").better == "lower is better"


def test_the_reader_finds_what_it_is_for():
    read = Reading('<p>held_out <code>a_b</code></p><table><tr><td>1</td></tr></table><img alt="x_y" src="z">')
    assert read.keys() == ["held_out", "x_y"] and read.rows == [["1"]]
    with pytest.raises(AssertionError, match="closes"):
        Reading("<p><b></p></b>")
    with pytest.raises(AssertionError, match="not closed"):
        Reading("<p>")
