"""A wish in dB keeps highlights besides: what counts as one, how that is weighed, and what is said where none is kept."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.fitting import auto_data as data

import torchmat as tm
from torchmat import Btf, RangeError
from torchmat.fitting.choice import choose, climb
from torchmat.fitting.choice.choose import MET, NOT_MET
from torchmat.fitting.choice.examine import Examiner
from torchmat.fitting.choice.kept_back import KeptBack, highlights_from, keep_back
from torchmat.fitting.choice.ladder import all_rungs
from torchmat.fitting.choice.measured import HIGHLIGHTS, MARGIN, Measured, wanted_cost
from torchmat.fitting.training import make_training
from torchmat.fitting.wanted import Target
from torchmat.models import Texture
from torchmat.report.decisions_page import decided_text, decisions_text, outcome_text, wanted_text

FLAT = {"geometry": "flat", "measure": False}


def choice_of(result):
    return result.report["figures"]["auto"]


@pytest.fixture
def closed_forms(monkeypatch):
    """Leave the choice what takes no time, of which nothing can follow a sharp highlight."""
    some = [rung for rung in all_rungs() if not rung.late]
    monkeypatch.setattr(climb, "all_rungs", lambda: some)
    monkeypatch.setattr(choose, "built_by_parts", lambda: [])
    monkeypatch.setattr(choose, "last_rungs", lambda: [])  # splines follow one, in closed form too


# Whole choices


def test_a_wish_in_db_keeps_the_highlights_of_a_lacquer():
    result = tm.fit(data.lacquer(), "auto", psnr=20, geometry="flat")
    choice, after = choice_of(result), result.report["held_out_after_export"]
    assert result.stop_reason == MET and choice["chosen"]["highlight_error"] < 0.01  # measured 1e-4
    assert after["relative_error"] < 0.01 and after["psnr_db"] > 20
    assert not choice["highlights"]["lost"] and "lost" not in decided_text(choice)
    # What dB alone would have taken is in the log, with the reason why it was left.
    passed = [row for row in choice["candidates"] if row.get("psnr_db", 0) > 20.3 and row["highlight_error"] > 0.3]
    assert passed and all("on highlights, with a relative error of 0." in row["why"] for row in passed)


def test_highlights_may_be_let_go_and_that_is_said(closed_forms):
    result = tm.fit(data.lacquer(), "auto", psnr=20, highlights=1, **FLAT)
    choice = choice_of(result)
    assert result.stop_reason == MET and choice["chosen"]["highlight_error"] > 0.3 and choice["decided_by"] == "psnr_db"
    assert wanted_text(choice) == "at least 20 dB, highlights may go"
    assert "Highlights are lost: where a channel reaches" in decided_text(choice) and "let go on request" in decisions_text(choice)


def test_where_nothing_keeps_them_the_db_are_kept_and_the_loss_stands_in_words(closed_forms):
    result = tm.fit(data.lacquer(), "auto", psnr=20, **FLAT)
    choice = choice_of(result)
    best = max(row["psnr_db"] for row in choice["candidates"] if row.get("psnr_db"))
    assert result.stop_reason == NOT_MET and choice["short_by_db"] == 0
    # Another candidate is a little truer on highlights and has far fewer dB.
    assert choice["chosen"]["psnr_db"] > best - 0.5 and choice["chosen"]["highlight_error"] > 0.3
    said = decided_text(choice)
    assert said.startswith("What decided was the relative error on highlights. The dB are as wanted, but highlights are lost")
    assert said in decisions_text(choice) and " on highlights" in outcome_text(choice)
    assert wanted_text(choice) == "at least 20 dB, a relative error of at most 0.1 on highlights"


@pytest.mark.parametrize("btf", [data.diffuse(data.colours(8)), data.diffuse(data.colours(16, detail=False)), data.constant()])
def test_a_matte_surface_takes_the_same_bytes(closed_forms, btf):
    kept, gone = (choice_of(tm.fit(btf, "auto", psnr=25, highlights=most, **FLAT)) for most in (None, 1))
    assert kept["chosen"]["bytes"] == gone["chosen"]["bytes"] and kept["chosen"]["highlight_error"] is None
    assert decided_text(kept) == "What decided was the dB. The images show no highlights."
    assert wanted_text(kept) == "at least 25 dB"


def test_bytes_alone_weigh_highlights(closed_forms):
    """Phong has a third less error on highlights than its best rival and 12 dB less: it would not be worth it alone."""
    found = choice_of(tm.fit(data.lacquer(), "auto", bytes=12, **FLAT))
    assert found["decided_by"] == "highlight_error" and found["highlights"]["lost"]
    alone = choice_of(tm.fit(data.lacquer(), "auto", bytes=12, highlights=1, **FLAT))
    assert alone["decided_by"] == "psnr_db" and alone["chosen"]["psnr_db"] >= found["chosen"]["psnr_db"]


def test_what_cannot_be_wanted_of_highlights():
    with pytest.raises(RangeError, match="highlights must be wanted beside psnr, bytes or seconds; error is 0.1"):
        tm.fit(data.constant(), "auto", error=0.1, highlights=0.1)
    with pytest.raises(RangeError, match="highlights must be a positive number"):
        tm.fit(data.constant(), "auto", psnr=25, highlights=0)
    with pytest.raises(RangeError, match="say what is wanted"):
        tm.fit(data.constant(), "auto", highlights=0.1)
    with pytest.raises(RangeError, match='highlights must be wanted of the model "auto"'):
        tm.fit(data.constant(), "ptm", highlights=0.1)


# What counts as a highlight


def test_a_highlight_is_twice_what_is_usual_or_white():
    images = torch.full((1, 3, 10, 10), 0.2)
    valid = torch.ones(1, 1, 10, 10, dtype=torch.bool)
    assert highlights_from(images, valid) is None
    images[0, 1, 0, :3] = 0.7  # of three texels one channel
    assert highlights_from(images, valid) == pytest.approx(0.4)
    assert highlights_from(10 * images, valid) == 1.0, "above white a display shows nothing"
    assert highlights_from(images, valid & (torch.arange(10) >= 3)) is None, "it was not measured"
    images[0, 1, 0, :3] = 0.41  # 3 of 100 texels hold 10 % of the energy
    assert highlights_from(images, valid) == pytest.approx(0.4)
    images[0, 1, 0, 1:3] = 0.2  # one holds 4 %
    assert highlights_from(images, valid) == pytest.approx(0.4)
    images[0, 1, 0, 0] = 0.39
    assert highlights_from(images, valid) is None
    assert highlights_from(0 * images, valid) is None and highlights_from(images, ~valid) is None


def test_little_energy_is_no_highlight():
    images = torch.full((1, 3, 20, 20), 0.2)
    images[0, 0, 0, 0] = 0.41  # 1 % of it
    assert highlights_from(images, torch.ones(1, 1, 20, 20, dtype=torch.bool)) is None


def test_the_examiner_measures_highlights_where_images_or_material_show_one():
    images = np.full((2, 3, 4, 5), 0.2, np.float32)
    images[0, :, 0, 0] = 0.9
    up = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (2, 1))
    btf = Btf.from_tensors(images, up, up)
    albedo = torch.full((3, 4, 5), 0.2)
    albedo[0, 1, 1] = 0.5  # a red highlight where none is: 0.3 too much, in both images
    training = make_training(btf, torch.arange(2), 0, True, torch.float32, False)
    found = Examiner(training, KeptBack(torch.arange(2), torch.ones(2), 0.4)).measure_as_it_is(Texture({"albedo": albedo}))
    missed, bright = 3 * 0.7**2 + 2 * 0.3**2, 3 * 0.9**2
    assert found.highlight_error == pytest.approx(missed / bright, rel=1e-5)
    assert found.relative_error == pytest.approx(missed / (bright + 117 * 0.04), rel=1e-5)

    def log(value):
        return math.log1p(5000 * value) / math.log1p(5000)

    squares = 3 * (log(0.9) - log(0.2)) ** 2 + 2 * (log(0.5) - log(0.2)) ** 2
    assert found.psnr_log_db == pytest.approx(-10 * math.log10(squares / 120), abs=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_some_images_with_highlights_are_kept_back_and_count_as_many_as_there_are(seed):
    btf = data.lacquer()
    mirrored = btf.images(torch.arange(len(btf))).amax(dim=(1, 2, 3)) > 1
    kept = keep_back(make_training(btf, torch.arange(len(btf)), seed, True, torch.float32, False))
    shine = mirrored[kept.rows]
    assert int(mirrored.sum()) == 25 and int(shine.sum()) == 4
    assert float(kept.weight.mean()) == pytest.approx(1) and len(kept.rows.unique()) == len(kept.rows)
    assert float(kept.weight[shine].sum() / kept.weight.sum()) == pytest.approx(25 / len(btf), abs=1e-6)


def test_one_image_that_shines_is_fitted():
    images = data.noisy(data.LIGHT[:, 2, None, None, None] * data.colours(4))
    images[33] *= 40
    btf = Btf.from_tensors(images, data.LIGHT.astype(np.float32), data.VIEW.astype(np.float32))
    for seed in range(3):
        kept = keep_back(make_training(btf, torch.arange(len(btf)), seed, True, torch.float32, False))
        assert kept.highlights_from is not None and 33 not in kept.rows.tolist()


def test_what_is_kept_back_counts_by_its_weight():
    images = np.full((2, 3, 4, 5), 0.2, np.float32)
    images[1] = 0.5
    up = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (2, 1))
    training = make_training(Btf.from_tensors(images, up, up), torch.arange(2), 0, True, torch.float32, False)
    found = Examiner(training, KeptBack(torch.arange(2), torch.tensor([1.75, 0.25]), None)).measure_as_it_is(
        Texture({"albedo": torch.full((3, 4, 5), 0.3)})
    )
    assert found.relative_error == pytest.approx((1.75 * 0.01 + 0.25 * 0.04) / (1.75 * 0.04 + 0.25 * 0.25), rel=1e-5)


# How it is weighed


def test_a_target_is_met_where_both_are():
    target = Target(psnr=20)
    limit = wanted_cost(target) * (1 - MARGIN)
    assert limit == pytest.approx(0.0095)
    for decibels, highlights, meets in ((20.3, 0.09, True), (20.3, 0.096, False), (20.1, 0.09, False), (20.3, None, True), (20.1, None, False)):
        assert (Measured(decibels, 0.0, 0.0, highlights).cost(target) <= limit) == meets


def test_what_both_miss_adds_up():
    target = Target(psnr=20)
    assert Measured(10, 0, 0, None).cost(target) == pytest.approx(0.1)
    assert Measured(20, 0, 0, 0.3).cost(target) == pytest.approx(0.0095 + 0.0005 + (0.03 - 0.0095))
    assert Measured(30, 0, 0, 0.3).cost(target) == pytest.approx(0.03)
    assert Measured(30, 0, 0, 0.005).cost(target) == pytest.approx(0.001), "within the target the larger counts"
    assert Measured(10, 0, 0, 0.9).cost(Target(psnr=20, highlights=1)) == pytest.approx(0.1)
    assert Measured(10, 0.7, 0, 0.9).cost(Target(error=0.1)) == 0.7


def test_without_a_wish_an_error_of_25_db_weighs_as_much_as_a_tenth_of_the_highlights():
    target = Target(bytes=4)
    assert Measured(25, 0, 0, 0.1).cost(target) == pytest.approx(2 * 10**-2.5)
    assert Measured(25, 0, 0, None).cost(target) == pytest.approx(10**-2.5)
    assert Measured(25, 0, 0, 0.11).decided_by(target) == "highlight_error" and HIGHLIGHTS == 0.1
    assert Measured(25, 0, 0, 0.09).decided_by(target) == "psnr_db"
    assert Measured(25, 0, 0, 0.9).cost(Target(bytes=4, highlights=1)) == pytest.approx(10**-2.5)


def test_what_decided_and_what_is_missed():
    target = Target(psnr=20)
    assert [Measured(d, 0, 0, h).decided_by(target) for d, h in ((19, 0.12), (21, 0.12), (19, None))] == [
        "psnr_db", "highlight_error", "psnr_db",
    ]
    assert Measured(19, 0, 0, 0.12).gap_text(target) == (
        "misses the target by 1.22 dB and on highlights, with a relative error of 0.12 where at most 0.1 is wanted"
    )
    assert Measured(21, 0, 0, 0.05).gap_text(target) == "" == Measured(21, 0, 0, 5.0).gap_text(Target(psnr=20, highlights=2))
    assert Measured(0, 0.2, 0, 9.0).gap_text(Target(error=0.1)) == "misses the target by 3.23 dB"
    assert Measured(0, 0.2).short_by_db(Target(bytes=3)) is None
