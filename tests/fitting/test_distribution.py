"""The fit of the distribution material, on data that the oracle made and on data that leaves nothing to fit."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
import torch
from tests.reference import materials as oracle
from tests.support import all_pairs, assert_close, hemisphere

import torchmat as tm
from torchmat import Btf, FitResult, RangeError
from torchmat.fitting import predict
from torchmat.fitting.models.distribution import choose
from torchmat.fitting.models.distribution import fit as fitting

LIGHT, VIEW = all_pairs(hemisphere(((20, 1), (40, 4), (65, 4))), hemisphere(((0, 1), (30, 4), (60, 4))))
SIZE, TABLE = 6, 16
# The oracle's images are made by the formula as printed.
ONE_LOBE = {"lobes": 1, "fresnel": False, "rotation": False, "specular_size": TABLE, "storage": "float", "denominator": "ashikhmin", "specular_spacing": "even"}
TURNED = {**ONE_LOBE, "rotation": True}
QUICK = {**ONE_LOBE, "effort": 0.02}


def lobe(wide: float, high: float, size: int = TABLE) -> np.ndarray:
    """Return a specular map [3, S, S]: a bell of those widths on the parabolic map, tinted."""
    axis = (np.arange(size) + 0.5) / size * 2 - 1
    bell = np.exp(-((axis[None] / wide) ** 2) - (axis[:, None] / high) ** 2)
    return np.array([0.5, 0.4, 0.3])[:, None, None] * bell


@functools.lru_cache(maxsize=None)
def scene(kind: str) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the maps of a small flat material, "isotropic" or "anisotropic", and its images [81, 3, 6, 6]."""
    random = np.random.default_rng(3)
    maps = {
        "diffuse": random.uniform(0.05, 0.5, (3, SIZE, SIZE)), "specular_mask": random.uniform(0.4, 1, (1, SIZE, SIZE)),
        "specular": lobe(0.3, 0.3) if kind == "isotropic" else lobe(0.5, 0.15),
    }
    if kind == "anisotropic":
        angle = random.uniform(0, np.pi, (1, SIZE, SIZE))
        maps["rotation"] = np.concatenate((np.cos(angle), np.sin(angle)))
    planes = [rows[:, :, None, None] for rows in (LIGHT, VIEW)]
    images = [oracle.shade("distribution", maps, {"lobes": 1}, *pair, SIZE, SIZE) for pair in zip(*planes, strict=True)]
    return maps, np.stack(images)


def btf_of(images: np.ndarray, kind: type = np.float32, light=LIGHT, view=VIEW, weight=None) -> Btf:
    return Btf.from_tensors(images.astype(kind), light, view, weight)


def noisy(kind: str, share: float = 0.02) -> np.ndarray:
    images = scene(kind)[1]
    return np.maximum(0, images * (1 + share * np.random.default_rng(7).normal(size=images.shape)))


@functools.lru_cache(maxsize=None)
def recovered(kind: str) -> FitResult:
    options = ONE_LOBE if kind == "isotropic" else TURNED
    return tm.fit(btf_of(scene(kind)[1]), "distribution", geometry="flat", effort=0.3, **options)


def maps_of(result: FitResult) -> dict[str, torch.Tensor]:
    return {name: value.detach() for name, value in result.material.maps.items()}


def same_bits(first: FitResult, second: FitResult) -> bool:
    one, other = maps_of(first), maps_of(second)
    return set(one) == set(other) and all(torch.equal(one[name], other[name]) for name in one)


def checked(result: FitResult) -> FitResult:
    """Assert that maps and pictures, also after export, are finite; return the result."""
    assert all(bool(torch.isfinite(value).all()) for value in maps_of(result).values())
    light, view = (torch.from_numpy(rows[:5, :, None, None]).to(result.material.dtype) for rows in (LIGHT, VIEW))
    assert bool(torch.isfinite(result.material.shade(light, view)).all())
    exported = result.material.as_exported()
    assert bool(torch.isfinite(exported.shade(light.float(), view.float())).all())
    return result


def error_of(result: FitResult) -> float:
    return result.report["held_out"]["relative_error"]


def test_an_isotropic_material_is_recovered():
    result = recovered("isotropic")
    truth = scene("isotropic")[0]
    assert result.stop_reason == "step limit"
    assert error_of(result) < 1e-3
    found = maps_of(result)
    # A lobe as wide as the map and the diffuse colour explain much the same: measured 0.18, after 1200 steps 0.08.
    assert_close(found["diffuse"], torch.from_numpy(truth["diffuse"]).float(), 0.25)
    assert_close(found["normal"], torch.tensor([0.0, 0, 1])[:, None, None].expand(3, SIZE, SIZE), 0.02)  # 0.007
    # Mask and specular map share a factor: the largest mask is 1.
    assert float(found["specular_mask"].max()) == 1
    mask = truth["specular_mask"] / truth["specular_mask"].max()
    assert_close(found["specular_mask"], torch.from_numpy(mask).float(), 0.01)  # measured 2e-4


def test_a_noisy_one_is_recovered_to_below_its_noise():
    result = tm.fit(btf_of(noisy("isotropic", 0.05)), "distribution", geometry="flat", effort=0.12, **ONE_LOBE)
    predicted = predict(result.material, btf_of(scene("isotropic")[1]), result.split.held_out)
    truth = torch.from_numpy(scene("isotropic")[1])[result.split.held_out]
    assert float((predicted - truth).square().sum() / truth.square().sum()) < 0.05**2


def test_the_rotation_of_each_texel_is_recovered():
    result = recovered("anisotropic")
    assert error_of(result) < 4e-3
    truth, found = scene("anisotropic")[0]["rotation"], maps_of(result)["rotation"].double().numpy()
    # Up to half turns, and one common angle by which the specular map may be turned: doubled angles, as complex numbers.
    doubled = ((found[0] + 1j * found[1]) / (truth[0] + 1j * truth[1])) ** 2
    off = np.degrees(np.angle(doubled / doubled.mean())) / 2
    assert np.abs(off).max() < 5
    assert len(np.unique(np.degrees(np.arctan2(truth[1], truth[0])).round())) > 25


def test_without_rotation_the_anisotropic_one_is_not_explained():
    assert error_of(soon("anisotropic", rotation=True)) < 0.5 * error_of(soon("anisotropic"))


# After three tenths of the steps 27 dB and -4 dB were measured; what pays shows sooner.
@pytest.mark.parametrize(("kind", "kept", "effort"), [("anisotropic", True, 0.12), ("isotropic", False, 0.3)])
def test_rotation_is_kept_where_it_pays(kind, kept, effort):
    options = {**ONE_LOBE, "rotation": "auto", "effort": effort}
    result = tm.fit(btf_of(noisy(kind)), "distribution", geometry="flat", measure=False, **options)
    assert ("rotation" in result.material.maps) is kept
    (trial,) = result.report["figures"]["trials"]
    assert trial["part"] == "rotation" and trial["kept"] is kept
    gains = [trial[one] - trial[other] for one, other in (("psnr_db", "without"), ("relative_db", "relative_without"))]
    assert (sum(gains) / 2 > 0.08) is kept
    assert set(result.report["figures"]["parts"]) == set(result.material.options["parts"])


@pytest.mark.parametrize(("gain", "kept"), [(-1.0, False), (0.07, False), (0.09, True), (0.5, True)])
def test_a_part_is_kept_from_0_08_db_on(gain, kept, monkeypatch):
    monkeypatch.setattr(choose.Choice, "_agreement", lambda self, raw, parts: (20 + 2 * gain * ("fresnel" in parts.names), 20.0))
    options = {**ONE_LOBE, "fresnel": "auto", "effort": 0.01}
    result = tm.fit(btf_of(scene("isotropic")[1]), "distribution", measure=False, **options)
    assert ("fresnel" in result.material.options["parts"]) is kept


@pytest.mark.parametrize(("wide", "spacing"), [(0.035, "dense"), (0.5, "even")])
def test_specular_maps_are_dense_where_highlights_are_sharp(wide, spacing):
    light, view = all_pairs(hemisphere(((5, 4), (20, 8), (40, 8))), hemisphere(((3, 4), (20, 8), (40, 8))))
    maps = {"diffuse": np.full((3, 4, 4), 0.1), "specular": 20 * lobe(wide, wide, 201)}
    planes = [rows[:, :, None, None] for rows in (light, view)]
    images = np.stack([oracle.shade("distribution", maps, {"lobes": 1}, *pair, 4, 4) for pair in zip(*planes, strict=True)])
    options = {**ONE_LOBE, "specular_mask": False, "normal": False, "effort": 0.15, "geometry": "flat"}
    btf, errors = btf_of(images, light=light, view=view), {}
    for asked in ("auto", "even", "dense"):
        result = tm.fit(btf, "distribution", **{**options, "specular_spacing": asked})
        errors[result.material.specular_spacing], chosen = error_of(result), result.material.specular_spacing
        assert asked in ("auto", chosen)
        if asked == "auto":
            assert chosen == spacing and [trial["part"] for trial in result.report["figures"]["trials"]] == ["spacing"]
    assert min(errors, key=errors.get) == spacing, errors


def test_neighbours_of_a_specular_map_are_alike_where_no_sample_tells():
    table = torch.randn(3, 8, 8, generator=torch.Generator().manual_seed(1))
    smooth = torch.zeros(3, 8, 8) + torch.linspace(0, 1, 8)
    assert float(fitting.roughness_of(torch.zeros(3, 8, 8))) == 0
    # A slope costs as its steps do, but for a tenth that rounds the kink; noise of the same range costs more than all of it.
    steps = 3 * 8 * 7 * (math.hypot(1 / 7, 0.1) - 0.1)
    assert float(fitting.roughness_of(smooth)) == pytest.approx(steps, rel=1e-5)
    assert float(fitting.roughness_of(table)) > 10 * steps


def test_parts_are_decided_by_the_tenth_of_the_samples_that_no_step_before_has_seen(monkeypatch):
    fitted_to, judged_by = [], []
    honest_solve, honest_agreement = fitting.DistributionFit.solve, choose.Choice._agreement

    def solve(self, raw, parts, solver, samples, *rest):
        fitted_to.append(samples)
        return honest_solve(self, raw, parts, solver, samples, *rest)

    def agreement(self, raw, parts):
        judged_by.append((len(fitted_to), self.back))
        return honest_agreement(self, raw, parts)

    monkeypatch.setattr(fitting.DistributionFit, "solve", solve)
    monkeypatch.setattr(choose.Choice, "_agreement", agreement)
    options = {**ONE_LOBE, "fresnel": "auto", "lobes": "auto", "effort": 0.01, "holdout": 0}
    tm.fit(btf_of(scene("isotropic")[1]), "distribution", measure=False, **options)
    for seen, back in judged_by:
        assert torch.equal(torch.cat((fitted_to[seen - 1], back)).sort().values, torch.arange(81)) and len(back) == 8
        assert not any(bool(torch.isin(back, samples).any()) for samples in fitted_to[:seen])
    assert len(fitted_to[-1]) == 81  # the last steps see all


def test_what_a_part_did_is_given_to_those_that_are_left():
    # Fresnel to the mask: the same values on the mean angle; a turned lobe to the even one that all texels show together.
    angle = torch.linspace(-math.pi, math.pi, 64).reshape(1, 8, 8)
    raw = {
        "fresnel": torch.zeros(1, 8, 8), "specular_mask": torch.zeros(1, 8, 8), "rotation": angle,
        "specular": torch.zeros(3, 16, 16), "masking": torch.tensor([0.1, 0.3]).log(),
    }
    raw["specular"][:, :, 10:] = 1.0
    left = choose.without("fresnel", raw, 0.25)
    assert "fresnel" not in left
    assert_close(left["specular_mask"].exp(), torch.full((1, 8, 8), 0.625), 1e-6)
    left = choose.without("rotation", raw, 0.25)
    assert_close(left["masking"].exp(), torch.full((2,), math.sqrt(0.05)), 1e-6)
    turned = left["specular"].exp()
    axis = (torch.arange(16) + 0.5) / 8 - 1
    on_map = (axis[:, None] ** 2 + axis[None] ** 2 < 0.8).float()  # corners are no half vectors
    # Sixteen angles, of which the first and the last are one: measured 0.05.
    assert_close(turned * on_map, torch.rot90(turned, 1, (1, 2)) * on_map, 0.1)
    assert float((raw["specular"].exp() - torch.rot90(raw["specular"].exp(), 1, (1, 2))).abs().max()) > 1


def test_lobes_are_chosen_by_the_data():
    result = tm.fit(btf_of(noisy("isotropic")), "distribution", geometry="flat", measure=False, **{**ONE_LOBE, "lobes": "auto", "effort": 0.1})
    assert 1 <= result.material.options["lobes"] <= 3
    assert result.report["figures"]["lobes"] == result.material.options["lobes"]


def test_too_few_samples_to_choose_by_take_the_plain_material():
    few = btf_of(scene("isotropic")[1][:15], light=LIGHT[:15], view=VIEW[:15])
    options = {"specular_size": 8, "effort": 0.01, "holdout": 0, "measure": False}
    result = tm.fit(few, "distribution", geometry="flat", **options)
    assert result.report["figures"]["trials"] == [] and result.material.options["parts"] == ["normal", "specular_mask", "masking"]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_same_seed_same_bits_with_one_and_two_threads(dtype):
    btf = btf_of(noisy("anisotropic"), np.float32 if dtype == torch.float32 else np.float64)
    options = {**TURNED, "lobes": 2, "fresnel": True, "effort": 0.02, "measure": False, "dtype": dtype}
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 2):
            torch.set_num_threads(threads)
            results.append(tm.fit(btf, "distribution", geometry="flat", seed=5, **options))
    finally:
        torch.set_num_threads(before)
    assert same_bits(results[0], results[1]) and same_bits(results[1], results[2])
    assert not same_bits(results[0], tm.fit(btf, "distribution", geometry="flat", seed=6, **options))


def test_a_large_one_gives_the_same_bits_with_one_and_two_threads():
    # Sums over more than 32768 values are what threads share out.
    light, view = LIGHT[::9], VIEW[::9]
    images = np.random.default_rng(0).uniform(0.1, 0.9, (len(light), 3, 120, 120))
    options = {**TURNED, "lobes": 2, "fresnel": True, "effort": 0.002, "measure": False, "holdout": 0}
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            results.append(tm.fit(btf_of(images, light=light, view=view), "distribution", geometry="flat", **options))
    finally:
        torch.set_num_threads(before)
    assert same_bits(*results)


def test_double_precision_is_kept_and_agrees():
    single = recovered("isotropic")
    double = tm.fit(btf_of(scene("isotropic")[1], np.float64), "distribution", geometry="flat", effort=0.3, dtype=torch.float64, **ONE_LOBE)
    assert {value.dtype for value in maps_of(double).values()} == {torch.float64}
    # 600 steps of Adam end at other places of one flat valley: measured 5.2e-4 and 7.7e-4.
    assert max(error_of(single), error_of(double)) < 1.2e-3
    found = predict(double.material, btf_of(scene("isotropic")[1]), double.split.held_out)
    assert_close(found.float(), predict(single.material, btf_of(scene("isotropic")[1]), single.split.held_out), 0.1)


def test_the_history_is_filled_and_falls():
    history = recovered("isotropic").history
    seconds, errors = zip(*history, strict=True)
    assert len(history) >= 6 and list(seconds) == sorted(seconds) and seconds[0] > 0
    # Errors are running means; what is left of the start fades with 0.98 a step.
    assert errors[-1] < 0.1 * errors[0] and all(math.isfinite(error) for error in errors)


def test_a_short_fit_has_a_history_too():
    result = tm.fit(btf_of(scene("isotropic")[1]), "distribution", geometry="flat", measure=False, **QUICK)
    assert len(result.history) >= 1


@pytest.mark.parametrize("rate", [1e3, 1e6, 1e30])
@pytest.mark.parametrize("steps", [1, 40, 101])
def test_14_a_wild_rate_ends_in_a_named_reason_with_finite_maps(rate, steps):
    result = tm.fit(btf_of(scene("isotropic")[1]), "distribution", geometry="flat", solver=tm.Minibatch(steps, rate), **TURNED)
    checked(result)
    assert result.stop_reason in ("not finite", "step limit", "diverged")
    assert math.isfinite(error_of(result))


def test_14_a_gradient_that_is_not_finite_stops_with_the_maps_before_it():
    calls = []

    def poisoned(predicted, target, weight):
        calls.append(1)
        gap = weight.sqrt() * ((predicted + 0.01) ** 0.5 - (target + 0.01) ** 0.5)
        # In the 201st prediction: finite itself, with a gradient of NaN.
        return gap + torch.sqrt(torch.zeros_like(gap) * gap) if len(calls) == 201 else gap

    options = {**ONE_LOBE, "effort": 0.15, "objective": poisoned}
    result = tm.fit(btf_of(scene("isotropic")[1]), "distribution", geometry="flat", **options)
    assert len(calls) == 201
    checked(result)
    assert result.stop_reason == "not finite" and error_of(result) < 0.05


@functools.lru_cache(maxsize=None)
def soon(kind: str, scale: float = 1.0, rotation: bool = False) -> FitResult:
    """Return a fit of a third of the steps, of images in this unit."""
    options = {**ONE_LOBE, "rotation": rotation, "effort": 0.1}
    return tm.fit(btf_of(scene(kind)[1] * scale), "distribution", geometry="flat", **options)


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_the_unit_does_not_matter(scale):
    images = scene("isotropic")[1]
    plain, scaled = soon("isotropic"), soon("isotropic", scale)
    chosen = torch.arange(len(images))
    found = predict(scaled.material, btf_of(images), chosen) / scale
    # Measured 2e-6: what float32 rounds otherwise, through 200 steps.
    assert_close(found, predict(plain.material, btf_of(images), chosen), 1e-4)
    assert error_of(scaled) == pytest.approx(error_of(plain), rel=1e-3)


@pytest.mark.parametrize(("options", "says"), [
    ({"lobes": -1}, "lobes must be at least 0 and finite; it is -1"), ({"lobes": 13}, "lobes must lie in 0 to 12, or be 'auto'; it is 13"),
    ({"lobes": 1.5}, "lobes must be a whole number"), ({"lobes": True}, "lobes must be a whole number"),
    ({"specular_size": 3}, "specular_size must lie in 4 to 1024; it is 3"), ({"specular_size": 1025}, "specular_size"),
    ({"effort": 0.0}, "effort must be positive and finite; it is 0"), ({"effort": -1.0}, "effort"),
    ({"effort": math.nan}, "effort"), ({"effort": math.inf}, "effort"),
    ({"fresnel": "maybe"}, "fresnel must be true or false, or 'auto'; it is 'maybe'"),
    ({"rotation": "non"}, "rotation must be true or false, or 'auto'; it is 'non'"), ({"storage": "png7"}, "storage .*png8"),
    ({"mask": 3}, "key 'mask'"),
], ids=str)
def test_options_out_of_range_are_named_before_any_step(options, says):
    def never(*given):
        pytest.fail("it went on")

    with pytest.raises(RangeError, match=says):
        tm.fit(btf_of(scene("isotropic")[1]), "distribution", geometry="flat", objective=never, **options)


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_10_one_texel_and_few_samples(samples):
    images = scene("isotropic")[1][:samples, :, :1, :1]
    few = btf_of(images, light=LIGHT[:samples], view=VIEW[:samples])
    result = checked(tm.fit(few, "distribution", geometry="flat", holdout=0, **{**ONE_LOBE, "effort": 0.1}))
    assert result.material.size == (1, 1)
    assert result.report["train"]["relative_error"] < 0.01


@pytest.mark.parametrize("size", [(1, 5), (5, 1)])
@pytest.mark.parametrize("lobes", [1, 3])
def test_10_lines_of_texels(size, lobes):
    images = scene("isotropic")[1][:, :, : size[0], : size[1]]
    checked(tm.fit(btf_of(images), "distribution", geometry="flat", **{**QUICK, "lobes": lobes}))


def test_13_more_lobes_than_texels():
    images = scene("isotropic")[1][:, :, :1, :1]
    result = checked(tm.fit(btf_of(images), "distribution", geometry="flat", **{**QUICK, "lobes": 3}))
    assert result.material.options["lobes"] == 3


@pytest.mark.parametrize("options", [{}, {"effort": 0.3, "specular_size": 4}], ids=["quick", "long"])
def test_9_all_samples_black(options):
    black = np.zeros_like(scene("isotropic")[1])[:, :, :2, :2]
    result = checked(tm.fit(btf_of(black), "distribution", geometry="flat", **{**QUICK, **options}))
    assert float(predict(result.material, btf_of(black), torch.arange(81)).max()) < 1e-9


def test_texels_that_are_all_alike_need_no_second_lobe_but_take_it():
    images = scene("isotropic")[1][:, :, :1, :1].repeat(3, axis=2).repeat(3, axis=3)
    checked(tm.fit(btf_of(images), "distribution", geometry="flat", **{**QUICK, "lobes": 2}))


def test_9_what_nothing_pulls_at_stays_finite_however_long():
    # Logarithms that only ever fall reach what float32 cannot hold.
    material = _material_of(torch.full((1, 2, 2), -200.0))
    assert all(bool(torch.isfinite(value).all()) for value in material.maps.values())


def _begun(size: int) -> tuple[fitting.DistributionFit, fitting.Parts, dict[str, torch.Tensor]]:
    """Return a fit of a few texels that has not taken a step yet, its parts and its parameters."""
    from torchmat.fitting.models.distribution.options import DistributionOptions
    from torchmat.fitting.models.distribution.start import find_starts
    from torchmat.fitting.relief.surface import bring_onto
    from torchmat.fitting.training import make_training

    btf = btf_of(scene("isotropic")[1][:, :, :size, :size])
    training = make_training(btf, torch.arange(len(btf)), 0, True, torch.float32, False)
    options = DistributionOptions(**{**ONE_LOBE, "specular_size": 8})
    state = fitting.DistributionFit(bring_onto(training, torch.zeros(1, size, size)), None, options)
    parts = fitting.Parts(1, False, False)
    return state, parts, fitting.raw_maps(find_starts(state.surface, state.level), parts, 8, training)


def _material_of(mask: torch.Tensor) -> tm.Material:
    """Return the material that the fit would make of a start with this logarithm of the mask."""
    state, parts, raw = _begun(2)
    return state._material({**raw, "specular_mask": mask}, parts)


def test_a_step_goes_a_third_as_far_in_slopes_and_twice_as_far_in_tables():
    state, parts, raw = _begun(4)
    before = {name: value.clone() for name, value in raw.items()}
    state.solve(raw, parts, tm.Minibatch(1, 0.06), torch.arange(81), math.inf, None)
    longest = {name: float((value - before[name]).abs().max()) for name, value in raw.items()}
    # Adam's first step is its rate wherever there is a gradient, and a run begins with a twentieth of it.
    expected = {"normal": 0.0009, "diffuse": 0.003, "specular_mask": 0.003, "specular": 0.006}
    assert {name: longest[name] for name in expected} == pytest.approx(expected, rel=1e-3)


def test_8_a_dark_texel_is_not_lost_to_a_highlight():
    images = scene("isotropic")[1] * 1e-2
    bright = images.copy()
    bright[30:34, :, 3, 4] = 1e4
    on = torch.ones(SIZE, SIZE, dtype=torch.bool)
    on[3, 4] = False
    # With one lobe for all of them 11 % would be left; with two the highlight gets its own: measured 6e-5.
    result = checked(tm.fit(btf_of(bright), "distribution", geometry="flat", holdout=0, **{**ONE_LOBE, "lobes": 2, "effort": 0.15}))
    found = predict(result.material, btf_of(images), torch.arange(len(images)))[..., on]
    truth = torch.from_numpy(images)[..., on]
    assert float((found - truth).square().sum() / truth.square().sum()) < 1e-3


def test_samples_that_are_masked_do_not_count():
    images = scene("isotropic")[1].copy()
    weight = np.ones((len(images), SIZE, SIZE))
    weight[10:20, :3] = 0
    options = {**QUICK, "measure": False, "holdout": 0}
    honest = tm.fit(btf_of(images, weight=weight), "distribution", geometry="flat", **options)
    images[10:20, :, :3] = 0.7
    assert same_bits(honest, tm.fit(btf_of(images, weight=weight), "distribution", geometry="flat", **options))
