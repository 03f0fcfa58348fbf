"""Solvers and objectives as objects: what they say, what they refuse, and that they mean what the names mean."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.fitting.ggx_model import RECIPE, Ggx
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, Material, RangeError
from torchmat.fitting import RECIPES, load_config
from torchmat.fitting.models.any_model import Misfit, Seen
from torchmat.fitting.recipe import unregister
from torchmat.fitting.training import make_training
from torchmat.models.storage import MapSpec
from torchmat.models.unbounded import Unbounded
from torchmat.solvers import SOLVERS, as_solver

LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (30, 4), (60, 6))), hemisphere(((0, 1), (40, 5))))
SMALL = {"lobes": 1, "fresnel": False, "rotation": False, "specular_size": 8, "geometry": "flat", "specular_spacing": "even"}


@pytest.fixture(scope="module")
def btf():
    return Btf.from_tensors(plausible_images(LIGHT, VIEW, 4, 5).astype(np.float32), LIGHT, VIEW)


@pytest.fixture
def registered():
    tm.register(RECIPE)
    yield "outside_ggx"
    unregister("outside_ggx")


def fitted(btf, model, **options):
    return tm.fit(btf, model, measure=False, progress=False, **options)


def same_bits(one, other):
    return all(torch.equal(value, other.material.maps[name]) for name, value in one.material.maps.items())


NAMED = [("ptm", "adam", tm.Adam()), ("ptm", "lbfgs", tm.LBFGS()), ("texture", "minibatch", tm.Minibatch()), ("ptm", "closed_form", tm.ClosedForm()),
         ("phong_srf", "lm", tm.LevenbergMarquardt()), ("phong_srf", "varpro", tm.VariableProjection())]


@pytest.mark.parametrize(("model", "name", "solver"), NAMED, ids=[name for _, name, _ in NAMED])
def test_an_object_without_settings_is_its_name(btf, model, name, solver):
    by_name, by_object = fitted(btf, model, solver=name), fitted(btf, model, solver=solver)
    assert same_bits(by_name, by_object)
    assert by_name.report["options"]["solver"] == by_object.report["options"]["solver"] == name


def test_an_object_says_what_the_options_said(btf, registered):
    by_options = fitted(btf, registered, solver="adam", steps=20, rate=0.1)
    by_object = fitted(btf, registered, solver=tm.Adam(steps=20, rate=0.1))
    assert same_bits(by_options, by_object) and by_object.report["figures"]["steps"] == 20
    assert not same_bits(by_object, fitted(btf, registered, solver=tm.Adam(steps=20, rate=0.2)))
    with pytest.raises(RangeError, match="steps must be given once; the solver has 20 and steps is 30"):
        fitted(btf, registered, solver=tm.Adam(steps=20), steps=30)
    with pytest.raises(RangeError, match="rate must be left out with lbfgs"):
        fitted(btf, registered, solver=tm.LBFGS(), rate=0.1)


@pytest.mark.parametrize("solver", [tm.Minibatch(steps=30, rate=0.1, batch=3), tm.Adam(12, 0.05), tm.LBFGS(steps=8)])
def test_the_distribution_and_its_settings(btf, solver):
    result = fitted(btf, "distribution", solver=solver, **SMALL)
    assert result.report["figures"]["solver_steps"] == solver.steps
    assert not same_bits(result, fitted(btf, "distribution", solver=type(solver)(steps=2 * solver.steps), **SMALL))


def test_the_network_and_its_settings(btf):
    small = {"latent": 2, "hidden": 4, "geometry": "flat"}
    result = fitted(btf, "neural", solver=tm.Minibatch(steps=25, rate=0.003, batch=4), **small)
    assert result.report["figures"]["adam_steps"] == 25
    assert not same_bits(result, fitted(btf, "neural", solver=tm.Minibatch(steps=25, rate=0.003, batch=5), **small))


def test_fewer_steps_of_levenberg_marquardt_are_fewer(btf):
    short, whole = (fitted(btf, "phong_srf", solver=tm.VariableProjection(steps, 1e-30)) for steps in (1, None))
    assert short.stop_reason == "step limit" and not same_bits(short, whole)


def test_a_report_is_json_that_gives_the_same_fit_again(btf, tmp_path):
    first = fitted(btf, "ptm", solver=tm.Minibatch(steps=40, batch=6), objective="display")
    options = json.loads(json.dumps(first.report["options"]))
    assert options["solver"] == {"name": "minibatch", "steps": 40, "batch": 6} and options["objective"] == "display"
    assert same_bits(first, fitted(btf, "ptm", **options))
    (tmp_path / "fit.toml").write_text(
        'model = "ptm"\n[options]\nobjective = "display"\n[options.solver]\nname = "minibatch"\nsteps = 40\nbatch = 6\n'
    )
    assert same_bits(first, fitted(btf, tmp_path / "fit.toml"))
    again = load_config(tmp_path / "fit.toml", ["options.solver.steps=2"])
    assert not same_bits(first, fitted(btf, again))


def test_a_material_says_how_it_was_fitted_on(btf):
    material = fitted(btf, "texture").material
    report = fitted(btf, material, steps=5).report
    assert report["options"] == {"solver": {"name": "minibatch", "steps": 5, "rate": 0.03}, "objective": "linear", "keep": []}
    assert json.loads(json.dumps(report["options"])) == report["options"]


@pytest.mark.parametrize(("model", "solver", "says"), [
    ("ptm", tm.LevenbergMarquardt(), "solver must be one of 'closed_form', 'adam', 'minibatch', 'lbfgs'; it is 'lm'"),
    ("pca", tm.Adam(), "solver must be one of 'closed_form'; it is 'adam'"),
    ("distribution", tm.ClosedForm(), "solver must be one of 'minibatch', 'adam', 'lbfgs'; it is 'closed_form'"),
    ("ptm", {"name": "adam", "step": 3}, "key 'step' must be one of: steps, rate, tolerance; it is unknown. Did you mean 'steps'"),
    ("ptm", {"steps": 3}, "solver must be one of .*; it is None"), ("ptm", 7, "solver must be one of .*; it is 7"),
])
def test_what_does_not_suit_is_refused_with_the_names_that_do(btf, model, solver, says):
    with pytest.raises(RangeError, match=says):
        fitted(btf, model, solver=solver)


@pytest.mark.parametrize(("kind", "settings", "says"), [
    (tm.Adam, {"steps": 0}, "Adam: steps must be a whole number of at least 1; it is 0"), (tm.Adam, {"steps": 2.5}, "steps"),
    (tm.Minibatch, {"rate": 0.0}, "rate must be a positive number"), (tm.Minibatch, {"rate": float("inf")}, "rate"),
    (tm.Minibatch, {"rate": float("nan")}, "rate"), (tm.Minibatch, {"batch": True}, "batch"), (tm.LBFGS, {"tolerance": -1.0}, "tolerance"),
])
def test_settings_that_cannot_be_are_refused(kind, settings, says):
    with pytest.raises(RangeError, match=says):
        kind(**settings)


def test_every_solver_comes_back_from_what_describes_it():
    for kind in SOLVERS.values():
        for one in (kind(), kind().filled(steps=3)):
            assert as_solver("test", one.described(), list(SOLVERS)) == one
    assert as_solver("test", tm.Adam, ["adam"]) == tm.Adam()


def misfit_of(btf, material, objective):
    training = make_training(btf, torch.arange(len(btf)), 0, True, torch.float64, False)
    return Misfit(Seen(training, material), Unbounded(material.own_specs(), material.maps), objective)


def test_the_display_objective_is_that_of_a_plain_loop(btf):
    double = Btf.from_tensors(plausible_images(LIGHT, VIEW, 4, 5), LIGHT, VIEW)
    material = tm.fit(double, "texture", holdout=0, dtype=torch.float64, measure=False).material
    images = double.images(torch.arange(len(double)), torch.float64).numpy()
    # The level leaves out what is ten times brighter than the usual texel: nothing is here.
    darkest = 0.01 * images.mean()
    above = below = 0.0
    for light, image in zip(LIGHT, images, strict=True):
        value = material.maps["albedo"].detach().numpy() * float(np.float32(light[2]))
        shown = [(np.maximum(one, 0) + darkest) ** (1 / 2.2) for one in (value, image, 0 * image)]
        above, below = above + ((shown[0] - shown[1]) ** 2).sum(), below + ((shown[2] - shown[1]) ** 2).sum()
    assert misfit_of(double, material, "display")() == pytest.approx(above / below, rel=1e-6)


def linear(predicted, target, weight):
    return weight.sqrt() * (predicted - target)


def test_a_residual_of_ones_own_does_what_the_named_one_does(btf):
    named, own = (fitted(btf, "ptm", solver=tm.Adam(steps=30), objective=one) for one in ("linear", linear))
    assert_close(named.material.maps["polynomial"], own.material.maps["polynomial"].detach(), 1e-4)
    assert own.report["options"]["objective"] == f"{__name__}.linear"
    material = fitted(btf, "texture").material
    assert same_bits(*(fitted(btf, material, steps=9, objective=one) for one in ("linear", linear)))


@pytest.mark.parametrize("model", ["ptm", "distribution", "neural"])
def test_what_is_made_small_gets_smaller_than_by_another_objective(btf, model):
    """A residual that sees only red: red is nearer to the images than where all colours count, and others are not."""
    def red(predicted, target, weight):
        return weight.sqrt() * (predicted - target)[:, :1]

    given = {"solver": tm.Minibatch(steps=150)} | (SMALL if model == "distribution" else {"geometry": "flat"})
    given |= {"latent": 2, "hidden": 4} if model == "neural" else {}
    material = fitted(btf, "texture").material if model == "ptm" else model
    given = {"steps": 150} if model == "ptm" else given
    found = fitted(btf, material, objective=red, holdout=0, **given).material
    grey = fitted(btf, material, objective="linear", holdout=0, **given).material
    rows = torch.arange(len(btf))
    errors = [(tm.fitting.predict(one, btf, rows) - btf.images(rows)).square().mean(dim=(0, 2, 3)) for one in (found, grey)]
    assert float(errors[0][0]) < 1.05 * float(errors[1][0])
    if model != "ptm":  # whose start is the answer for every colour
        assert float(errors[0][1:].mean()) > 3 * float(errors[1][1:].mean())


def test_display_makes_dark_texels_truer_than_linear(btf):
    found = {}
    for objective in ("linear", "display"):
        result = tm.fit(btf, "ptm", solver=tm.LBFGS(steps=150), objective=objective, holdout=0, progress=False)
        found[objective] = result.report["train"]
    assert found["display"]["psnr_db"] > found["linear"]["psnr_db"] + 0.02  # measured 0.042
    assert found["linear"]["relative_error"] < found["display"]["relative_error"]


def test_objectives_that_cannot_be_are_refused(btf, tmp_path, registered):
    with pytest.raises(RangeError, match=r"objective must be one of 'linear', 'display', 'a callable.*Did you mean 'linear'"):
        fitted(btf, "ptm", solver="adam", objective="liner")
    with pytest.raises(RangeError, match="objective must be 'linear' by closed_form; it is 'display'. Give solver='adam' or 'minibatch' or 'lbfgs'"):
        fitted(btf, "ptm", objective="display")
    with pytest.raises(RangeError, match=r"by lm; it is .*Give solver='adam'"):
        fitted(btf, "phong_srf", objective=linear)
    with pytest.raises(RangeError, match=r"goes on from the material takes any: fit\(btf, material, objective=...\)"):
        fitted(btf, "pca", objective="display")
    with pytest.raises(RangeError, match="objective must be one of 'root', 'linear', 'display'"):
        fitted(btf, "neural", objective="roots", geometry="flat")
    with pytest.raises(RangeError, match="objective must return a tensor of residuals; it returns float"):
        fitted(btf, "ptm", solver="adam", objective=lambda predicted, target, weight: 1.0)
    with pytest.raises(RangeError, match="objective must have a gradient; what it returns has none"):
        fitted(btf, "ptm", solver="adam", objective=lambda predicted, target, weight: predicted.detach())
    with pytest.raises(RangeError, match="objective must have a name where work is kept"):
        fitted(btf, registered, objective=linear, tile_size=2, work=tmp_path / "work")


class Mixed(Material):
    """Two colours mixed by weights that sum to 1, on a plane that a unit vector and a turn lean: one map of each kind."""

    name = "outside_mixed"

    def own_specs(self):
        return (
            MapSpec("share", "weights", layers=("1", "2"), layer_channels=1, low=0.0, high=1.0, kind="weights"),
            MapSpec("lean", "unit normal", low=-1.0, high=1.0, kind="normal"),
            MapSpec("turn", "cosine and sine", layers=("x", "y"), layer_channels=1, low=-1.0, high=1.0, kind="rotation"),
            MapSpec("colours", "two", layers=("1", "2"), low=0.0, per_texel=False),
            MapSpec("given", "what was measured", layer_channels=1, low=0.0, fixed=True),
        )

    def value(self, light, view):
        lambert = (self.maps["lean"] * light).sum(dim=-3, keepdim=True).clamp(min=0)
        side = (self.maps["turn"] * light[..., :2, :, :]).sum(dim=-3, keepdim=True)
        colour = torch.einsum("khw,kc->chw", self.maps["share"], self.maps["colours"].flatten().reshape(2, 3))
        return (colour * lambert + 0.1 * (1 + side)) * self.maps["given"]


def test_a_model_from_outside_says_what_its_maps_are_and_they_stay_that(btf):
    size, generator = (4, 5), torch.Generator().manual_seed(2)
    angle = torch.rand(1, *size, generator=generator)
    lean = torch.nn.functional.normalize(torch.randn(3, *size, generator=generator) * 0.2 + torch.tensor([0.0, 0, 1])[:, None, None], dim=0)
    share = torch.rand(1, *size, generator=generator)
    maps = {"share": torch.cat((share, 1 - share)), "lean": lean, "turn": torch.cat((angle.cos(), angle.sin())),
            "colours": torch.rand(6, 1, 1, generator=generator), "given": torch.ones(1, *size)}
    material = Mixed(maps)
    back = Unbounded(material.own_specs(), material.maps).made()
    assert set(back) == set(maps) - {"given"}
    for name, value in back.items():
        assert_close(value, maps[name], 1e-3)
    result = tm.fit(btf, material, steps=60, progress=False)
    found = {name: value.detach() for name, value in result.material.maps.items()}
    assert result.report["train"]["psnr_db"] > tm.evaluate(material, btf, result.split.train).report["psnr_db"] + 3
    assert torch.equal(found["given"], maps["given"]) and all(not torch.equal(found[name], maps[name]) for name in back)
    assert_close(found["share"].sum(dim=0), torch.ones(size), 1e-5)
    for name in ("lean", "turn"):
        assert_close(found[name].norm(dim=0), torch.ones(size), 1e-5)
    with pytest.raises(RangeError, match="share must have weights that sum to 1; 20 of 20"):
        tm.fit(btf, material.with_maps(share=torch.full((2, *size), 0.9)))


def test_a_kind_that_is_none_is_refused():
    with pytest.raises(RangeError, match="kind must be one of 'value', 'normal', 'rotation', 'weights'; it is 'normals'"):
        MapSpec("lean", "unit normal", kind="normals")
    with pytest.raises(RangeError, match="a solver of outside_ggx must be one of"):
        tm.Recipe(Ggx, fit=lambda training: None, solvers=("magic",))


def test_every_model_has_an_objective_and_closed_forms_the_linear_one():
    assert {name: recipe.objective for name, recipe in RECIPES.items() if recipe.objective != "linear"} == {
        "distribution": "display", "microfacet": "display", "neural": "root",
    }
