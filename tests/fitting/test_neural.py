"""The neural fit: recovery of what a network made, budgets, curves, reasons, weights, units and memory."""

from __future__ import annotations

import importlib
import math

import numpy as np
import pytest
import torch
from tests.models.examples import make_maps
from tests.reference import materials as oracle
from tests.support import all_pairs, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, RangeError
from torchmat.fitting import predict
from torchmat.fitting.training import make_training

neural = importlib.import_module("torchmat.fitting.models.neural")  # torchmat.fitting is the function
LIGHT, VIEW = all_pairs(hemisphere(), hemisphere(((0, 1), (30, 5), (60, 5))))
SMALL = {"latent": 4, "hidden": 8}


def plausible(scale=1.0, size=(6, 7), weight=None):
    images = plausible_images(LIGHT, VIEW, *size) * scale
    return Btf.from_tensors(images.astype(np.float32), LIGHT, VIEW, weight)


def maps_of(result):
    return {name: value.detach() for name, value in result.material.maps.items()}


def same_bits(one, other):
    return all(torch.equal(value, maps_of(other)[name]) for name, value in maps_of(one).items())


def test_what_another_network_made_is_found_again():
    options = {"latent": 2, "hidden": 4, "layers": 1}
    maps = {name: value.numpy() for name, value in make_maps("neural", options, 4, 4).items()}
    images = np.stack([
        oracle.shade("neural", maps, options, light[:, None, None], view[:, None, None], 4, 4)
        for light, view in zip(LIGHT, VIEW, strict=True)
    ])
    btf = Btf.from_tensors(images.astype(np.float32), LIGHT, VIEW)
    result = tm.fit(btf, "neural", geometry="flat", effort=0.06, latent=4, hidden=16, storage="float")
    left_by_the_mean = float(np.square(images - images.mean(axis=0)).sum() / np.square(images).sum())
    # Measured 1.1e-3 after 720 steps.
    assert result.report["held_out"]["relative_error"] < min(2e-3, left_by_the_mean / 20)
    assert result.stop_reason == "step limit" and result.report["figures"]["adam_steps"] == 720


def test_a_budget_ends_the_fit_with_its_rate_run_down(monkeypatch):
    clock = iter(range(10_000_000))
    from torchmat.solvers import clock as watch

    monkeypatch.setattr(watch.time, "perf_counter", lambda: next(clock) * 1e-3)
    result = tm.fit(plausible(), "neural", geometry="flat", seconds=0.2, effort=100.0, **SMALL)
    assert result.stop_reason == "budget spent"
    assert 10 < result.report["figures"]["adam_steps"] < 200
    assert result.report["held_out"]["relative_error"] < 0.8  # measured 0.54; black would leave 1


def test_the_curve_is_measured_on_held_out_samples_as_the_fit_goes_on():
    result = tm.fit(plausible(), "neural", geometry="flat", effort=0.02, curve=True, **SMALL)
    seconds, errors = zip(*result.report["curve"], strict=True)
    assert list(seconds) == sorted(seconds) and errors[-1] < 0.2 * errors[0]
    plain = tm.fit(plausible(), "neural", geometry="flat", effort=0.02, measure=False, **SMALL)
    assert same_bits(result, plain)  # measuring changes nothing


@pytest.mark.parametrize(("rate", "reason"), [(1e3, "diverged"), (1e30, "not finite")])
def test_a_step_far_too_large_ends_in_a_named_reason_with_the_best_so_far(rate, reason):
    options = {**SMALL, "solver": tm.Minibatch(rate=rate), "effort": 0.02}
    result = tm.fit(plausible(), "neural", geometry="flat", measure=False, **options)
    assert result.stop_reason == reason
    assert all(bool(torch.isfinite(value).all()) for value in maps_of(result).values())


def test_the_unit_of_the_data_changes_nothing():
    # 4^6 and its root are powers of two, which no rounding sees.
    one, other = (tm.fit(plausible(scale), "neural", geometry="flat", effort=0.01, measure=False, **SMALL) for scale in (1.0, 4.0**6))
    assert torch.equal(maps_of(one)["latent"], maps_of(other)["latent"])
    assert torch.equal(maps_of(one)["layer_2"] * 64, maps_of(other)["layer_2"])


def test_samples_of_no_importance_leave_no_trace():
    counts = torch.ones(len(LIGHT))
    counts[::3] = 0
    found = []
    for spoilt in (False, True):
        images = plausible_images(LIGHT, VIEW, 6, 7).astype(np.float32)
        images[::3] *= 5.0 if spoilt else 1.0
        btf = Btf.from_tensors(images, LIGHT, VIEW)
        training = make_training(btf, torch.arange(len(btf)), 0, True, torch.float32, False)
        object.__setattr__(training, "importance", counts)
        with torch.no_grad():
            found.append(neural.fit_neural(training, effort=0.005, **SMALL).material)
    assert all(torch.equal(value, found[1].maps[name]) for name, value in found[0].maps.items())


def test_more_images_than_memory_is_meant_for_take_turns(monkeypatch):
    monkeypatch.setattr(neural, "POOL_VALUES", 3 * 42 * 20)  # 20 images at a time
    fills = []
    honest = neural._Fit._decode

    def counted(self, rows):
        fills.append(set(rows.tolist()))
        return honest(self, rows)

    monkeypatch.setattr(neural._Fit, "_decode", counted)
    result = tm.fit(plausible(), "neural", geometry="flat", effort=0.01, **SMALL)
    assert max(map(len, fills)) == 20 and len(set.union(*fills)) > 150 and len(fills) > 20
    assert result.report["held_out"]["relative_error"] < 0.3


def test_many_texels_are_dealt_into_groups_and_come_back_in_place(monkeypatch):
    monkeypatch.setattr(neural, "FEWEST_TEXELS", 16)
    btf = plausible(size=(9, 11))
    result = tm.fit(btf, "neural", geometry="flat", effort=0.03, storage="float", measure=False, **SMALL)
    every = torch.arange(len(btf))
    means = [images.mean(dim=(0, 1)).flatten() for images in (predict(result.material, btf, every), btf.images(every))]
    # Every texel has its own albedo; texels out of place would not correlate at all.
    assert float(torch.corrcoef(torch.stack(means))[0, 1]) > 0.9


@pytest.mark.parametrize(("options", "said"), [
    ({"latent": 0}, "latent must be a whole number of 1 to 1024"), ({"hidden": -3}, "hidden must be"),
    ({"layers": 0}, "layers must be"), ({"effort": 0.0}, "effort must be positive and finite"),
    ({"effort": math.inf}, "effort must be"), ({"storage": "png9"}, "Did you mean 'png8'"),
])
def test_options_that_make_no_sense_are_refused(options, said):
    with pytest.raises(RangeError, match=said):
        tm.fit(plausible(), "neural", geometry="flat", **options)
