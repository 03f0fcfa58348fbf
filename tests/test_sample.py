"""The embedded sample: what it promises, against its own truth."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import torchmat as tm


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    return tm.load_btf(tm.sample_path(), cache=tmp_path_factory.mktemp("cache"))


def test_size_and_directions(sample):
    assert (len(sample.lights), len(sample.views), len(sample)) == (25, 25, 625)
    assert (sample.height, sample.width) == (64, 64)
    assert sample.encoding == "linear"


def test_it_ships_in_under_four_megabytes():
    path = tm.sample_path()
    assert path.stat().st_size + path.with_name("sample_truth.npz").stat().st_size < 4_000_000


def test_truth_normals_are_unit_and_agree_with_the_slope_of_the_height():
    truth = tm.sample_truth()
    height, normal = truth["height"], truth["normal"]
    assert np.abs(np.linalg.norm(normal, axis=0) - 1).max() < 1e-5
    assert abs(height.mean()) < 1e-6
    width = height.shape[1]
    right = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) * width / 2
    up = (np.roll(height, 1, 0) - np.roll(height, -1, 0)) * width / 2
    for slope, component in ((right, normal[0]), (up, normal[1])):
        assert np.corrcoef(slope.ravel(), (-component / normal[2]).ravel())[0, 1] > 0.95


def test_frontal_images_show_the_true_shading(sample):
    """The matte ground under a low light from +x is brighter where its normal leans to +x, and from +y to +y."""
    truth = tm.sample_truth()
    matte = torch.from_numpy(truth["gloss_mask"] < 0.05)
    frontal = int(sample.views[:, 2].argmax())
    for axis in (0, 1):
        lights = sample.lights[:, axis] * (sample.lights[:, 2] > 0.5)
        image = _image(sample, frontal, int(lights.argmax())) - _image(sample, frontal, int(lights.argmin()))
        lean = torch.from_numpy(truth["normal"][axis])
        pair = torch.stack((image.mean(0)[matte], lean[matte]))
        assert float(torch.corrcoef(pair)[0, 1]) > 0.8


def _image(btf, view: int, light: int):
    return btf.image(int(((btf.view_index == view) & (btf.light_index == light)).nonzero()[0, 0]))


@pytest.fixture(scope="module")
def off_grid(tmp_path_factory):
    return tm.load_btf(tm.sample_path("random"), cache=tmp_path_factory.mktemp("cache"))


def test_random_directions_lie_between_those_of_the_grid(sample, off_grid):
    assert (len(off_grid), len(off_grid.lights), len(off_grid.views)) == (36, 36, 36)
    assert tm.sample_path("random").stat().st_size < 400_000
    for which in ("light", "view"):
        found = getattr(off_grid, which)
        nearest = float((found @ getattr(sample, f"{which}s").T).max())
        assert nearest < np.cos(np.radians(4)) + 1e-6 and float(found[:, 2].min()) > np.cos(np.radians(72)) - 1e-4


def test_random_directions_are_of_the_same_material_in_the_same_frame(sample, off_grid):
    """What a fit to the grid says of them is nearer to them than to what they would be mirrored, turned or swapped."""
    material = tm.fit(sample, "phong_srf", residual="half_light", geometry="flat", holdout=0, measure=False).material
    every, mirror = torch.arange(36), torch.tensor([-1.0, 1, 1])

    def error(light, view):
        other = tm.Btf.from_tensors(off_grid.images(every), light, view)
        return tm.evaluate(material, other, every, perceptual=False).report["relative_error"]

    light, view = off_grid.light, off_grid.view
    right = error(light, view)
    assert right < 0.04  # measured 0.033; of pairs of the grid, of which more are grazing, 0.061
    for wrong in ((light * mirror, view * mirror), (light * mirror.roll(1), view * mirror.roll(1)), (view, light)):
        assert error(*wrong) > 2 * right


def test_missing_sample_is_said(monkeypatch):
    monkeypatch.setattr("torchmat.sample.FOLDER", "nowhere")
    with pytest.raises(tm.DataError, match="make_sample.py.$"):
        tm.sample_path()
    with pytest.raises(tm.DataError, match="make_sample.py --random 36"):
        tm.sample_path("random")
    with pytest.raises(tm.RangeError, match="directions must be one of 'grid', 'random'"):
        tm.sample_path("rings")
