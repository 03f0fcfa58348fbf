"""Fits of the microfacet material: recovery of what an oracle made, parts that pay, and what samples leave open."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.models.examples import PLAIN
from tests.reference import materials as oracle
from tests.support import all_pairs, assert_close, hemisphere

import torchmat as tm
from torchmat import FitError, RangeError
from torchmat.errors import Notice
from torchmat.fitting.models.any_model import Misfit, Seen
from torchmat.fitting.models.microfacet.fit import OPTIONAL
from torchmat.fitting.models.microfacet.start import _solved, find_start
from torchmat.fitting.recipe import RECIPES
from torchmat.fitting.relief.surface import bring_onto
from torchmat.fitting.training import make_training
from torchmat.models import Microfacet
from torchmat.models.unbounded import Unbounded

LIGHT, VIEW = all_pairs(hemisphere(((10, 4), (30, 6), (55, 8), (74, 8))), hemisphere(((0, 1), (25, 4), (55, 6))))
SIZE = (2, 3)


def truth(parts=(), **given) -> dict[str, np.ndarray]:
    """Return maps of a small plastic, brushed where `anisotropy` is among the parts."""
    rng = np.random.default_rng(3)
    maps = {
        "diffuse": rng.uniform(0.1, 0.5, (3, *SIZE)), "specular_f0": np.full((3, *SIZE), 0.06),
        "roughness": rng.uniform(0.5, 0.6, (1, *SIZE)),
    }
    if "anisotropy" in parts:
        angle = rng.uniform(0, math.pi, SIZE)
        maps |= {"roughness": np.stack((np.full(SIZE, 0.75), np.full(SIZE, 0.45))), "rotation": np.stack((np.cos(angle), np.sin(angle)))}
        maps["specular_f0"] = np.full((3, *SIZE), 0.7)
    return maps | given


def btf_of(maps, parts=(), light=LIGHT, view=VIEW) -> tm.Btf:
    options = {"parts": list(parts)}
    images = [oracle.shade("microfacet", maps, options, l[:, None, None], v[:, None, None], *SIZE) for l, v in zip(light, view, strict=True)]
    return tm.Btf.from_tensors(np.stack(images).astype(np.float32), light, view)


def fitted(btf, **options):
    return tm.fit(btf, "microfacet", progress=False, **{"geometry": "flat", "effort": 0.3, "normal": False, **PLAIN, **options})


def test_an_isotropic_plastic_is_recovered():
    maps = truth()
    result = fitted(btf_of(maps))
    found = {name: value.detach().double() for name, value in result.material.maps.items()}
    assert result.report["held_out"]["relative_error"] < 1e-4
    for name, bound in (("diffuse", 0.02), ("roughness", 0.03), ("specular_f0", 0.15)):
        assert float((found[name] / torch.from_numpy(maps[name]) - 1).abs().max()) < bound, name


def test_a_brushed_metal_is_recovered_and_its_anisotropy_pays():
    parts = ("anisotropy",)
    maps = truth(parts)
    result = fitted(btf_of(maps, parts), anisotropy="auto")
    assert result.material.options["parts"] == ["anisotropy"]
    assert result.report["figures"]["trials"][0]["kept"] and result.report["held_out"]["relative_error"] < 2e-3
    turn, wanted = result.material.maps["rotation"].detach().double(), torch.from_numpy(maps["rotation"])
    assert float((turn * wanted).sum(dim=0).abs().min()) > math.cos(math.radians(3))
    assert_close(result.material.maps["roughness"].detach().double(), torch.from_numpy(maps["roughness"]), 0.06)


def test_an_isotropic_surface_gets_no_rotation_and_what_does_not_pay_is_left_out():
    result = fitted(btf_of(truth()), anisotropy="auto", sheen="auto", effort=0.1)
    assert result.material.options["parts"] == [] and [one["part"] for one in result.report["figures"]["trials"]] == ["anisotropy", "sheen"]


def test_a_layer_pays_where_there_is_one():
    parts = ("layered",)
    result = fitted(btf_of(truth(specular_f0=np.full((3, *SIZE), 0.15)), parts), layered="auto")
    assert result.material.options["parts"] == ["layered"] and result.report["held_out"]["relative_error"] < 1e-3


def test_what_one_view_leaves_open_is_left_out_and_said():
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1),)))
    btf = btf_of(truth(), light=light, view=view)
    with pytest.warns(Notice, match="f90, coat, layered stay undetermined and are left out: there is one view"):
        result = fitted(btf, **dict.fromkeys(OPTIONAL, "auto"), effort=0.02)
    assert set(result.report["figures"]["undetermined"]) == {"f90", "coat", "layered"}
    assert not {"f90", "coat", "layered"} & set(result.material.options["parts"])
    with pytest.raises(RangeError, match="coat must be determined by the samples; there is one view"):
        fitted(btf, coat=True)


def test_half_vectors_in_one_plane_say_nothing_of_a_direction():
    line = np.stack((np.sin(np.linspace(-1, 1, 9)), np.zeros(9), np.cos(np.linspace(-1, 1, 9))), axis=1)
    light, view = all_pairs(line, np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]))
    btf = btf_of(truth(), light=light, view=view)
    with pytest.warns(Notice, match="anisotropy stay undetermined"):
        result = fitted(btf, anisotropy="auto", effort=0.02)
    assert result.material.options["parts"] == []


def test_lights_below_the_horizon_alone_are_refused():
    images = np.ones((4, 3, *SIZE), np.float32)
    below = np.tile([0.6, 0.0, -0.8], (4, 1))
    with pytest.raises(FitError, match="lit from above"):
        fitted(tm.Btf.from_tensors(images, below, np.tile([0.0, 0.0, 1.0], (4, 1))), holdout=0)


@pytest.mark.parametrize("scale", [1e-6, 1e3])
def test_data_of_another_exposure(scale):
    btf = btf_of(truth())
    other = tm.Btf.from_tensors(btf.images(torch.arange(len(btf))).numpy() * np.float32(scale), LIGHT, VIEW)
    assert fitted(other, effort=0.1, storage="float").report["held_out"]["relative_error"] < 0.05


def test_the_start_meets_what_a_lobe_of_the_grid_made():
    maps = truth(roughness=np.full((1, *SIZE), 0.45), specular_f0=np.full((3, *SIZE), 0.3))
    training = make_training(btf_of(maps), torch.arange(len(LIGHT)), 0, True, torch.float64, False)
    surface = bring_onto(training, torch.zeros(1, *SIZE, dtype=torch.float64))
    start = find_start(surface, 0.2, False, False)
    assert_close(start.roughness, torch.full((2, *SIZE), 0.45, dtype=torch.float64), 1e-9)
    # The normals of the start are those of photometric stereo, which highlights disturb.
    assert_close(start.diffuse, torch.from_numpy(maps["diffuse"]), 0.1)


def test_two_unknowns_that_are_not_negative_by_hand():
    """Sums of normal equations of (2, 1), (-1, 1) and (1, -1): with the negative one at 0 the other is solved alone."""
    one, both, other = 2.0, 0.5, 1.0
    wanted = [(2.0, 1.0), (-1.0, 1.0), (1.0, -1.0)]
    first = torch.tensor([[one * d + both * f for d, f in wanted]], dtype=torch.float64)[..., None, None]
    second = torch.tensor([[both * d + other * f for d, f in wanted]], dtype=torch.float64)[..., None, None]
    columns = torch.tensor([one, both, other], dtype=torch.float64)[None, :, None, None]
    diffuse, f0, _ = _solved(columns, torch.stack((first, second)), torch.zeros(1, 1, 1, dtype=torch.float64))
    assert_close(diffuse[0, :, 0, 0], torch.tensor([2.0, 0.0, 1.0 - 0.25], dtype=torch.float64), 1e-3)
    assert_close(f0[0, :, 0, 0], torch.tensor([1.0, 0.5, 0.0], dtype=torch.float64), 1e-3)


def test_a_prior_adds_its_cost_and_gradient():
    training = make_training(btf_of(truth()), torch.arange(len(LIGHT)), 0, True, torch.float64, False)
    maps = {name: torch.from_numpy(value) for name, value in truth().items()}
    material = Microfacet(maps)
    values = []
    for prior in (None, lambda maps: 3 * maps["roughness"].square().sum()):
        unknowns = Unbounded(material.own_specs(), material.maps, ["diffuse", "specular_f0"])
        value = Misfit(Seen(training, material), unknowns, "linear", prior)(torch.arange(5))
        values.append((value, unknowns.parameters[0].grad.clone()))
    r = maps["roughness"]
    assert abs(values[1][0] - values[0][0] - float(3 * r.square().sum())) < 1e-9
    assert_close(values[1][1] - values[0][1], 6 * r * r * (1 - r), 1e-6)  # of a logit


def test_its_ladder_asks_for_options_that_there_are():
    recipe = RECIPES["microfacet"]
    assert recipe.ladder is not None and set(recipe.ladder.bare) <= set(recipe.options)
    assert {name for part in recipe.ladder.parts for name in part.options} == set(recipe.ladder.bare)
