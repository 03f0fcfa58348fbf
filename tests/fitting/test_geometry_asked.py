"""What a fit takes the surface for, asked in every way: a word, a path, a tensor, an array, a config."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from tests.fitting.reference_scene import relief_scene

import torchmat as tm
from torchmat import DataError, FitConfig, RangeError
from torchmat.fitting.geometry import Flat, Given, Recover, resolve_geometry
from torchmat.images import write_image


@pytest.fixture
def height_file(tmp_path):
    height = relief_scene().true_height.float()
    write_image(tmp_path / "height.exr", height.permute(1, 2, 0).numpy())
    return tmp_path / "height.exr", height


def test_words_are_resolved_and_a_misspelt_one_is_no_path():
    assert resolve_geometry("flat") == Flat() and resolve_geometry("recover") == Recover()
    assert resolve_geometry("auto", by_itself=True) == Recover()
    with pytest.raises(RangeError, match="recover"):
        resolve_geometry("recvoer")
    with pytest.raises(RangeError, match="recover"):
        FitConfig(geometry="recvoer")
    with pytest.raises(RangeError, match="auto"):
        FitConfig(model="ptm", geometry="auto")


def test_a_path_a_text_a_tensor_an_array_and_a_config_are_the_same_height(height_file):
    path, height = height_file
    for asked in (path, str(path), height, height[0], height.numpy(), height[0].double().numpy(), Given(height)):
        found = resolve_geometry(asked)
        assert isinstance(found, Given) and np.allclose(found.height.reshape(height.shape), height, atol=1e-7)
    btf = relief_scene().btf()
    results = [
        tm.fit(btf, "ptm", geometry=str(path), measure=False, progress=False),
        tm.fit(btf, FitConfig(model="ptm", geometry=str(path)), measure=False, progress=False),
        tm.fit(btf, "ptm", geometry=height, measure=False, progress=False),
    ]
    for result in results:
        assert result.report["geometry"] == "given"
        assert torch.equal(result.material.maps["height"], results[-1].material.maps["height"])
        assert torch.equal(result.material.maps["polynomial"], results[-1].material.maps["polynomial"])


def test_a_file_that_is_not_there_is_named():
    with pytest.raises(DataError, match="absent.exr"):
        resolve_geometry("absent.exr")
    with pytest.raises(RangeError, match="height map"):
        resolve_geometry(object())


QUICK = {"lobes": 1, "fresnel": False, "rotation": False, "specular_size": 8, "effort": 0.01, "measure": False, "progress": False}


def test_a_model_that_is_made_for_relief_recovers_it_unasked():
    scene = relief_scene(rows=12, columns=12)
    result = tm.fit(scene.btf(), "distribution", **QUICK)
    assert result.report["geometry"] == "recover" and result.report["figures"]["geometry"]["chosen"] == "recover"
    truth, found = scene.true_height, result.material.maps["height"].detach().double()
    both = torch.stack((truth.flatten(), found.flatten()))
    assert float(torch.corrcoef(both)[0, 1]) > 0.95
    assert tm.fit(scene.btf(), "ptm", measure=False).report["geometry"] == "flat"
    assert FitConfig(model="distribution").geometry_word == FitConfig(model="neural").geometry_word == "recover"
    assert FitConfig(model="ptm").geometry_word == "flat" and FitConfig(model="auto").geometry_word == "auto"


@pytest.mark.parametrize("more", [{}, {"tile_size": 16}])
def test_where_nothing_can_be_recovered_only_an_explicit_wish_is_an_error(more):
    scene = relief_scene()
    leaning = scene.view[:, 2] < 0.6  # 53 degrees and more: photometric stereo has no view to start from
    btf = tm.Btf.from_tensors(scene.images[leaning].astype(np.float32), scene.light[leaning], scene.view[leaning])
    report = tm.fit(btf, "distribution", **QUICK, **more).report
    assert report["figures"]["geometry"]["chosen"] == "flat"
    assert "view within 45 degrees" in report["figures"]["geometry"]["not_recovered"]
    with pytest.raises(tm.FitError, match="view within 45 degrees"):
        tm.fit(btf, "distribution", geometry="recover", **QUICK, **more)


def test_a_comparison_takes_a_height_map_and_leaves_each_model_its_own_way(height_file):
    path, height = height_file
    btf = relief_scene().btf()
    rows = tm.compare(btf, ["ptm", "ptm:geometry=flat", f"texture:geometry={path}"], geometry=height, curves=False, progress=False)
    assert [row["geometry"] for row in rows] == ["given", "flat", "given"]
    assert rows[0]["relative_error"] < rows[1]["relative_error"]
    with pytest.raises(RangeError, match="recover"):
        tm.compare(btf, ["ptm:geometry=recvoer"])


def test_a_recipe_names_a_geometry_that_there_is():
    recipe = tm.fitting.recipe.recipe_of("ptm")
    with pytest.raises(RangeError, match="geometry must be one of 'flat', 'recover'"):
        dataclasses.replace(recipe, geometry="recvoer")
