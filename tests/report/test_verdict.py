"""The verdict on a fit: one sentence for every kind of report, honest where it is bad."""

from __future__ import annotations

import math

import pytest

from torchmat.report.verdict import BANDS, UNKNOWN, UNUSABLE, verdict


def part(db=30.0, error=0.01, samples=100, bands=()):
    rows = [
        {"angle": angle, "from_deg": low, "to_deg": low + 15, "samples": 5, "relative_error": 0.1, "psnr_db": value}
        for angle, low, value in bands
    ]
    return {"samples": samples, "psnr_db": db, "relative_error": error, "by_angle": rows}


def report(**changes):
    base = {
        "bytes_per_texel": 9.0, "texels": 4096, "stop_reason": "converged", "holdout_by": "pair", "figures": {},
        "coverage": {"texels_not_fully_determined": 0}, "source": {"clipped_share": 0.0, "invalid_share": 0.0},
        "train": part(), "held_out": part(), "held_out_after_export": part(),
    }
    return {**base, **changes}


def alike(figures):
    return report(train=figures, held_out=figures, held_out_after_export=figures)


def test_the_sentence_has_the_numbers_and_what_they_mean():
    assert verdict(report(train=part(27.5), held_out=part(27.14, 0.0112), held_out_after_export=part(27.09, 0.0113))) == (
        "fair", "Reproduces unseen pairs of light and view at 27.1 dB (relative error 0.0113): a close likeness, whose differences "
        "show side by side; 9 bytes a texel.", (),
    )


@pytest.mark.parametrize(("db", "error", "grade"), [
    (38.0, 0.02, "excellent"), (200.0, 0.0, "excellent"), (37.99, 0.001, "good"), (45.0, 0.03, "good"), (32.0, 0.05, "good"),
    (31.9, 0.01, "fair"), (40.0, 0.06, "fair"), (26.0, 0.15, "fair"), (25.9, 0.01, "coarse"), (29.0, 0.3, "coarse"),
    (20.0, 0.4, "coarse"), (19.9, 0.01, "poor"), (35.0, 0.9, "poor"), (-3.0, 5.0, "poor"), (38.0, None, "excellent"),
])
def test_the_worse_of_both_figures_decides(db, error, grade):
    found = verdict(alike(part(db, error)))
    assert found.grade == grade
    said = next(band.said for band in BANDS if band.grade == grade)
    assert f"{db:.1f} dB" in found.sentence and said in found.sentence and ("relative error" in found.sentence) == (error is not None)


def test_bands_fall_in_both_figures_and_hold_everything():
    assert [band.psnr_db for band in BANDS] == sorted((band.psnr_db for band in BANDS), reverse=True)
    assert [band.relative_error for band in BANDS] == sorted(band.relative_error for band in BANDS)
    assert BANDS[-1].psnr_db == -math.inf and BANDS[-1].relative_error == math.inf


@pytest.mark.parametrize("changes", [
    {"stop_reason": "diverged"}, {"stop_reason": "not finite"}, {"held_out_after_export": part(math.nan, math.nan)},
    {"held_out_after_export": part(30.0, math.inf)}, {"held_out_after_export": part(None, None)},
])
def test_what_failed_is_not_to_be_used(changes):
    found = verdict(report(**changes))
    assert found.grade == UNUSABLE and found.sentence.startswith("Do not use this: ") and "nan" not in found.sentence.lower()
    assert "likeness" not in found.sentence and "inf" not in found.sentence.replace("finite", "")


def test_a_diverged_fit_still_tells_its_figures():
    assert verdict(report(stop_reason="diverged")).sentence == (
        "Do not use this: the error grew instead of falling (30 dB, relative error 0.01); 9 bytes a texel."
    )


def test_without_unseen_photographs_it_says_what_was_measured():
    found = verdict(report(held_out=None, held_out_after_export=None))
    assert found.sentence.startswith("Reproduces the photographs it was fitted to at 30.0 dB")
    assert found.cautions == ("No photographs were held out: on unseen ones it can be far worse. Give holdout=0.2 to know.",)
    assert verdict(report(held_out={}, held_out_after_export={})) == found  # what fit itself has there, and report.json
    nothing = verdict(report(train={}, held_out={}, held_out_after_export={}))
    assert (nothing.grade, nothing.sentence, nothing.cautions) == (UNKNOWN, "How true it is was not measured; 9 bytes a texel.", ())


@pytest.mark.parametrize(("by", "said"), [
    ("pair", "unseen pairs of light and view"), ("light", "unseen photographs"), ("view", "unseen photographs"),
])
def test_what_was_held_out_is_named(by, said):
    assert verdict(report(holdout_by=by)).sentence.startswith(f"Reproduces {said} at ")


@pytest.mark.parametrize(("bands", "said"), [
    ((("light", 60, 25.0), ("light", 75, 18.0), ("view", 60, 29.0)), ", and worse under grazing light (18.0 dB from 75°);"),
    ((("view", 60, 24.0),), ", and worse from grazing views (24.0 dB from 60°);"),
    ((("light", 60, 24.0), ("view", 75, 22.0)), ", and worse under grazing light (24.0 dB from 60°) and from grazing views (22.0 dB from 75°);"),
    ((("light", 0, 10.0), ("light", 60, 27.0), ("view", 75, math.nan), ("view", 60, None)), "side by side;"),
    ((), "side by side;"),
])
def test_grazing_directions_that_are_a_grade_worse_are_named(bands, said):
    assert said in verdict(alike(part(bands=bands))).sentence


@pytest.mark.parametrize(("changes", "said"), [
    ({"held_out": part(samples=1)}, "Only 1 unseen photograph: chance"),
    ({"held_out": part(samples=9)}, "Only 9 unseen photographs: chance"),
    ({"held_out_after_export": part(28.5)}, "Storing it as textures costs 1.5 dB"),
    ({"train": part(34.0)}, "It is 4.0 dB better on photographs that it saw"),
    ({"stop_reason": "budget spent"}, "its seconds were spent"), ({"stop_reason": "step limit"}, "it had made its steps"),
    ({"stop_reason": "directions left open"}, "Not everything is determined"),
    ({"figures": {"auto": {"short_by_db": 2.5}}}, "falls short of what was wanted by 2.5 dB"),
    ({"coverage": {"texels_not_fully_determined": 7}}, "7 of 4096 texels are not fully determined"),
    ({"source": {"clipped_share": 0.034, "invalid_share": 0.0}}, "3.4 % of the data is clipped"),
    ({"source": {"clipped_share": 0.0, "invalid_share": 0.25}}, "25 % of the data is invalid"),
])
def test_each_reason_to_beware_is_said_once_and_alone(changes, said):
    cautions = verdict(report(**changes)).cautions
    assert len(cautions) == 1 and said in cautions[0]


@pytest.mark.parametrize("changes", [
    {}, {"held_out": part(samples=10)}, {"held_out_after_export": part(29.2)}, {"train": part(32.9)}, {"coverage": None},
    {"figures": {"auto": {"short_by_db": 0}}}, {"source": {"clipped_share": 0.01, "invalid_share": 0.0}}, {"train": part(math.nan)},
    {"stop_reason": "a word of one's own solver"},
])
def test_without_a_reason_nothing_is_said(changes):
    assert verdict(report(**changes)).cautions == ()
