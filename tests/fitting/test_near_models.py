"""Every model under near lights: what it makes of them, against what it makes of the same lights taken for far."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.fitting.near_data import dome, scene, towards
from tests.support import assert_close

from torchmat import Btf, RangeError, fit
from torchmat.fitting import RECIPES
from torchmat.fitting.models.by_cell import cells_of
from torchmat.fitting.models.centred import centred
from torchmat.fitting.training import make_training

SIZE = (12, 16)
FLAT, UP = np.zeros(SIZE), np.stack((np.zeros(SIZE), np.zeros(SIZE), np.ones(SIZE)))
LIGHTS = dome(60, highest_deg=65)
TINT = 0.6 + 0.3 * np.random.default_rng(1).random((3, *SIZE))


def glossy(light: np.ndarray, view: np.ndarray | None = None) -> np.ndarray:
    """Return values of a surface with a broad highlight, all texels of one reflectance times a colour."""
    half = light + (UP if view is None else view)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    return TINT * (0.4 * light[:, 2:3] + 0.5 * half[:, 2:3] ** 12)


@pytest.fixture(scope="module")
def made():
    return scene(glossy, FLAT, UP, LIGHTS, np.float32)


_OFF = dict.fromkeys(("anisotropy", "coat", "sheen", "f90", "layered", "rolloff"), False)
# How much of the error that the far assumption leaves on held-out lights is still there. What is brought to the centre by smooth
# functions, and weighs measured images, is as far off as those functions and the gaps between lights are.
CASES = {
    "texture": ({}, 0.98), "lambert": ({}, 0.7), "ptm": ({"space": "linear"}, 0.2), "lptm": ({"space": "linear"}, 0.5),
    "hsh": ({"space": "linear"}, 0.1), "phong_srf": ({"residual": "cosine"}, 0.15), "pca": ({"components": 8}, 0.5),
    # Principal images hold what near lamps do to each photograph: taken for far they are no worse, 4e-5 where centred ones have 7e-5.
    "rbf": ({}, 2.0),
    "local_pca": ({"components": 4, "clusters": 2}, 0.5), "sphere_images": ({"size": 16, "pictures": 2}, 0.15),
    "shading_map": ({"slices": 8}, 0.5), "distribution": ({"effort": 0.04, "lobes": 1, "fresnel": False, "rotation": False}, 0.8),
    "neural": ({"effort": 0.02, "latent": 2, "hidden": 8, "layers": 1}, 0.95), "microfacet": ({"effort": 0.05, **_OFF}, 0.98),
}


def test_every_model_has_a_case():
    assert set(CASES) == set(RECIPES)


@pytest.mark.parametrize("model", CASES)
def test_near_lights_are_better_than_far_ones(made, model):
    options, share = CASES[model]
    found = []
    for data in (made.btf, made.far):
        report = fit(data, model, geometry="flat", measure="quick", progress=False, **options).report
        found.append(report["held_out"]["relative_error"])
    assert found[0] < share * found[1], found


def test_what_is_brought_to_the_centre_is_what_far_lights_show(made):
    training = make_training(made.btf, torch.arange(60), 0, True, torch.float64, False)
    far, said = centred(training)
    truth = glossy(np.broadcast_to(made.btf.light.double().numpy()[:, :, None, None], (60, 3, *SIZE)).copy())
    images = far.btf.images(range(60), torch.float64).numpy()
    before = made.btf.images(range(60), torch.float64).numpy()
    assert np.abs(images - truth).mean() < 0.1 * np.abs(before - truth).mean() and "hsh9" in said
    assert far.btf.near is None and fit(made.btf, "pca", components=4).report["figures"]["near"] == said


def test_cells_have_the_directions_of_their_middles(made):
    training = make_training(made.btf, torch.arange(60), 0, True, torch.float64, False)
    cells = cells_of(training)
    assert cells.values.shape == (60 * 64, 3) and torch.equal(cells.sample.unique(), torch.arange(60))
    place = (cells.sample == 7).nonzero()[2 * 8 + 1, 0]
    gap = LIGHTS[7] - np.array([-0.5 + 1.5 / 8, 0.375 - 2.5 * 0.75 / 8, 0])
    assert_close(cells.light[place, :, 0, 0], torch.from_numpy(gap / np.linalg.norm(gap)), 1e-6)


def test_variable_projection_has_no_shared_design_here(made):
    with pytest.raises(RangeError, match="varpro.*directions that all texels share.*btf.far"):
        fit(made.btf, "phong_srf", solver="varpro", measure="none")


def test_a_tile_is_a_part_of_the_whole(made):
    whole, tiled = (fit(made.btf, "phong_srf", residual="cosine", measure="none", progress=False, **more).material for more in ({}, {"tile_size": 8}))
    assert_close(tiled.maps["residual"], whole.maps["residual"], 0.02)


def test_the_automatic_choice_takes_near_lights(made):
    found = fit(made.btf, "auto", error=0.003, geometry="flat", progress=False).report
    assert found["held_out"]["relative_error"] < 0.003 and found["source"]["near"]["light_distance"][0] == pytest.approx(4 / 3)


def test_near_cameras():
    light = (LIGHTS / np.linalg.norm(LIGHTS, axis=1)[:, None])[::-1].copy()
    views = dome(60, 1.6, 50)
    away, _ = towards(views, FLAT)
    images = glossy(np.broadcast_to(light[:, :, None, None], away.shape).copy(), away)
    near = Btf.from_tensors(images.astype(np.float32), light, None, view_position=views)
    for model, options in (("phong_srf", {"residual": "half_light"}), ("sphere_images", {"size": 16, "pictures": 4})):
        errors = [fit(data, model, geometry="flat", measure="quick", progress=False, **options).report["held_out"]["relative_error"] for data in (near, near.far())]
        assert errors[0] < 0.6 * errors[1], (model, errors)
