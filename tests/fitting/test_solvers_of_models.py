"""Models fitted by every solver that they offer: the same answer as the default road, limits, bits and errors."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, RangeError
from torchmat.fitting import RECIPES, default_options
from torchmat.fitting.models.any_model import Misfit, Seen
from torchmat.fitting.training import make_training
from torchmat.models.bases import BASES
from torchmat.models.lobes import LOBES
from torchmat.models.unbounded import Unbounded
from torchmat.report.comparison import parse_model
from torchmat.solvers.stop_reasons import BUDGET, CONVERGED, STEP_LIMIT

DIRECTIONS = hemisphere(((0, 1), (30, 4), (60, 6)))
LIGHT, VIEW = all_pairs(DIRECTIONS, DIRECTIONS)
STEPPED = [(model, solver) for model in ("texture", "ptm", "lambert", "lptm", "hsh", "phong_srf") for solver in ("adam", "lbfgs")]


def small(dtype=np.float32):
    return Btf.from_tensors(plausible_images(LIGHT, VIEW).astype(dtype), LIGHT, VIEW)


def training_error(btf, **given):
    return tm.fit(btf, holdout=0, progress=False, **given).report["train"]["relative_error"]


def test_every_model_names_its_solvers_and_the_first_is_the_default():
    for model, recipe in RECIPES.items():
        assert default_options(model)["solver"] == recipe.all_solvers[0]
    assert RECIPES["hsh"].all_solvers == ("closed_form", "adam", "minibatch", "lbfgs")
    assert RECIPES["phong_srf"].all_solvers[:2] == ("lm", "varpro") and RECIPES["pca"].all_solvers == ("closed_form",)


@pytest.mark.parametrize(("model", "solver"), [*STEPPED, ("ptm", "minibatch")])
def test_what_steps_comes_near_the_closed_form(model, solver):
    btf = small()
    # In codes of a screen the closed form makes another error small than what steps does by default.
    space = {"space": "linear"} if model in ("ptm", "lptm", "hsh") else {}
    best, found = (training_error(btf, model=model, **space, **given) for given in ({}, {"solver": solver}))
    assert best * (0.6 if model in ("phong_srf", "lambert", "lptm") else 0.999) <= found <= 1.1 * best + 1e-4


def test_lbfgs_stops_where_the_gradient_is_nearly_zero():
    btf = small(np.float64)
    training = make_training(btf, torch.arange(len(btf)), 0, True, torch.float64, False)
    with torch.no_grad():
        fitted = RECIPES["hsh"].run(training, solver="lbfgs", terms=4).material
    worse = fitted.with_maps(harmonic=fitted.maps["harmonic"] * 0.5)
    gradients = []
    for material in (worse, fitted):
        unknowns = Unbounded(material.own_specs(), material.maps)
        Misfit(Seen(training, material), unknowns)()
        gradients.append(float(unknowns.parameters[0].grad.norm()))
    assert gradients[1] < 1e-2 * gradients[0]


def test_the_objective_is_the_weighted_error_of_a_plain_loop():
    btf = small(np.float64)
    training = make_training(btf, torch.arange(0, len(btf), 2), 0, True, torch.float64, False)
    with torch.no_grad():
        material = RECIPES["texture"].run(training).material
    unknowns = Unbounded(material.own_specs(), material.maps)
    found = Misfit(Seen(training, material), unknowns)()
    above = below = 0.0
    for sample in range(0, len(btf), 2):
        target = btf.image(sample).double()
        above += float((material.maps["albedo"].detach() * float(LIGHT[sample, 2]) - target).square().sum())
        below += float(target.square().sum())
    assert found == pytest.approx(above / below, rel=1e-6)


def test_varpro_recovers_a_lobe_that_the_residual_hides():
    lobe, basis = LOBES["phong"], BASES["half"]
    truth = torch.tensor([0.5, 0.3, 0.2, 0.4, 0.3, 0.2, np.log(30.0)], dtype=torch.float64)
    light, view = (torch.from_numpy(rows)[:, :, None, None] for rows in (LIGHT, VIEW))
    generator = torch.Generator().manual_seed(5)
    texels = torch.rand(len(basis.terms), 3, 2, 3, generator=generator, dtype=torch.float64) * 0.1
    weights = basis.evaluate(light, view)[:, :, 0, 0]
    images = torch.einsum("nk,kchw->nchw", weights, texels) + lobe.evaluate(truth, light, view)
    assert float(images.min()) > 0  # the material never is negative
    btf = Btf.from_tensors(images.numpy(), LIGHT, VIEW)
    given = {"model": "phong_srf", "ridge": 0.0, "holdout": 0, "dtype": torch.float64, "progress": False}
    plain, projected = (tm.fit(btf, solver=solver, **given) for solver in ("lm", "varpro"))
    errors = [result.report["train"]["relative_error"] for result in (plain, projected)]
    assert errors[1] < 1e-20 and errors[0] > 1e-5
    assert_close(projected.material.maps["lobe"].detach(), truth, 1e-9)
    assert_close(projected.material.maps["residual"].detach(), texels.flatten(0, 1), 1e-9)
    assert projected.stop_reason == CONVERGED


def test_varpro_never_fits_worse_than_the_lobe_by_itself():
    btf = small()
    assert training_error(btf, model="phong_srf", solver="varpro") <= training_error(btf, model="phong_srf") * 1.001


def test_unknown_solvers_are_errors_with_the_nearest_name():
    with pytest.raises(RangeError, match="Did you mean 'adam'"):
        tm.fit(small(), "phong_srf", solver="adan")
    with pytest.raises(RangeError, match="solver must be one of 'closed_form'"):
        tm.FitConfig(model="pca", options={"solver": "lbfgs"})
    assert parse_model("phong_srf:solver=adam") == ("phong_srf", {"solver": "adam"})


def test_a_limit_of_seconds_stops_a_model_with_its_best():
    result = tm.fit(small(), "phong_srf", solver="minibatch", seconds=1e-3, progress=False)
    assert result.stop_reason == BUDGET and np.isfinite(result.report["held_out"]["relative_error"])


@pytest.mark.parametrize("solver", ["adam", "minibatch", "lbfgs"])
def test_15_bits_repeat_with_one_thread_and_with_two(solver):
    found, threads = [], torch.get_num_threads()
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            result = tm.fit(small(), "lptm", solver=solver, seconds=None, measure=False, progress=False)
            found.append(result.material.maps)
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(found[0][name], found[1][name]) for name in found[0])


@pytest.mark.parametrize("solver", ["adam", "lbfgs"])
def test_the_distribution_takes_every_solver(solver):
    options = {"lobes": 1, "fresnel": False, "rotation": False, "specular_size": 8, "effort": 0.2, "progress": False}
    result = tm.fit(small(), "distribution", geometry="flat", solver=solver, **options)
    assert result.stop_reason in (STEP_LIMIT, CONVERGED) and result.report["held_out"]["relative_error"] < 0.05


@pytest.mark.parametrize("left_out", [("lobes",), ("normal",), ("specular_mask",), ("normal", "specular_mask")])
def test_the_distribution_leaves_parts_out(left_out):
    options = {"lobes": 1, "fresnel": False, "rotation": False, **dict.fromkeys(left_out, False)}
    options |= {"lobes": 0} if "lobes" in left_out else {}
    material = tm.fit(small(), "distribution", geometry="flat", specular_size=8, effort=0.02, measure=False, progress=False, **options).material
    gone = {*left_out} | ({"specular", "specular_mask"} if "lobes" in left_out else set())
    assert not gone & set(material.maps) and "diffuse" in material.maps
    with pytest.raises(RangeError, match="fresnel must be left out without lobes"):
        tm.fit(small(), "distribution", geometry="flat", lobes=0, fresnel=True)
    with pytest.raises(RangeError, match="fresnel must be true or false, or 'auto'"):
        tm.fit(small(), "distribution", fresnel="yes")
    with pytest.raises(RangeError, match="lobes must be a whole number, or 'auto'"):
        tm.fit(small(), "distribution", lobes=True)


def test_the_distribution_finds_a_tilt():
    material = tm.fit(
        small(), "distribution", geometry="flat", lobes=1, fresnel=False, rotation=False, tilt=True, specular_size=8, effort=0.05, measure=False,
        progress=False,
    ).material
    assert material.maps["tilt"].shape == (1, 1, 91) and bool((material.maps["tilt"] > 0).all())
