"""What models and their options are said to be, against what they take."""

from __future__ import annotations

import re

import pytest
from tests.fitting.ggx_model import RECIPE

import torchmat as tm
from torchmat import Material, RangeError, Recipe
from torchmat.cli import main
from torchmat.docstrings import documented_arguments
from torchmat.fitting.recipe import RECIPES, unregister


@pytest.fixture(scope="module")
def btf():
    return tm.load_btf(tm.sample_path(), cache=False, crop=(0, 0, 6, 6), progress=False)


def fitted(btf, model, **options):
    quick = {"effort": 0.01} if "effort" in RECIPES[model].options else {}
    return tm.fit(btf, model, geometry="flat", holdout=0, measure=False, progress=False, **{**quick, **options})


@pytest.mark.parametrize("model", RECIPES)
def test_every_option_has_its_default_and_a_meaning(model):
    said = tm.describe_model(model)
    assert {one.name: one.default for one in said.options} == RECIPES[model].options
    for one in said.options:
        assert len(one.meaning.split()) > 3, f"{one.name} of {model} is not explained under Args: of its fit"
    extra = set(documented_arguments(RECIPES[model].way)) - {one.name for one in said.options}
    assert not extra, f"{extra} are explained, but no options of {model}"


@pytest.mark.parametrize("model", RECIPES)
def test_the_choices_of_an_option_are_those_that_it_takes(btf, model):
    for one in tm.describe_model(model).options:
        if isinstance(one.default, str):
            with pytest.raises(RangeError, match=one.name) as refused:
                fitted(btf, model, **{one.name: "nonsense"})
            choices = re.findall(r"'(\w+)'", str(refused.value).partition(" must be ")[2].partition("; it is")[0])
            assert set(re.findall(r'"(\w+)"', one.meaning)) == set(choices), (model, one.name)


@pytest.mark.parametrize(("model", "option", "outside"), [
    ("hsh", "terms", 10), ("pca", "components", 0), ("local_pca", "clusters", 0), ("local_pca", "components", 0),
    ("sphere_images", "pictures", 1), ("sphere_images", "size", 1), ("sphere_images", "smoothness", 0.0),
    ("shading_map", "slices", 1), ("shading_map", "slices", 65), ("shading_map", "azimuths", 0),
    ("shading_map", "azimuths", 37), ("distribution", "lobes", 13), ("distribution", "specular_size", 3),
    ("distribution", "specular_size", 1025), ("distribution", "effort", 0.0), ("neural", "latent", 0),
    ("neural", "latent", 1025), ("neural", "hidden", 0), ("neural", "layers", 0), ("neural", "effort", 0.0),
    ("microfacet", "effort", 0.0),
    ("phong_srf", "ridge", -1.0),
])
def test_the_ends_of_a_range_are_those_that_are_refused(btf, model, option, outside):
    with pytest.raises(RangeError, match=option):
        fitted(btf, model, **{option: outside})
    meaning = next(one.meaning for one in tm.describe_model(model).options if one.name == option)
    assert re.search(r"\d", meaning), (model, option)


@pytest.mark.parametrize("model", RECIPES)
def test_bytes_are_those_of_a_fit(btf, model):
    ends = [float(one) for one in RECIPES[model].bytes_per_texel.split(" to ")]
    components = {"components": 8} if model == "local_pca" else {}
    assert ends[0] <= fitted(btf, model, **components).report["bytes_per_texel"] <= ends[-1]


def test_a_model_from_outside_is_described_as_the_others_are(capsys):
    tm.register(RECIPE)
    try:
        said = tm.describe_model("outside_ggx")
        assert main(["models", "outside_ggx"]) == 0 and "GGX alpha to begin with" in capsys.readouterr().out
        assert [one.name for one in tm.describe_models()] == list(RECIPES)
    finally:
        unregister("outside_ggx")
    assert said.bytes_per_texel == "" and said.solvers == ("minibatch", "adam", "lbfgs")
    roughness = said.options[0]
    assert (roughness.name, roughness.default, roughness.kind) == ("roughness", 0.3, "a number")
    assert {one.name for one in said.options} == {"roughness", "storage", "steps", "rate", "solver", "objective"}
    assert all(one.meaning for one in said.options)


def test_an_option_without_a_meaning_is_shown_all_the_same():
    class Silent(Material):
        name = "silent"

    tm.register(Recipe(Silent, start=lambda training, *, size=3: None))
    try:
        said = tm.describe_model("silent")
    finally:
        unregister("silent")
    assert (said.options[0].name, said.options[0].default, said.options[0].meaning) == ("size", 3, "")
    assert "size = 3  (a whole number)" in str(said)


def test_the_commands_print_the_table_and_each_option(capsys):
    assert main(["models"]) == 0
    table = capsys.readouterr().out
    for name in RECIPES:
        assert f"| {name} " in table
    assert "closed_form, adam, minibatch, lbfgs | A colour per texel times the cosine of the light." in table
    assert main(["models", "distribution"]) == 0
    said = capsys.readouterr().out
    assert "specular_size = 48  (a whole number)" in said and "lobes = auto  (a whole number, or 'auto')" in said and "4 to 1024" in said
    assert main(["models", "shading_map"]) == 0 and "joint = true  (true or false)" in capsys.readouterr().out
    assert main(["models", "distributoin"]) == 2 and "Did you mean 'distribution'" in capsys.readouterr().err


def test_arguments_are_read_from_the_section_that_lists_them():
    def function(a, b, c, **more):
        """Do it.

        Args:
            a: one line
                and another: with a colon.
            b, c: both

                after a gap
            **more: the rest

        Raises:
            d: no argument
        """

    assert documented_arguments(function) == {
        "a": "one line and another: with a colon.", "b": "both after a gap", "c": "both after a gap", "more": "the rest",
    }
    assert documented_arguments(lambda a: a) == {}
