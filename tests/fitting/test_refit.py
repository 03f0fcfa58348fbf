"""Refit: kept maps have the same bits, the others follow the images, and nothing gets worse."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch
from tests.fitting.reference_scene import relief_scene
from tests.models.distributions import ALL_PARTS, distribution
from tests.models.examples import make
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, RangeError, ShapeError
from torchmat.fitting.evaluate import predict
from torchmat.fitting.descending import Descending
from torchmat.fitting.from_material import kept_names
from torchmat.fitting.refit import refit
from torchmat.fitting.training import make_training
from torchmat.models.edit import replace_map

RINGS = ((0, 1), (30, 3), (60, 5))
LIGHT, VIEW = all_pairs(hemisphere(RINGS), hemisphere(RINGS))


@pytest.fixture(scope="module")
def btf():
    """9 lights x 9 views of 6 x 6 texels, by NumPy."""
    return Btf.from_tensors(plausible_images(LIGHT, VIEW, 6, 6).astype(np.float32), LIGHT, VIEW)


@pytest.fixture(scope="module")
def fitted(btf):
    options = {"lobes": 1, "fresnel": False, "rotation": False, "effort": 0.05, "specular_size": 8}
    return tm.fit(btf, "distribution", geometry="flat", measure=False, **options).material


def begun(btf, material, keep=()):
    """Return a descent from a material at its start."""
    training = make_training(btf, torch.arange(len(btf)), 0, material.tiles, material.dtype, False)
    with torch.no_grad():
        return Descending(training, material, kept_names(material, keep, relief=False), "display")


@pytest.mark.parametrize("relief", [False, True])
@pytest.mark.parametrize("kept", [(), ("normal",), ("diffuse", "index"), ("rotation", "fresnel", "specular")])
def test_the_parameters_stand_for_the_maps(btf, kept, relief):
    material = distribution(6, 6, 3, ALL_PARTS, relief=relief)
    run = begun(btf, material, kept)
    assert not {*kept, "tilt", "height"} & set(run.unknowns.names)
    back = run.made()
    for name, value in material.maps.items():
        if name in (*kept, "tilt", "height"):
            assert torch.equal(back.maps[name], value), name
        else:
            # logarithms, logits and angles in float32, and slopes that a steep normal makes long
            assert_close(back.maps[name], value.detach(), 2e-4 if name == "fresnel" else 2e-5)


def test_a_start_at_the_end_of_a_range_is_moved_off_it(btf):
    material = distribution(6, 6, 2, ("specular_mask", "fresnel"))
    zero, corner = torch.zeros(1, 6, 6), torch.stack((torch.ones(6, 6), torch.zeros(6, 6)))
    material = material.with_maps(
        diffuse=torch.zeros(3, 6, 6), specular=torch.zeros(6, 6, 6), specular_mask=zero, fresnel=zero, index=corner
    )
    run = begun(btf, material)
    assert all(bool(torch.isfinite(value).all()) for value in run.unknowns.parameters)
    for name, value in run.made().maps.items():
        assert float((value - material.maps[name]).detach().abs().max()) < 2e-4, name


def test_what_is_predicted_at_the_start_is_what_the_material_shades(btf):
    material = distribution(6, 6, 2, ALL_PARTS, mask_channels=3, fresnel_exponent=1.0)
    run, rows = begun(btf, material), torch.arange(len(btf))
    with torch.no_grad():
        found = run.seen.predicted(run.unknowns.maps(), rows)
    assert_close(found, predict(material, btf, rows), 1e-4)


def test_ambient_light_counts_whether_kept_or_not(btf):
    material = distribution(6, 6, 1, ("specular_mask",), relief=True)
    dark = material.with_maps(ambient=torch.zeros(3, 6, 6))
    rows = torch.arange(9)
    with torch.no_grad():
        kept, free, none = (
            run.seen.predicted(run.unknowns.maps(), rows)
            for run in (begun(btf, material, ["ambient"]), begun(btf, material), begun(btf, dark, ["ambient"]))
        )
    assert_close(kept, free)
    assert_close(kept - none, material.maps["ambient"].detach().expand(9, -1, -1, -1), 1e-5)


def test_a_moved_height_moves_the_normals(btf):
    material = distribution(6, 6, 1, ("normal", "specular_mask"), relief=True)
    run = begun(btf, material, ["normal"])
    with torch.no_grad():
        run.move_height()
        height = run.material.maps["height"]
        expected = material.with_maps(height=height).surface().maps["normal"]
    assert not torch.equal(height, material.maps["height"])
    assert torch.equal(run.seen.material.maps["normal"], expected)


MODELS = [("lambert", {}), ("ptm", {}), ("phong_srf", {}), ("pca", {"components": 3}), ("local_pca", {"clusters": 2, "components": 2}),
          ("sphere_images", {}), ("shading_map", {}), ("neural", {"latent": 2, "hidden": 4, "effort": 0.005})]


@pytest.mark.parametrize(("model", "options"), MODELS, ids=[model for model, _ in MODELS])
def test_every_model_is_repaired_where_a_map_was_spoilt(btf, model, options):
    material = tm.fit(btf, model, measure=False, progress=False, **options).material
    fixed = {"pca": ["directions"], "local_pca": ["cluster", "directions"]}.get(model, [])
    name = {"lambert": "albedo", "sphere_images": "tint", "shading_map": "slices", "neural": "latent"}.get(
        model, next(spec.name for spec in material.specs() if spec.name not in fixed and not spec.constant)
    )
    name = "residual" if model == "phong_srf" else name
    spoilt = material.with_maps(**{name: 0.5 * material.maps[name].detach()})
    found = refit(btf, spoilt, steps=60)
    assert type(found.material) is type(material) and found.report["improved"] and found.report["kept"] == fixed
    assert found.report["held_out_after"]["psnr_db"] > found.report["held_out_before"]["psnr_db"] + 0.5
    assert all(torch.equal(found.material.maps[name], spoilt.maps[name]) for name in fixed)


@pytest.mark.parametrize(("model", "options"), [
    ("ptm", {"space": "linear"}), ("distribution", {"lobes": 1, "effort": 0.04, "specular_size": 8, "fresnel": False, "rotation": False}),
])
def test_a_wrong_height_moves_to_where_the_images_want_it(model, options):
    scene = relief_scene()
    btf, truth = scene.btf(), torch.as_tensor(scene.true_height, dtype=torch.float32)
    material = tm.fit(btf, model, geometry=scene.true_height, measure=False, progress=False, **options).material
    wrong = material.with_maps(height=0.9 * truth)
    found, kept = (refit(btf, wrong, keep, steps=50) for keep in ([], ["height"]))
    assert torch.equal(kept.material.maps["height"], wrong.maps["height"])
    # Measured after 200 steps: 2.4 dB and 3.2 dB, and a height 5 % and 57 % nearer to the truth.
    assert found.report["held_out_after"]["psnr_db"] > kept.report["held_out_after"]["psnr_db"] + 1
    gaps = [(one.maps["height"].detach() - truth) for one in (found.material, wrong)]
    off = [float((gap - gap.mean()).square().mean().sqrt()) for gap in gaps]
    assert off[0] < (0.7 if model == "distribution" else 1.0) * off[1]


@pytest.mark.parametrize("solver", ["adam", tm.LBFGS(steps=12), tm.Minibatch(steps=30, rate=0.1, batch=20)])
def test_other_solvers_refit_too_and_the_report_says_which(btf, fitted, solver):
    spoilt = fitted.with_maps(diffuse=0.4 * fitted.maps["diffuse"].detach())
    found = refit(btf, spoilt, ["specular"], solver=solver, effort=0.1)
    assert found.report["improved"]
    said = {"adam": {"name": "adam", "steps": 50, "rate": 0.03}}.get(solver) if isinstance(solver, str) else solver.described()
    assert json.loads(json.dumps(found.report["options"])) == {"solver": said, "objective": "display"}


KEPT = [("diffuse",), ("normal", "specular_mask"), ("specular",), ("diffuse", "normal", "specular")]


@pytest.mark.parametrize("keep", KEPT)
def test_kept_maps_have_the_same_bits_and_the_others_repair_the_damage(btf, fitted, keep):
    spoilt = fitted.with_maps(**{
        name: 0.4 * fitted.maps[name] for name in ("diffuse", "specular_mask") if name not in keep
    })
    found = refit(btf, spoilt, keep, effort=0.06)
    for name in keep:
        assert torch.equal(found.material.maps[name], spoilt.maps[name])
    changed = [name for name in spoilt.maps if name not in keep]
    assert all(not torch.equal(found.material.maps[name], spoilt.maps[name]) for name in changed)
    before, after = found.report["held_out_before"], found.report["held_out_after"]
    assert found.report["improved"] and found.report["kept"] == [name for name in spoilt.maps if name in keep]
    if "diffuse" not in keep:
        assert after["psnr_db"] > before["psnr_db"] + 6
    assert found.report["train_after"]["psnr_db"] > found.report["train_before"]["psnr_db"]
    assert found.report["seconds"] > 0


def test_a_painted_map_stays_and_the_rest_follows(btf, fitted):
    painted = replace_map(fitted, "diffuse", torch.tensor([0.3, 0.3, 0.3])[:, None, None])
    found = refit(btf, painted, ["diffuse"], effort=0.06)
    assert torch.equal(found.material.maps["diffuse"], painted.maps["diffuse"])
    assert found.report["held_out_after"]["mse"] < found.report["held_out_before"]["mse"]


def test_the_truth_is_not_left(btf):
    """Images of the material itself: there is nothing to gain, so the same maps come back."""
    material = distribution(6, 6, 1, ("specular_mask",))
    with torch.no_grad():
        light, view = (torch.from_numpy(rows).float()[:, :, None, None] for rows in (LIGHT, VIEW))
        own = Btf.from_tensors(material.shade(light, view), LIGHT, VIEW)
    found = refit(own, material, ["specular"], effort=0.01)
    assert not found.report["improved"]
    assert found.report["held_out_after"] == found.report["held_out_before"]
    assert all(torch.equal(found.material.maps[name], material.maps[name]) for name in material.maps)


@pytest.mark.parametrize("keep", [("height",), ("height", "normal"), ("diffuse",)])
def test_on_a_relief(btf, keep):
    material = distribution(6, 6, 1, ("normal", "specular_mask"), relief=True)
    found = refit(btf, material, keep, effort=0.02)
    for name in keep:
        assert torch.equal(found.material.maps[name], material.maps[name])
    assert found.report["improved"] and found.material.has_relief
    assert torch.equal(found.material.maps["height"], material.maps["height"]) == ("height" in keep)
    assert found.report["held_out_after"]["psnr_db"] > found.report["held_out_before"]["psnr_db"]


def test_the_same_seed_gives_the_same_bits(btf, fitted):
    one, other = (refit(btf, fitted, ["normal"], effort=0.01).material for _ in range(2))
    assert all(torch.equal(one.maps[name], other.maps[name]) for name in one.maps)


def test_double_precision_one_texel_and_nothing_held_out():
    images = plausible_images(LIGHT, VIEW, 1, 1)
    data = Btf.from_tensors(images, LIGHT, VIEW)
    found = refit(data, distribution(1, 1, 2, ALL_PARTS, dtype=torch.float64), ["rotation"], effort=0.02, holdout=0)
    assert found.material.dtype == torch.float64
    assert found.report["held_out_before"] is None and found.report["held_out_after"] is None
    assert found.report["kept"] == ["rotation", "tilt"]


def test_wrong_inputs_are_refused(btf, fitted):
    with pytest.raises(RangeError, match="solver must be one of 'adam', 'minibatch', 'lbfgs'; it is 'closed_form'"):
        refit(btf, make("ptm", {}, 6, 6), solver="closed_form")
    with pytest.raises(RangeError, match="steps must be given once; the solver has 5 and steps is 7"):
        refit(btf, fitted, solver=tm.Adam(steps=5), steps=7)
    with pytest.raises(RangeError, match="objective must be one of 'linear', 'display'"):
        refit(btf, fitted, objective="displya")
    with pytest.raises(RangeError, match="Did you mean 'diffuse'"):
        refit(btf, fitted, ["difuse"])
    with pytest.raises(RangeError, match=r"keep must be a list of names; it is 'diffuse'"):
        refit(btf, fitted, "diffuse")
    with pytest.raises(RangeError, match="leave a map to fit"):
        refit(btf, fitted, list(fitted.maps))
    with pytest.raises(RangeError, match="effort must be positive"):
        refit(btf, fitted, effort=math.nan)
    with pytest.raises(ShapeError, match="be 6 x 6 as the images; it is 4 x 5"):
        refit(btf, distribution(4, 5))
    two = distribution(6, 6, 2)
    two = two.with_maps(index=torch.ones(2, 6, 6))
    with pytest.raises(RangeError, match="weights that sum to 1; 36 of 36"):
        refit(btf, two)
    assert refit(btf, two, ["index"], effort=0.002).material.options["lobes"] == 2
