"""Standard errors of maps: the normal equations to the digit, coverage over thousands of repetitions, and what is not known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.models.examples import EXAMPLE_OPTIONS, directions, make, per_image
from tests.reference import materials as oracle
from tests.reference.bases import half_light, polynomial
from tests.reference.colour import decode
from tests.support import assert_close, hemisphere

import torchmat as tm
from torchmat.errors import RangeError, ShapeError
from torchmat.fitting.certainty.information import _capped
from torchmat.fitting.certainty.jacobian import derivative, jacobian_of
from torchmat.fitting.certainty.observed import observe
from torchmat.fitting.recipe import recipe_of
from torchmat.fitting.shared import Shared
from torchmat.fitting.training import make_training
from torchmat.models import MATERIALS, Microfacet

SIDE, NOISE = 64, 0.004
LIGHT = hemisphere(((0, 1), (25, 5), (45, 9), (60, 11)))
ALONG = np.tile((0.0, 0.0, 1.0), (len(LIGHT), 1))
VIEW = np.roll(hemisphere(((5, 3), (30, 8), (50, 15))), 7, axis=0)
RNG = np.random.default_rng(5)


def repeated(name, maps, options, view=ALONG, noise=NOISE, codes=False, light=LIGHT):
    """Return 4,096 texels of one truth, seen with noise of their own: as many repetitions of an experiment."""
    one = {key: np.asarray(value, dtype=float).reshape((-1,) if key == "lobe" else (-1, 1, 1)) for key, value in maps.items()}
    exact = np.stack([
        oracle.shade(name, one, options, l[:, None, None], v[:, None, None], 1, 1) for l, v in zip(light, view, strict=True)
    ])
    shape = (len(light), 3, SIDE, SIDE)
    if codes:  # noise of the codes, as the space of the fit has it
        exact = np.vectorize(oracle_code)(exact)
    seen = exact + noise * np.random.default_rng(1).standard_normal(shape)
    if codes:
        seen = np.where(seen <= 0.04045, seen / 12.92, ((np.maximum(seen, 0) + 0.055) / 1.055) ** 2.4)
    return tm.Btf.from_tensors(seen.astype(np.float32), light.astype(np.float32), view.astype(np.float32))


def oracle_code(value):
    """Return the code of one linear value: the inverse of the oracle's own curve, by bisection."""
    low, high = 0.0, 2.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if decode(middle) < value else (low, middle)
    return low


def assert_covered(truth, material, found):
    """Assert that intervals of 68 and 95 % hold the truth in 68 and 95 % of the texels, of every channel."""
    for level in (0.68, 0.95):
        half = found.interval(level)
        assert set(half) == set(truth)
        for name, width in half.items():
            off = material.maps[name].detach().double() - torch.as_tensor(np.asarray(truth[name]), dtype=torch.float64).reshape(-1, 1, 1)
            share = (off.abs() <= width.double()).double().mean(dim=(1, 2))
            assert float((share - level).abs().max()) < 0.03, f"{name} at {level}: {share.tolist()}"


COEFFICIENTS = np.concatenate((RNG.uniform(-0.05, 0.05, (5, 3)), np.full((1, 3), 0.5))).reshape(-1)


@pytest.mark.parametrize("space", ["linear", "srgb"])
def test_intervals_of_a_ptm_hold_the_truth_as_often_as_they_say(space):
    btf = repeated("ptm", {"polynomial": COEFFICIENTS}, {"space": space}, codes=space == "srgb")
    result = tm.fit(btf, "ptm", space=space, holdout=0, measure="none", tiles=False)
    found = tm.uncertainty(result.material, btf)
    assert found.space == space and found.sigma == pytest.approx((NOISE,) * 3, rel=0.01)
    assert float(found.freedom.min()) == float(found.freedom.max()) == len(LIGHT) - 6
    assert_covered({"polynomial": COEFFICIENTS}, result.material, found)


def test_intervals_of_harmonics_hold_the_truth():
    maps = {"harmonic": np.concatenate((np.full(3, 1.5), RNG.uniform(-0.1, 0.1, 24)))}
    btf = repeated("hsh", maps, {"terms": 9, "space": "linear"})
    result = tm.fit(btf, "hsh", space="linear", holdout=0, measure="none", tiles=False)
    assert_covered(maps, result.material, tm.uncertainty(result.material, btf))


def test_intervals_of_a_normal_that_is_found_from_luminance_hold_the_truth():
    maps = {"albedo": (0.7, 0.4, 0.2), "normal": np.array((0.1, -0.05, 1.0)) / np.linalg.norm((0.1, -0.05, 1.0))}
    btf = repeated("lambert", maps, {"normals": "map"})
    result = tm.fit(btf, "lambert", holdout=0, measure="none", tiles=False)
    assert_covered(maps, result.material, tm.uncertainty(result.material, btf))


def test_intervals_of_a_residual_over_a_known_lobe_hold_the_truth():
    lobe = (0.3, 0.25, 0.2, 0.2, 0.2, 0.2, np.log(12.0))
    residual = np.concatenate((RNG.uniform(-0.03, 0.03, (6, 3)), np.full((1, 3), 0.2))).reshape(-1)
    light, view = np.concatenate((LIGHT, LIGHT)), np.concatenate((VIEW, np.roll(VIEW, 9, axis=0)))
    btf = repeated("phong_srf", {"lobe": lobe, "residual": residual}, {"residual": "half_light", "base": "phong"}, view, light=light)
    training = replace(make_training(btf, torch.arange(len(btf)), 0, False, torch.float32, False), shared=Shared({"lobe": torch.tensor(lobe).double()}))
    # The ridge, which holds back what hardly counts, would be a bias beside so little noise.
    material = recipe_of("phong_srf").run(training, residual="half_light", ridge=0.0).material
    found = tm.uncertainty(material, btf)
    assert_covered({"residual": residual}, material, found)
    design = np.stack([half_light(l, v) for l, v in zip(light, view, strict=True)])
    exact = np.sqrt(np.linalg.inv(design.T @ design).diagonal()) * NOISE
    usual = found.error["residual"].double().square().mean(dim=(1, 2)).sqrt()
    assert_close(usual, torch.from_numpy(exact)[:, None].expand(-1, 3).flatten(), 0.02)


def test_intervals_of_what_is_found_by_steps_hold_the_truth():
    maps = {"diffuse": (0.4, 0.3, 0.2), "specular_f0": (0.08, 0.07, 0.05), "roughness": (0.5,)}
    btf = repeated("microfacet", maps, {"parts": []}, VIEW)
    start = Microfacet({name: torch.tensor(value)[:, None, None].expand(-1, SIDE, SIDE).clone() for name, value in maps.items()}, tiles=False)
    result = tm.fit(btf, start, solver=tm.LBFGS(steps=40), objective="linear", holdout=0, measure="none")
    found = tm.uncertainty(result.material, btf, objective="linear")
    assert_covered(maps, result.material, found)
    # The normal equations of the block, one texel by differences of the oracle.
    def shaded(numbers):
        one = {"diffuse": numbers[:3], "specular_f0": numbers[3:6], "roughness": numbers[6:]}
        one = {name: value.reshape(-1, 1, 1) for name, value in one.items()}
        return np.stack([oracle.shade("microfacet", one, {"parts": []}, l[:, None, None], v[:, None, None], 1, 1).reshape(3) for l, v in zip(LIGHT, VIEW, strict=True)])
    numbers = np.concatenate([np.asarray(maps[name], dtype=float) for name in maps])
    step = 1e-6 * np.eye(7)
    slope = np.stack([(shaded(numbers + one) - shaded(numbers - one)) / 2e-6 for one in step], axis=-1).reshape(-1, 7)
    exact = NOISE * np.sqrt(np.linalg.inv(slope.T @ slope).diagonal())
    means = torch.cat([found.error[name].double().square().mean(dim=(1, 2)).sqrt() for name in maps])
    assert_close(means, torch.from_numpy(exact), 0.03)


def test_errors_of_a_linear_model_are_those_of_its_normal_equations():
    images = RNG.uniform(0.2, 0.8, (len(LIGHT), 3, 4, 5))
    weight = RNG.uniform(0, 1, (len(LIGHT), 1, 4, 5)) > 0.2
    btf = tm.Btf.from_tensors(images, LIGHT, ALONG, weight)
    result = tm.fit(btf, "ptm", space="linear", holdout=0, measure="none", tiles=False, dtype=torch.float64)
    found = tm.uncertainty(result.material, btf)
    design = np.stack([polynomial(light, light) for light in LIGHT])
    for row in range(4):
        for column in range(5):
            kept = weight[:, 0, row, column]
            some, inverse = design[kept], np.linalg.inv(design[kept].T @ design[kept])
            for colour in range(3):
                target = images[kept, colour, row, column]
                gap = target - some @ (inverse @ some.T @ target)
                exact = np.sqrt(gap @ gap / (kept.sum() - 6) * inverse.diagonal())
                assert_close(found.error["polynomial"][colour::3, row, column], torch.from_numpy(exact), 1e-9)


def test_near_lights_are_those_of_each_texel():
    images = RNG.uniform(0.2, 0.8, (len(LIGHT), 3, 4, 5))
    btf = tm.Btf.from_tensors(images, None, ALONG, light_position=torch.from_numpy(1.5 * LIGHT), falloff=False)
    result = tm.fit(btf, "ptm", space="linear", holdout=0, measure="none", tiles=False, dtype=torch.float64)
    found, light = tm.uncertainty(result.material, btf), btf.directions(range(len(btf)))[0].numpy()
    design = np.stack([polynomial(one, one) for one in light[:, :, 3, 0]])
    inverse = np.linalg.inv(design.T @ design)
    target = images[:, 1, 3, 0]
    gap = target - design @ (inverse @ design.T @ target)
    exact = np.sqrt(gap @ gap / (len(LIGHT) - 6) * inverse.diagonal())
    assert_close(found.error["polynomial"][1::3, 3, 0], torch.from_numpy(exact), 1e-9)


@pytest.mark.parametrize("name", [name for name in MATERIALS if MATERIALS[name].unsure is None])
def test_derivatives_are_those_of_differences(name):
    options = EXAMPLE_OPTIONS[name][-1]
    material = make(name, options)
    light, view = directions(6, lowest=0.5), directions(6, seed=4, lowest=0.5)
    with torch.no_grad():
        images = material.shade(per_image(light), per_image(view)) + 0.01
    btf = tm.Btf.from_tensors(images, light, view)
    observed = observe(material, make_training(btf, torch.arange(6), 0, True, torch.float64, False), "linear")
    jacobian, some = jacobian_of(observed), observed.some(torch.arange(6))
    found, maps = jacobian.of(observed, some), dict(observed.flat.maps.items())
    for number, way in enumerate(jacobian.ways):
        step = 1e-6 * way.tangent
        with torch.no_grad():
            ahead, behind = (observed.residual({**maps, way.name: maps[way.name] + one}, some) for one in (step, -step))
        # Tilts move the half vector over the texels of a specular map: kinks, which differences of another step see elsewhere.
        assert_close(found[:, :, number], (ahead - behind) / 2e-6, 2e-2 if name == "distribution" else 1e-5)
        assert_close(derivative(observed, some, way), found[:, :, number], 1e-12)


def test_what_samples_leave_open_has_its_natural_range_for_an_error():
    one = np.repeat(LIGHT[:1], 8, axis=0)
    btf = tm.Btf.from_tensors(RNG.uniform(0.3, 0.5, (8, 3, 2, 2)), one, np.tile((0.0, 0.0, 1.0), (8, 1)))
    maps = {"albedo": torch.full((3, 2, 2), 0.5), "normal": torch.tensor((0.0, 0.0, 1.0))[:, None, None].expand(-1, 2, 2).contiguous()}
    material = MATERIALS["lambert"]({name: value.double() for name, value in maps.items()})
    found = tm.uncertainty(material, btf, objective="linear")
    assert_close(found.error["normal"][:2], torch.ones(2, 2, 2, dtype=torch.float64), 1e-6)
    assert float(found.error["albedo"].max()) < 0.2


def test_open_directions_are_capped_and_others_stay():
    plain = torch.tensor([[[4.0, 0.0], [0.0, 1e-6]]], dtype=torch.float64)
    assert_close(_capped(plain, plain), torch.tensor([[[0.25, 0.0], [0.0, 1.0]]], dtype=torch.float64), 1e-12)
    turn = torch.tensor([[0.8, -0.6], [0.6, 0.8]], dtype=torch.float64)
    assert_close(_capped(turn @ plain @ turn.T, turn @ plain @ turn.T), turn @ torch.diag(torch.tensor((0.25, 1.0)).double()) @ turn.T[None], 1e-9)


def test_a_strip_at_a_time_is_the_same_and_so_is_an_even_part_of_the_samples(monkeypatch):
    btf = tm.load_btf(tm.sample_path(), cache=False, crop=(0, 0, 6, 5), progress=False)
    result = tm.fit(btf, "ptm", measure="none")
    whole = tm.uncertainty(result.material, btf, result.split.train)
    monkeypatch.setattr("torchmat.fitting.certainty.estimate._STRIP", 1)
    strips = tm.uncertainty(result.material, btf, result.split.train)
    assert_close(strips.error["polynomial"], whole.error["polynomial"])
    monkeypatch.setattr("torchmat.fitting.certainty.estimate._WORK", 1)
    part = tm.uncertainty(result.material, btf, result.split.train)
    assert part.samples[0] < part.samples[1] == whole.samples[0]
    assert float((part.error["polynomial"] / whole.error["polynomial"]).log().abs().median()) < 0.3


def test_on_a_relief_the_errors_are_those_of_the_samples_on_it():
    btf = tm.load_btf(tm.sample_path(), cache=False, crop=(0, 0, 12, 12), progress=False)
    slope = torch.linspace(-0.02, 0.02, 12)[None, None, :].expand(1, 12, 12).contiguous()
    result = tm.fit(btf, "lambert", geometry=slope, measure="none", tiles=False)
    found = tm.uncertainty(result.material, btf, result.split.train)
    assert set(found.error) == {"albedo", "ambient"}
    usual = found.error["albedo"].median() / result.material.maps["albedo"].detach().median()
    assert 0 < float(usual) < 0.5


def test_what_has_no_errors_is_refused_by_name():
    btf = tm.load_btf(tm.sample_path(), cache=False, crop=(0, 0, 4, 4), progress=False)
    with pytest.raises(RangeError, match="uncertainty of lptm must be asked of maps that have one; its luminance"):
        tm.uncertainty(make("lptm", {}, 4, 4), btf)
    with pytest.raises(ShapeError, match="have the size of the images; it is 2 x 3"):
        tm.uncertainty(make("ptm", {}), btf)
    found = tm.uncertainty(make("ptm", {}, 4, 4, torch.float32), btf)
    with pytest.raises(RangeError, match="level must lie in"):
        found.interval(1.0)


def test_texels_off_the_object_have_no_error():
    btf = tm.load_btf(tm.sample_path(), cache=False, crop=(0, 0, 4, 4), progress=False)
    mask = torch.ones(4, 4, dtype=torch.bool)
    mask[0, 0] = False
    masked = btf.masked(mask)
    result = tm.fit(masked, "ptm", measure="none", tiles=False)
    found = tm.uncertainty(result.material, masked)
    assert float(found.error["polynomial"][:, 0, 0].abs().max()) == 0
    assert float(found.error["polynomial"][:, 1:, 1:].min()) > 0
