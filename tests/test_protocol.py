"""The benchmark that measures accuracy: rows are written one by one, and those that stand are not measured again."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import numpy as np
import pytest
from tests.support import all_pairs, hemisphere, plausible_images

import torchmat as tm

BENCH = Path(__file__).resolve().parents[1] / "scripts" / "bench"
FLAT = {"geometry": "flat"}
ASKED = {"data": ["a", "b"], "models": ["texture", "hsh:terms=4"], "ways": ["pair", "both"], "seeds": [0], "settings": FLAT}


@pytest.fixture(name="protocol")
def loaded(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(BENCH))
    module = importlib.import_module("protocol")
    for one in (module, importlib.import_module("measure")):
        monkeypatch.setattr(one, "RESULTS", tmp_path)
    return module


def made(lights, views):
    light, view = all_pairs(hemisphere(lights), hemisphere(views))
    return tm.Btf.from_tensors(plausible_images(light, view, 3, 4).astype(np.float32), light, view)


def tiny(name):
    """Two data sets, of which one has images off its grid."""
    grid = made(((0, 1), (40, 5)), ((0, 1), (50, 4)))
    return grid, made(((20, 4),), ((30, 4),)) if name == "a" else None


def rows_in(folder):
    return json.loads((folder / "protocol.json").read_text())["rows"]


def test_rows_hold_the_errors_of_what_is_exported(protocol, tmp_path):
    rows = protocol.protocol(**ASKED, source=tiny)
    assert len(rows) == 8 and rows_in(tmp_path) == json.loads(json.dumps(rows))
    row = next(row for row in rows if (row["data"], row["model"], row["by"]) == ("a", "hsh:terms=4", "both"))
    btf, test = tiny("a")
    result = tm.fit(btf, "hsh", holdout_by="both", terms=4, storage="png8", test=test)
    after, random = result.report["held_out_after_export"], result.report["test_after_export"]
    assert (row["dB"], row["error"], row["interval"]) == (after["psnr_db"], after["relative_error"], after["relative_error_interval"])
    assert (row["random dB"], row["random error"]) == (random["psnr_db"], random["relative_error"])
    assert row["bytes"] == result.report["bytes_per_texel"] and row["held out"] == len(result.split.held_out)
    assert not any("random dB" in row for row in rows if row["data"] == "b")


def test_what_stands_is_not_measured_again(protocol, tmp_path):
    class Stopped(Exception):
        pass

    def stops(name):
        if name == "b":
            raise Stopped
        return tiny(name)

    with pytest.raises(Stopped):
        protocol.protocol(**ASKED, source=stops)
    first = rows_in(tmp_path)
    assert len(first) == 4 and {row["data"] for row in first} == {"a"}
    asked = []
    rows = protocol.protocol(**ASKED, source=lambda name: asked.append(name) or tiny(name))
    assert asked == ["b"] and rows[:4] == first and len(rows) == 8
    protocol.protocol(**ASKED, source=stops)  # nothing is left to measure
    other = protocol.protocol(**{**ASKED, "data": ["a"], "settings": {**FLAT, "storage": "half"}}, source=tiny)
    assert all(row["bytes"] > first[0]["bytes"] for row in other[8:])
    assert len(other) == 12  # other settings are other rows
    assert len(protocol.protocol(**{**ASKED, "data": ["a"], "ways": ["pair"]}, source=tiny, again=True)) == 12


def test_a_row_that_failed_says_why_and_is_tried_again(protocol, tmp_path):
    asked = {**ASKED, "data": ["a"], "models": ["pca:components=900"], "ways": ["pair"]}
    for _ in range(2):
        (row,) = protocol.protocol(**asked, source=tiny)
        assert "Use at most" in row["failed"]
    assert protocol.summary([row]) == []


def test_a_setting_reaches_the_models_that_have_it(protocol):
    asked = {**ASKED, "data": ["a"], "models": ["texture", "hsh"], "ways": ["pair"]}
    rows = protocol.protocol(**{**asked, "settings": {**FLAT, "terms": 4}}, source=tiny)
    assert not any("failed" in row for row in rows) and rows[1]["bytes"] == 4 * rows[0]["bytes"]
    fewer = protocol.protocol(**asked, source=tiny)
    assert fewer[3]["bytes"] == 9 * rows[0]["bytes"]


def test_the_summary_pools_seeds_and_shows_directions_off_the_grid(protocol):
    def row(by, seed, error, **more):
        return {"data": "a", "model": "ptm:space=srgb", "settings": {"effort": 0.3}, "by": by, "seed": seed, "bytes": 9, "shared bytes": 50, "seconds": 2.0 + seed,
                "dB": 30.0, "error": error, "interval": [error / 2, error * 2], **more}

    off = {"random dB": 28.0, "random error": 0.08, "random interval": [0.07, 0.09]}
    lines = protocol.summary([row("pair", 0, 0.02, **off), row("both", 0, 0.1), row("pair", 1, 0.04, **off)])
    name = "ptm:space=srgb,effort=0.3"
    assert lines == [
        ["a", "new pair", name, 2, 9, 50, 2.5, "30.0", pytest.approx(0.03), "0.01 to 0.08"],
        ["a", "random directions", name, 2, 9, 50, 2.5, "28.0", pytest.approx(0.08), "0.07 to 0.09"],
        ["a", "new light and view", name, 1, 9, 50, 2.0, "30.0", 0.1, "0.05 to 0.2"],
    ]
