"""What a fit takes the surface for, asked in every way: a word, a path, a tensor, an array, a config."""

from __future__ import annotations

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
