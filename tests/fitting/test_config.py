"""The TOML config and its overrides."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest

from torchmat import DataError, FitConfig, RangeError, fit, load_btf, load_config, sample_path
from torchmat.fitting import RECIPES, default_options
from torchmat.fitting.data_settings import DATA_KEYS
from torchmat.fitting.recipes import AUTO

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def write(folder, text, encoding="utf-8"):
    path = folder / "fit me ü.toml"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.toml")), ids=lambda path: path.stem)
def test_the_shipped_configs_load(path):
    assert load_config(path).model in (*RECIPES, AUTO)


def test_windows_line_ends_and_a_byte_order_mark(tmp_path):
    config = load_config(write(tmp_path, 'model = "hsh"\r\n[options]\r\nterms = 16\r\n', "utf-8-sig"))
    assert config.options == {"terms": 16}


def test_overrides_reach_into_tables(tmp_path):
    path = write(tmp_path, 'model = "phong_srf"\nseed = 1\n')
    config = load_config(path, ["options.residual=half_light", 'options.base="phong"', "seed = 5", "data.crop=[0,0,2,2]"])
    assert config.options == {"residual": "half_light", "base": "phong"}
    assert config.seed == 5 and config.data == {"crop": [0, 0, 2, 2]}


@pytest.mark.parametrize(("text", "overrides", "said"), [
    ('modle = "hsh"', [], "Did you mean 'model'"),
    ('model = "hsh"\n[options]\ntrems = 4', [], "Did you mean 'terms'"),
    ('model = "hsh"\n[data]\nencodings = "srgb"', [], "Did you mean 'encoding'"),
    ("model = 3", [], "model must be a str"),
    ("seed = true", [], "seed must be a int"),
    ("seed = 1.5", [], "seed must be a int"),
    ('model = "hsh"', ["options.terms=many"], "terms must be a whole number"),
    ('model = "hsh"', ["terms"], "KEY=VALUE"),
    ('model = "hsh"', ["=4"], "KEY=VALUE"),
    ('model = "hsh"', ["model.x=4"], "model is a value"),
    ('model = "hsh"', ["holdout_by=lite"], "Did you mean 'light'"),
    ('model = "hsh"', ["holdout=1.5"], "lie in"),
    ('model = "hsh"', ["options=3"], "options must be a dict"),
])
def test_what_is_not_understood_is_refused(text, overrides, said, tmp_path):
    with pytest.raises(RangeError, match=said):
        load_config(write(tmp_path, text), overrides)


@pytest.mark.parametrize(("text", "said"), [
    ("[data]\nkind = 3", "kind must be one of .*it is 3"),
    ('[data]\nkind = "ubo200"', "Did you mean 'ubo2003'"),
    ("[data]\nkind = []", "kind must be one of"),
    ('[data]\nencoding = "sRGB"', "encoding must be one of 'auto', 'srgb', 'linear'"),
    ('[data]\ninvalid = "masked"', "Did you mean 'mask'"),
    ("[data]\ninvalid = true", "invalid must be one of 'error', 'mask'; it is True"),
    ('[data]\nduplicates = "drop"', "duplicates must be one of"),
    ('[data]\nexposure = "2"', "exposure must be a positive number; it is '2'"),
    ("[data]\nexposure = 0", "exposure must be a positive number"),
    ("[data]\nexposure = inf", "exposure must be a positive number"),
    ("[data]\nexposure = true", "exposure must be a positive number"),
    ("[data]\ncrop = [0, 0, 4]", "crop must be four whole numbers"),
    ("[data]\ncrop = [0, 0, 4, 1.5]", "crop must be four whole numbers"),
    ('[data]\ncrop = "0,0,4,4"', "crop must be four whole numbers"),
    ("[data]\ndownscale = 0", "downscale must be a whole number"),
    ("[data]\ndownscale = 2.0", "downscale must be a whole number"),
    ("[data]\nlights = 3", "lights must be a list"),
    ("[data]\nviews = []", "views must be a list"),
    ("[data]\nviews = [-1]", "views must be a list"),
    ("[data]\nnormalise = 1", "normalise must be true or false"),
    ("[data]\nclipped_weight = nan", "clipped_weight must be a number from 0 to 1"),
    ("[data]\nclipped_weight = 1.5", "clipped_weight must be a number from 0 to 1"),
    ("[options]\nridge = nan", "ridge must be at least 0 and finite; it is nan"),
    ("[options]\nridge = -1", "ridge must be at least 0 and finite; it is -1"),
    ("[options]\nridge = inf", "ridge must be at least 0 and finite; it is inf"),
    ('model = "neural"\n[options]\nlatent = -3', "latent must be at least 0 and finite"),
    ('model = "distribution"\n[options]\neffort = nan', "effort must be at least 0 and finite"),
    ("memory_mb = nan", "memory_mb must be at least 0"),
    ("holdout = nan", "holdout must lie in"),
    ("[target]\nseconds = nan", "seconds must be a positive number"),
])
def test_what_cannot_be_names_the_file_and_the_key(text, said, tmp_path):
    with pytest.raises(RangeError, match=rf"fit me ü\.toml: .*{said}"):
        load_config(write(tmp_path, text))


def test_all_that_data_may_hold(tmp_path):
    text = """[data]
kind = "rti"
encoding = "linear"
exposure = 2
crop = [0, 1, 2, 3]
downscale = 2
lights = [0, 5]
views = [1]
invalid = "mask"
duplicates = "keep"
normalise = true
light_table = "lights.lp"
ball = "balls"
circle = [10.5, 12, 8]
intensities = "estimate"
mask = "alpha"
skip_bad_lights = true
near = 300
distance = 402.5
falloff = true
clipped_weight = 0
"""
    assert set(load_config(write(tmp_path, text)).data) == set(DATA_KEYS)
    keywords = inspect.signature(load_btf).parameters
    assert set(DATA_KEYS) == set(keywords) - {"path", "cache", "progress"}


@pytest.mark.parametrize("content", [b"model = ", b"\xff\xfe\x00", b"model = 'a'\nmodel = 'b'"])
def test_what_is_no_toml_names_the_file(content, tmp_path):
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"broken\.toml: the config must be (TOML|UTF-8)"):
        load_config(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DataError, match=r"nowhere\.toml: the config must be readable"):
        load_config(tmp_path / "nowhere.toml")


@pytest.mark.parametrize("model", RECIPES)
def test_every_default_is_of_a_kind_that_can_be_checked(model):
    assert all(type(value) in (bool, int, float, str) for value in default_options(model).values())


def test_a_name_without_suffix_is_a_model_and_one_with_it_a_config(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert load_config("distribution") == FitConfig(model="distribution")
    assert load_config("distribution.toml") == load_config(CONFIGS / "distribution.toml")
    assert load_config("distribution.toml").options == {"storage": "png8"}
    (tmp_path / "distribution.toml").write_text('model = "ptm"\n')
    assert load_config("distribution.toml").model == "ptm"  # what is there comes before what ships
    assert load_config("hsh", ["options.terms=16", "seed=5", "storage=png8"]) == FitConfig(
        model="hsh", options={"terms": 16, "storage": "png8"}, seed=5
    )


@pytest.mark.parametrize(("name", "overrides", "said"), [
    ("phong_srf_half_light", [], "Did you mean 'phong_srf_half_light.toml'"),
    ("phong_srff", [], "Did you mean 'phong_srf'"),
    ("hsh", ["trems=4"], "--set: key 'trems' must be one of: model, .*Did you mean 'terms'"),
    ("hsh", ["sede=4"], "Did you mean 'seed'"),
    ("hsh", ["terms=many"], "terms must be a whole number"),
    (7, [], "model must be one of .*it is 7"),
])
def test_a_name_that_is_none_suggests_the_nearest(name, overrides, said):
    with pytest.raises(RangeError, match=said):
        load_config(name, overrides)


def test_fit_takes_the_name_of_a_config_that_ships(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    btf = load_btf(sample_path(), cache=False, crop=(0, 0, 4, 4), progress=False)
    report = fit(btf, "ptm.toml", holdout=0, measure=False).report
    assert report["model"] == "ptm" and report["options"]["storage"] == "png8"


def test_a_finish_may_be_left_out_by_a_config():
    assert load_config("ptm").finish and not load_config("ptm", ["finish=false"]).finish
    with pytest.raises(RangeError, match="finish must be a bool; it is 'never'"):
        load_config("ptm", ["finish=never"])
